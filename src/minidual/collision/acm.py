"""The allowed-collision matrix: unchecked pairs of links of one arm.

Only the left arm is sampled; the right one is equal. Reasons:

- `rigid`: no joint in between (fingers are locked);
- `adjacent`: one joint connects them directly;
- `always`: contact at home and in at least 95 % of the samples;
- `model`: the arm's model rules contact out;
- `never`: no contact in any sample.

Samples are uniform within the joint limits. Their number doubles from 20 000 until no pair changes class over two
doublings in a row. By the rule of three, a `never` pair touches in less than 3/n of all postures (95 % confidence).
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from minidual.collision.allowed import AllowedCollisions, allowed_pair
from minidual.collision.engine import ENGINES, Pairs
from minidual.collision.links import Link, links_of
from minidual.durable import write_text
from minidual.errors import UsageError
from minidual.robot.description import pair_urdf
from minidual.robot.pair import SIDES, Robot

SAMPLES_MIN = 20_000
SAMPLES_MAX = 1_280_000
QUIET_DOUBLINGS = 2
"""Consecutive unchanged doublings that end the sampling."""
ALWAYS_FRACTION = 0.95
_RULE_VERSION = "4"
_SEED = 7


@dataclass(frozen=True)
class Round:
    """Samples so far, and pairs that changed class."""

    samples_n: int
    changed: tuple[str, ...]


@dataclass(frozen=True)
class BuiltAcm:
    """The matrix and its history.

    Attributes:
        converged: False if the sample limit was reached.
        rarest: The touching pair with fewest contacts, and their number.
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
        """Return the history as text."""
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
        """Return plain data."""
        return {
            "pairs": [list(row) for row in self.acm.table()],
            "rounds": [{"samples_n": r.samples_n, "changed": list(r.changed)} for r in self.rounds],
            "converged": self.converged,
            "rarest": list(self.rarest),
        }


def default_acm(robot: Robot) -> AllowedCollisions:
    """Return the matrix."""
    return acm_report(robot).acm


@cache
def acm_report(robot: Robot) -> BuiltAcm:
    """Return matrix and history from the user's cache, or build them (1 s)."""
    path = _cache_file(robot)
    cached = _read(path, robot)
    if cached is not None:
        return cached
    built = build_acm(robot)
    _write(path, built)
    return built


def build_acm(robot: Robot, samples_min: int = SAMPLES_MIN, samples_max: int = SAMPLES_MAX) -> BuiltAcm:
    """Build the matrix."""
    side = SIDES[0]
    reasons = dict(_structural_pairs(robot))
    pairs = [p for p in itertools.combinations(_links(robot), 2) if p not in reasons]
    by_set = {frozenset(p): p for p in pairs}
    engine: Any = ENGINES["mujoco"](Pairs(robot, tuple(pairs)))  # MuJoCo alone reports which pairs touch
    at_home = {by_set[pair] for pair in engine.touching_pairs(robot.home)}
    own = robot.groups[f"{side}_arm"]
    rng = np.random.default_rng(_SEED)
    counts = dict.fromkeys(pairs, 0)
    rounds: list[Round] = []
    before: dict[tuple[str, str], str] = {}
    total, quiet, batch = 0, 0, samples_min
    while quiet < QUIET_DOUBLINGS and total + batch <= max(samples_max, samples_min):
        Q = np.tile(robot.home, (batch, 1))
        Q[:, own] = rng.uniform(robot.q_lower[own], robot.q_upper[own], (batch, robot.dof_per_arm))
        for q in Q:
            for pair in engine.touching_pairs(q):
                counts[by_set[pair]] += 1
        total += batch
        batch = total
        classes = {p: _class(counts[p], total, p in at_home) for p in pairs}
        changed = tuple(" + ".join(p) for p in pairs if before and classes[p] != before[p])
        quiet = quiet + 1 if before and not changed else 0
        rounds.append(Round(total, changed))
        before = classes
    reasons |= {p: f"never in {total} samples" for p, kind in before.items() if kind == "never"}
    reasons |= {p: "always" for p, kind in before.items() if kind == "always"}
    entries = {allowed_pair(*_on_side(pair, other), reason) for other in SIDES for pair, reason in reasons.items()}
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


def _links(robot: Robot) -> dict[str, Link]:
    return {name: link for name, link in links_of(robot).items() if link.collides and link.side == SIDES[0]}


def _structural_pairs(robot: Robot) -> Iterable[tuple[tuple[str, str], str]]:
    links = _links(robot)
    first: dict[int, str] = {}  # by number of joints before it: the link that the last of them moves
    for link in links.values():
        first.setdefault(link.joints_before, link.name)
    known = set(links)
    for pair in robot.arm.never_touch:
        a, b = (f"{SIDES[0]}_{link}" for link in pair)
        if known.issuperset((a, b)):
            yield (a, b), "model"
    for a, b in itertools.combinations(links, 2):
        gap = links[b].joints_before - links[a].joints_before
        if gap == 0:
            yield (a, b), "rigid"
        elif gap == 1 and first[links[b].joints_before] == b:
            yield (a, b), "adjacent"


def model_hash(robot: Robot) -> str:
    """Hash the geometry (URDF, meshes), limits and home; installation paths do not matter."""
    urdf = pair_urdf(robot)
    digest = hashlib.sha256(_RULE_VERSION.encode())
    digest.update(re.sub(r'filename="[^"]*/([^"/]+)"', r'filename="\1"', urdf).encode())
    for file in sorted(set(re.findall(r'filename="([^"]+)"', urdf))):
        digest.update(Path(file).read_bytes())
    digest.update(
        repr(
            (robot.arm.home, robot.arm.q_lower, robot.arm.q_upper, robot.hand.travel_m, robot.arm.never_touch)
        ).encode()
    )
    return digest.hexdigest()


def _cache_file(robot: Robot) -> Path:
    root = os.environ.get("MINIDUAL_CACHE")
    folder = Path(root) if root else Path.home() / ".cache" / "minidual"
    return folder / f"acm-{model_hash(robot)[:20]}.json"


def _read(path: Path, robot: Robot) -> BuiltAcm | None:
    """Return None if missing or invalid."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        acm = AllowedCollisions(frozenset(allowed_pair(*(str(v) for v in row)) for row in content["pairs"]))
        rounds = tuple(Round(int(r["samples_n"]), tuple(map(str, r["changed"]))) for r in content["rounds"])
        pair, count = content["rarest"]
        built = BuiltAcm(acm, rounds, bool(content["converged"]), (str(pair), int(count)))
    except (OSError, ValueError, TypeError, KeyError, UsageError):
        return None
    known = links_of(robot)
    sound = all({e.first, e.second} <= known.keys() and known[e.first].side == known[e.second].side for e in acm)
    return built if sound and len(acm) > 0 and rounds else None


def _write(path: Path, built: BuiltAcm) -> None:
    """Ignore unwritable folders."""
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(built.to_json(), indent=0))


def _on_side(pair: tuple[str, str], side: str) -> tuple[str, str]:
    a, b = (name.replace(f"{SIDES[0]}_", f"{side}_", 1) for name in pair)
    return a, b
