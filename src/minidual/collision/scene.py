"""The immutable, hashable planning scene, and the robot's allowed-collision matrix.

The matrix: unchecked pairs of links of one arm, by reason (docs/planning-scenes.md). Only the left arm is sampled,
fingers locked. The number n of samples doubles from 20 000 until no pair changes class over two doublings. A `never` pair
touches in less than 3/n of all postures (95 % confidence).
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import itertools
import json
import math
import os
import re
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from minidual.collision.shapes import ENGINES, Attached, Box, Pairs, Shape, grown
from minidual.config.seeds import stream
from minidual.durable import expanded, regular_file, write_text
from minidual.errors import DataError, UsageError, check_name
from minidual.robot.description import collision_links, links_of, pair_urdf
from minidual.robot.pair import DUAL_PANDA, SIDES, Robot

SAMPLES_MIN = 20_000
SAMPLES_MAX = 1_280_000
QUIET_DOUBLINGS = 2
"""Unchanged doublings in a row that end the sampling."""
ALWAYS_FRACTION = 0.95
_RULE_VERSION = "6"
_CACHE_BYTES_MAX = 2**20
_SEED = 7

AllowedCollisions = frozenset[tuple[str, str, str]]
"""The matrix: (link, link, reason), names sorted."""


@dataclass(frozen=True)
class BuiltAcm:
    """The matrix and its history.

    Attributes:
        rounds: `samples_n` so far, pairs that `changed` class.
        converged: False if the sample limit was reached.
        rarest, rarest_n: Touching pair with fewest contacts; their number.
    """

    pairs: list[list[str]]
    rounds: list[dict[str, Any]]
    converged: bool
    rarest: str
    rarest_n: int

    @cached_property
    def acm(self) -> AllowedCollisions:
        """The matrix."""
        return frozenset((a, b, reason) for a, b, reason in self.pairs)

    @property
    def samples_n(self) -> int:
        """Samples drawn."""
        return self.rounds[-1]["samples_n"]

    def lines(self) -> list[str]:
        """Return the history as lines."""
        steps = ", ".join(f"{r['samples_n']} ({len(r['changed'])} changed)" for r in self.rounds)
        never = f"a pair that never touched does so in less than {3.0 / self.samples_n:.1e} of all postures"
        return [
            f"{'converged' if self.converged else 'NOT converged'} over {QUIET_DOUBLINGS} doublings: samples {steps}",
            f"rarest contact: {self.rarest}, {self.rarest_n} of {self.samples_n}; {never} (95 % confidence)",
        ]


@cache
def acm_report(robot: Robot) -> BuiltAcm:
    """Return matrix and history from the user's cache, or build them (1 s) if it lacks the model or is damaged."""
    model = model_hash(robot)
    path = (
        expanded(os.environ.get("MINIDUAL_CACHE") or "~/.cache/minidual") / f"acm-{model[:20]}.json"
    )
    with contextlib.suppress(DataError, OSError, ValueError, TypeError):
        digest, _, content = (
            regular_file(path, _CACHE_BYTES_MAX).read_text(encoding="utf-8").partition("\n")
        )
        if digest == _digest(model, content):
            return BuiltAcm(**json.loads(content))
    built = build_acm(robot)
    content = json.dumps(dataclasses.asdict(built))
    with contextlib.suppress(OSError):  # the folder may be read-only
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, f"{_digest(model, content)}\n{content}")
    return built


def _digest(model: str, content: str) -> str:
    return hashlib.sha256(f"{model}\n{content}".encode()).hexdigest()


def build_acm(
    robot: Robot,
    samples_min: int = SAMPLES_MIN,
    samples_max: int = SAMPLES_MAX,
) -> BuiltAcm:
    """Build the matrix."""
    reasons = _structural_pairs(robot)
    pairs = [pair for pair in itertools.combinations(_left_links(robot), 2) if pair not in reasons]
    rows = {frozenset(pair): k for k, pair in enumerate(pairs)}
    engine: Any = ENGINES["mujoco"](
        Pairs(robot, tuple(pairs)),
    )  # MuJoCo alone reports which pairs touch
    at_home = np.zeros(len(pairs), dtype=bool)
    at_home[[rows[pair] for pair in engine.touching_pairs(robot.home)]] = True
    own = robot.groups[f"{SIDES[0]}_arm"]
    rng = stream(_SEED, "allowed-collisions")
    counts = np.zeros(len(pairs), dtype=int)
    kinds = np.full(len(pairs), "", dtype="U7")
    rounds: list[dict[str, Any]] = []
    total = 0
    quiet = 0
    batch = samples_min
    while quiet < QUIET_DOUBLINGS and total + batch <= max(samples_max, samples_min):
        Q = np.tile(robot.home, (batch, 1))
        Q[:, own] = rng.uniform(robot.q_lower[own], robot.q_upper[own], (batch, robot.dof_per_arm))
        for q in Q:
            counts[[rows[pair] for pair in engine.touching_pairs(q)]] += 1
        total += batch
        batch = total
        always = at_home & (counts >= ALWAYS_FRACTION * total)
        before = kinds
        kinds = np.where(counts == 0, "never", np.where(always, "always", "checked"))
        changed = [" + ".join(pairs[k]) for k in np.flatnonzero(kinds != before)] if rounds else []
        quiet = quiet + 1 if rounds and not changed else 0
        rounds.append({"samples_n": total, "changed": changed})
    labels = {"never": f"never in {total} samples", "always": "always"}
    reasons |= {
        pair: labels[kind]
        for pair, kind in zip(pairs, kinds.tolist(), strict=True)
        if kind in labels
    }
    table = sorted(
        [*sorted(name.replace(SIDES[0], side, 1) for name in pair), reason]
        for side in SIDES
        for pair, reason in reasons.items()
    )
    touched = np.flatnonzero(counts)
    rarest = touched[np.argmin(counts[touched])] if len(touched) else 0
    return BuiltAcm(
        table,
        rounds,
        quiet >= QUIET_DOUBLINGS,
        " + ".join(pairs[rarest]),
        int(counts[rarest]),
    )


def _left_links(robot: Robot) -> dict[str, int]:
    return {
        n: link.joints_before
        for n, link in links_of(robot).items()
        if link.collides and link.side == SIDES[0]
    }


def _structural_pairs(robot: Robot) -> dict[tuple[str, str], str]:
    """Return reasons that need no samples, by pair in the order of the links."""
    links = _left_links(robot)
    ruled_out = [{f"{SIDES[0]}_{link}" for link in pair} for pair in robot.arm.never_touch]
    first: dict[
        int,
        str,
    ] = {}  # by number of joints before it: the link that the last of them moves
    for name, joints in links.items():
        first.setdefault(joints, name)
    reasons: dict[tuple[str, str], str] = {}
    for a, b in itertools.combinations(links, 2):
        gap = links[b] - links[a]
        if gap == 0:
            reasons[a, b] = "rigid"
        elif gap == 1 and first[links[b]] == b:
            reasons[a, b] = "adjacent"
        elif {a, b} in ruled_out:
            reasons[a, b] = "model"
    return reasons


def model_hash(robot: Robot) -> str:
    """Hash geometry (URDF, meshes), limits and home, without installation paths."""
    urdf = pair_urdf(robot)
    digest = hashlib.sha256(_RULE_VERSION.encode())
    digest.update(re.sub(r'filename="[^"]*/([^"/]+)"', r'filename="\1"', urdf).encode())
    for file in sorted(set(re.findall(r'filename="([^"]+)"', urdf))):
        digest.update(Path(file).read_bytes())
    arm = robot.arm
    digest.update(
        repr((arm.home, arm.q_lower, arm.q_upper, robot.hand.travel_m, arm.never_touch)).encode(),
    )
    return digest.hexdigest()


TABLE = Box("table", position_m=(0.38, 0.0, -0.2), size_m=(1.2, 1.6, 0.4))
"""The simulated table, solid down to -0.4 m: no arm reaches under it."""

MIN_DISTANCE_MAX_M = 0.2


@dataclass(frozen=True)
class PlanningScene:
    """Obstacles, attached objects and allowed collisions.

    `PlanningScene(obstacles=())` lacks the table. Pairs of immobile parts are never checked.

    Raises:
        UsageError: A duplicate or unknown name, or bad `min_distance_m`.
    """

    obstacles: tuple[Shape, ...] = (TABLE,)
    attached: tuple[Attached, ...] = ()
    allowed: AllowedCollisions = field(default=None)  # type: ignore[assignment]
    """The robot's own matrix by default."""
    min_distance_m: float = 0.0
    """Distance [m] from obstacles, which are grown by it, unless contact is allowed."""
    robot: Robot = DUAL_PANDA

    def __post_init__(self) -> None:
        if self.allowed is None:
            object.__setattr__(self, "allowed", acm_report(self.robot).acm)
        names = self.names
        if twice := sorted({n for n in names if names.count(n) > 1}):
            shared = "links, obstacles and attached objects share one set of names"
            raise UsageError(f"the scene holds the name '{twice[0]}' twice; {shared}")
        known = links_of(self.robot)
        for attached in self.attached:
            for link in (attached.link, *attached.touch_links):
                check_name("link", link, known)
        if not (
            math.isfinite(self.min_distance_m) and 0.0 <= self.min_distance_m <= MIN_DISTANCE_MAX_M
        ):
            raise UsageError(
                f"min_distance_m = {self.min_distance_m}; it must be from 0 to {MIN_DISTANCE_MAX_M} m",
            )

    @cached_property
    def solids(self) -> tuple[Attached, ...]:
        """Obstacles grown by `min_distance_m`, attached to the link "world", and attached objects."""
        grown_obstacles = (grown(shape, self.min_distance_m) for shape in self.obstacles)
        return (*(Attached(shape, "world") for shape in grown_obstacles), *self.attached)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Colliding links, obstacles, attached objects."""
        return (
            *collision_links(self.robot),
            *(o.name for o in self.obstacles),
            *(a.name for a in self.attached),
        )

    @cached_property
    def checked_pairs(self) -> tuple[tuple[str, str], ...]:
        """Pairs that may not touch, in a fixed order."""
        return tuple(
            p for p in itertools.combinations(self.names, 2) if self.why_unchecked(*p) is None
        )

    def why_unchecked(self, a: str, b: str) -> str | None:
        """Return the reason, or None for a checked pair of known names."""
        moved_a = self._moved_by[a]
        moved_b = self._moved_by[b]
        if moved_a[1] == 0 and moved_b[1] == 0:
            return "neither moves"
        for held in self.attached:
            if held.name in (a, b):
                if moved_a == moved_b:
                    return "rigid"
                if a in held.touch_links or b in held.touch_links:
                    return f"held by {held.link}"
        return self._reasons.get((a, b) if a < b else (b, a))

    @cached_property
    def _reasons(self) -> dict[tuple[str, str], str]:
        return {(a, b): reason for a, b, reason in self.allowed}

    @cached_property
    def _moved_by(self) -> dict[str, tuple[str, int]]:
        """(side, number of joints that move it) by part; equal within a rigid piece."""
        moved = {
            name: (link.side, link.joints_before) for name, link in links_of(self.robot).items()
        }
        moved |= {obstacle.name: ("", 0) for obstacle in self.obstacles}
        return moved | {held.name: moved[held.link] for held in self.attached}

    def with_obstacles(self, *shapes: Shape) -> PlanningScene:
        """Return a copy with more obstacles."""
        return dataclasses.replace(self, obstacles=(*self.obstacles, *shapes))

    def with_attached(self, *objects: Attached) -> PlanningScene:
        """Return a copy with more attached objects."""
        return dataclasses.replace(self, attached=(*self.attached, *objects))

    def allowing(self, a: str, b: str, reason: str = "user") -> PlanningScene:
        """Return a copy allowing the pair."""
        if a == b:
            raise UsageError(f"a link cannot be paired with itself: '{a}'")
        first, second = sorted((a, b))
        return dataclasses.replace(self, allowed=self._others(a, b) | {(first, second, reason)})

    def forbidding(self, a: str, b: str) -> PlanningScene:
        """Return a copy checking the pair."""
        others = self._others(a, b)
        if others == self.allowed:
            raise UsageError(f"the pair {a} and {b} is checked already; it has no entry to remove")
        return dataclasses.replace(self, allowed=others)

    def _others(self, a: str, b: str) -> AllowedCollisions:
        for name in (a, b):
            check_name("link or obstacle", name, self.names)
        return frozenset(row for row in self.allowed if {a, b} != {*row[:2]})
