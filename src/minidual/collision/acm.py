"""The allowed-collision matrix: which pairs of links are not checked, and why.

How it is built, on one arm (the two are the same robot, so what holds for one holds for the other):

- `rigid`: both links are carried by the same joint (link 7, hand and fingers: the fingers are locked);
- `adjacent`: one link is the next one along the chain, their hulls overlap at the joint;
- `always`: they touch at home and in at least 95 % of the samples, so touching means nothing;
- `never`: they touched in none of the samples.

The samples are uniform within the joint limits. From 20 000 on their number doubles until no pair changes its class
over two doublings in a row (1 000 miss pairs that do collide: the rarest one touches in one sample of a thousand). A
pair that touches in a fraction p of all postures is missed by n samples with probability (1 - p)^n, so with 95 %
confidence what is called `never` touches in less than 3/n of them ("rule of three").

Pairs of different arms are always checked, whatever the samples say.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import re
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from minidual.collision.allowed import AllowedCollisions, allowed_pair
from minidual.collision.links import joints_before, links_of
from minidual.errors import UsageError
from minidual.robot.constants import ARMS, HOME, Q_LOWER, Q_UPPER
from minidual.robot.description import dual_panda_urdf

if TYPE_CHECKING:
    from minidual.collision.mujoco_engine import MujocoEngine

SAMPLES_MIN = 20_000
SAMPLES_MAX = 1_280_000
QUIET_DOUBLINGS = 2
"""Doublings in a row over which no pair may change its class."""
ALWAYS_FRACTION = 0.95
_RULE_VERSION = "4"
_SEED = 7


@dataclass(frozen=True)
class Round:
    """One doubling.

    Attributes:
        samples_n: Samples so far.
        changed: Pairs that changed their class, as "link + link".
    """

    samples_n: int
    changed: tuple[str, ...]


@dataclass(frozen=True)
class BuiltAcm:
    """The matrix and how it came about.

    Attributes:
        acm: The matrix.
        rounds: Every doubling.
        converged: Whether the rule was met before the limit on samples.
        rarest: The pair that touches least often among those that do, and in how many samples.
    """

    acm: AllowedCollisions
    rounds: tuple[Round, ...]
    converged: bool
    rarest: tuple[str, int]

    @property
    def samples_n(self) -> int:
        """Samples drawn."""
        return self.rounds[-1].samples_n

    def lines(self) -> list[str]:
        """Return the history in words."""
        steps = ", ".join(f"{r.samples_n} ({len(r.changed)} changed)" for r in self.rounds[1:])
        ended = "converged" if self.converged else "NOT converged"
        pair, count = self.rarest
        return [
            (
                f"{ended}: first {self.rounds[0].samples_n} samples, then {steps}; no pair may change over "
                f"{QUIET_DOUBLINGS} doublings"
            ),
            (
                f"rarest contact: {pair}, {count} of {self.samples_n}; what is called never touches in less than "
                f"{3.0 / self.samples_n:.1e} of all postures (95 % confidence)"
            ),
        ]

    def to_json(self) -> dict[str, Any]:
        """Return everything as plain data."""
        return {
            "pairs": [list(row) for row in self.acm.table()],
            "rounds": [{"samples_n": r.samples_n, "changed": list(r.changed)} for r in self.rounds],
            "converged": self.converged,
            "rarest": list(self.rarest),
        }


def default_acm() -> AllowedCollisions:
    """Return the matrix of the two arms."""
    return acm_report().acm


@cache
def acm_report() -> BuiltAcm:
    """Return the matrix and its history: from the user's cache if it holds this model, else built (about 1 s)."""
    path = _cache_file()
    cached = _read(path)
    if cached is not None:
        return cached
    built = build_acm()
    _write(path, built)
    return built


def build_acm(samples_min: int = SAMPLES_MIN, samples_max: int = SAMPLES_MAX) -> BuiltAcm:
    """Build the matrix of the two arms by the rule in the module's text.

    Args:
        samples_min: Samples of the first round.
        samples_max: Where doubling ends even if pairs still change.
    """
    structural = dict(_structural_pairs())
    pairs = [p for p in itertools.combinations(links_of("left"), 2) if p not in structural]
    at_home = _contacts_at_home(pairs)
    engine = _left_arm_engine(pairs)
    rng = np.random.default_rng(_SEED)
    counts = dict.fromkeys(pairs, 0)
    rounds: list[Round] = []
    before: dict[tuple[str, str], str] = {}
    total, quiet, batch = 0, 0, samples_min
    while quiet < QUIET_DOUBLINGS and total + batch <= max(samples_max, samples_min):
        _count_contacts(engine, counts, rng, batch)
        total += batch
        batch = total
        classes = {p: _class(counts[p], total, p in at_home) for p in pairs}
        changed = tuple(" + ".join(p) for p in pairs if before and classes[p] != before[p])
        quiet = quiet + 1 if before and not changed else 0
        rounds.append(Round(total, changed))
        before = classes
    reasons = dict(structural)
    for pair, kind in before.items():
        if kind == "never":
            reasons[pair] = f"never in {total} samples"
        elif kind == "always":
            reasons[pair] = "always"
    entries = {
        allowed_pair(*(link.replace("left_", f"{arm}_", 1) for link in pair), reason)
        for arm in ARMS
        for pair, reason in reasons.items()
    }
    touched = {p: n for p, n in counts.items() if n > 0}
    rarest = min(touched, key=lambda p: touched[p]) if touched else ("", "")
    return BuiltAcm(
        AllowedCollisions(frozenset(entries)),
        tuple(rounds),
        quiet >= QUIET_DOUBLINGS,
        (" + ".join(rarest), touched.get(rarest, 0)),
    )


def _class(touched: int, total: int, at_home: bool) -> str:
    if touched == 0:
        return "never"
    return "always" if at_home and touched >= ALWAYS_FRACTION * total else "checked"


def _structural_pairs() -> Iterable[tuple[tuple[str, str], str]]:
    for a, b in itertools.combinations(links_of("left"), 2):
        gap = joints_before(b) - joints_before(a)
        if gap == 0:
            yield (a, b), "rigid"
        elif gap == 1 and b.rsplit("_", 1)[1].startswith("link"):
            yield (a, b), "adjacent"


def _left_arm_engine(pairs: list[tuple[str, str]]) -> MujocoEngine:
    # Here and not above: the engine's module imports this one.
    from minidual.collision.mujoco_engine import MujocoEngine

    return MujocoEngine.from_pairs(pairs, obstacles=(), attached=())


def _contacts_at_home(pairs: list[tuple[str, str]]) -> set[tuple[str, str]]:
    touching = _left_arm_engine(pairs).touching_pairs(HOME)
    return {p for p in pairs if frozenset(p) in touching}


def _count_contacts(
    engine: MujocoEngine, counts: dict[tuple[str, str], int], rng: np.random.Generator, samples_n: int
) -> None:
    """Add to `counts` in how many of further random postures each pair touches."""
    key = {frozenset(p): p for p in counts}
    Q = np.tile(HOME, (samples_n, 1))
    Q[:, :7] = rng.uniform(Q_LOWER[:7], Q_UPPER[:7], (samples_n, 7))
    for q in Q:
        for pair in engine.touching_pairs(q):
            counts[key[pair]] += 1


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


def _read(path: Path) -> BuiltAcm | None:
    """Return the cached matrix; None if there is none or it does not hold what it should."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        acm = AllowedCollisions(frozenset(allowed_pair(*(str(v) for v in row)) for row in content["pairs"]))
        rounds = tuple(Round(int(r["samples_n"]), tuple(map(str, r["changed"]))) for r in content["rounds"])
        pair, count = content["rarest"]
        built = BuiltAcm(acm, rounds, bool(content["converged"]), (str(pair), int(count)))
    except (OSError, ValueError, TypeError, KeyError, UsageError):
        return None
    known = {link for arm in ARMS for link in links_of(arm)}
    sound = all(e.first in known and e.second in known and e.first.split("_")[0] == e.second.split("_")[0] for e in acm)
    return built if sound and len(acm) > 0 and rounds else None


def _write(path: Path, built: BuiltAcm) -> None:
    """Write the cache atomically; a folder that cannot be written costs a second next time, nothing more."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=path.parent, suffix=".tmp", delete=False, encoding="utf-8") as file:
            json.dump(built.to_json(), file, indent=0)
        Path(file.name).replace(path)
    except OSError:
        return
