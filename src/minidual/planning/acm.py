"""The allowed-collision matrix: which pairs of links are not checked, and why.

How it is built, on one arm (the two are the same robot, so what holds for one holds for the other):

- `rigid`: both links are carried by the same joint (link 7, hand and fingers: the fingers are locked);
- `adjacent`: one link is the next one along the chain, their hulls overlap at the joint;
- `always`: they touch at home and in at least 95 % of the samples, so touching means nothing;
- `never`: they touched in none of the samples. The number of samples doubles until a doubling adds no new
  touching pair (at least 20 000 of them: 1 000 miss pairs that do collide).

Pairs of different arms are always checked, whatever the samples say.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import re
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from minidual.errors import UsageError
from minidual.planning.links import joints_before, links_of
from minidual.robot.constants import ARMS, HOME, Q_LOWER, Q_UPPER
from minidual.robot.description import dual_panda_urdf

SAMPLES_MIN = 20_000
SAMPLES_MAX = 160_000
ALWAYS_FRACTION = 0.95
_RULE_VERSION = "3"
_SEED = 7


@dataclass(frozen=True, order=True)
class AllowedPair:
    """Two links that may touch, in alphabetical order, and the reason."""

    first: str
    second: str
    reason: str


def allowed_pair(a: str, b: str, reason: str) -> AllowedPair:
    """Return the entry for links a and b in either order."""
    if a == b:
        raise UsageError(f"a link cannot be paired with itself: '{a}'")
    first, second = sorted((a, b))
    return AllowedPair(first, second, reason)


@dataclass(frozen=True)
class AllowedCollisions:
    """An immutable, hashable matrix; `with_pair` and `without_pair` return changed copies."""

    entries: frozenset[AllowedPair] = frozenset()

    @cached_property
    def _reasons(self) -> dict[tuple[str, str], str]:
        return {(e.first, e.second): e.reason for e in self.entries}

    def reason(self, a: str, b: str) -> str | None:
        """Return why a and b may touch, or None if the pair is checked."""
        return self._reasons.get((a, b) if a < b else (b, a))

    def with_pair(self, a: str, b: str, reason: str = "user") -> AllowedCollisions:
        """Return a copy in which a and b may touch."""
        kept = {e for e in self.entries if {e.first, e.second} != {a, b}}
        return AllowedCollisions(frozenset(kept | {allowed_pair(a, b, reason)}))

    def without_pair(self, a: str, b: str) -> AllowedCollisions:
        """Return a copy in which a and b are checked.

        Raises:
            UsageError: The pair was not allowed to begin with.
        """
        if self.reason(a, b) is None:
            raise UsageError(f"the pair {a} and {b} is checked already; it has no entry to remove")
        return AllowedCollisions(frozenset(e for e in self.entries if {e.first, e.second} != {a, b}))

    def table(self) -> list[tuple[str, str, str]]:
        """Return (link, link, reason) of every allowed pair, sorted."""
        return sorted((e.first, e.second, e.reason) for e in self.entries)

    def __iter__(self) -> Iterator[AllowedPair]:
        return iter(sorted(self.entries))

    def __len__(self) -> int:
        return len(self.entries)


@cache
def default_acm() -> AllowedCollisions:
    """Return the matrix of the two arms: from the user's cache if it holds this model, else built (about 1 s)."""
    path = _cache_file()
    cached = _read(path)
    if cached is not None:
        return cached
    acm = build_acm()
    _write(path, acm)
    return acm


def build_acm(samples_min: int = SAMPLES_MIN, samples_max: int = SAMPLES_MAX) -> AllowedCollisions:
    """Build the matrix of the two arms by the rule in the module's text.

    Args:
        samples_min: Samples of the first round.
        samples_max: Where doubling ends even if it still finds pairs.
    """
    structural = dict(_structural_pairs())
    pairs = [p for p in itertools.combinations(links_of("left"), 2) if p not in structural]
    touched, count = _count_contacts(pairs, samples_min, samples_max)
    at_home = _contacts_at_home(pairs)
    reasons = dict(structural)
    for pair in pairs:
        if touched.get(pair, 0) == 0:
            reasons[pair] = f"never in {count} samples"
        elif pair in at_home and touched[pair] >= ALWAYS_FRACTION * count:
            reasons[pair] = "always"
    entries = {
        allowed_pair(*(link.replace("left_", f"{arm}_", 1) for link in pair), reason)
        for arm in ARMS
        for pair, reason in reasons.items()
    }
    return AllowedCollisions(frozenset(entries))


def _structural_pairs() -> Iterable[tuple[tuple[str, str], str]]:
    for a, b in itertools.combinations(links_of("left"), 2):
        gap = joints_before(b) - joints_before(a)
        if gap == 0:
            yield (a, b), "rigid"
        elif gap == 1 and b.rsplit("_", 1)[1].startswith("link"):
            yield (a, b), "adjacent"


def _left_arm_engine(pairs: list[tuple[str, str]]):  # noqa: ANN202  (the engine's module imports this one)
    from minidual.planning.mujoco_engine import MujocoEngine

    return MujocoEngine.from_pairs(pairs, obstacles=(), attached=())


def _contacts_at_home(pairs: list[tuple[str, str]]) -> set[tuple[str, str]]:
    touching = _left_arm_engine(pairs).touching_pairs(HOME)
    return {p for p in pairs if frozenset(p) in touching}


def _count_contacts(
    pairs: list[tuple[str, str]], samples_min: int, samples_max: int
) -> tuple[dict[tuple[str, str], int], int]:
    engine = _left_arm_engine(pairs)
    rng = np.random.default_rng(_SEED)
    counts: dict[frozenset[str], int] = {}
    total, batch = 0, samples_min
    while True:
        known = len(counts)
        Q = np.tile(HOME, (batch, 1))
        Q[:, :7] = rng.uniform(Q_LOWER[:7], Q_UPPER[:7], (batch, 7))
        for q in Q:
            for pair in engine.touching_pairs(q):
                counts[pair] = counts.get(pair, 0) + 1
        first_round = total == 0
        total += batch
        if (not first_round and len(counts) == known) or 2 * total > samples_max:
            return {p: counts[frozenset(p)] for p in pairs if frozenset(p) in counts}, total
        batch = total


def model_hash() -> str:
    """Return the sha256 of the robot's geometry: the URDF and every mesh it names, wherever they are installed."""
    urdf = dual_panda_urdf()
    digest = hashlib.sha256(_RULE_VERSION.encode())
    files = sorted(set(re.findall(r'filename="([^"]+)"', urdf)))
    digest.update(re.sub(r'filename="[^"]*/([^"/]+)"', r'filename="\1"', urdf).encode())
    for file in files:
        digest.update(Path(file).read_bytes())
    return digest.hexdigest()


def _cache_file() -> Path:
    root = os.environ.get("MINIDUAL_CACHE")
    folder = Path(root) if root else Path.home() / ".cache" / "minidual"
    return folder / f"acm-{model_hash()[:20]}.json"


def _read(path: Path) -> AllowedCollisions | None:
    """Return the cached matrix; None if there is none or it does not hold what it should."""
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
        acm = AllowedCollisions(frozenset(allowed_pair(*(str(v) for v in row)) for row in rows))
    except (OSError, ValueError, TypeError, UsageError):
        return None
    known = {link for arm in ARMS for link in links_of(arm)}
    sound = all(
        e.first in known and e.second in known and e.first.split("_")[0] == e.second.split("_")[0]
        for e in acm
    )
    return acm if sound and len(acm) > 0 else None


def _write(path: Path, acm: AllowedCollisions) -> None:
    """Write the cache atomically; a folder that cannot be written costs a second next time, nothing more."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(
            "w", dir=path.parent, suffix=".tmp", delete=False, encoding="utf-8"
        ) as file:
            json.dump([list(row) for row in acm.table()], file, indent=0)
        Path(file.name).replace(path)
    except OSError:
        return
