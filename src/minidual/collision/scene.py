"""The immutable, hashable planning scene."""

from __future__ import annotations

import dataclasses
import itertools
import math
from dataclasses import dataclass, field
from functools import cached_property

from minidual.collision.acm import AllowedCollisions, acm_report
from minidual.collision.shapes import Attached, Box, Shape, grown
from minidual.errors import UsageError, check_name
from minidual.robot.description import collision_links, links_of
from minidual.robot.pair import DUAL_PANDA, Robot

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
        self._check_names()
        distance_m = self.min_distance_m
        if not (math.isfinite(distance_m) and 0.0 <= distance_m <= MIN_DISTANCE_MAX_M):
            raise UsageError(
                f"min_distance_m = {distance_m}; it must be from 0 to {MIN_DISTANCE_MAX_M} m",
            )

    def _check_names(self) -> None:
        """Raise UsageError for a name that stands twice, or an unknown link."""
        repeated = sorted({name for name in self.names if self.names.count(name) > 1})
        if repeated:
            raise UsageError(
                f"the scene holds the name '{repeated[0]}' twice; links, obstacles and attached"
                " objects share one set of names",
            )
        links = links_of(self.robot)
        for attached in self.attached:
            for link in (attached.link, *attached.touch_links):
                check_name("link", link, links)

    @cached_property
    def solids(self) -> tuple[Attached, ...]:
        """Obstacles grown by `min_distance_m`, attached to the link "world"; attached objects."""
        obstacles = (grown(shape, self.min_distance_m) for shape in self.obstacles)
        return (*(Attached(shape, "world") for shape in obstacles), *self.attached)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Colliding links, obstacles, attached objects."""
        return (
            *collision_links(self.robot),
            *(obstacle.name for obstacle in self.obstacles),
            *(attached.name for attached in self.attached),
        )

    @cached_property
    def checked_pairs(self) -> tuple[tuple[str, str], ...]:
        """Pairs that may not touch, in a fixed order."""
        pairs = itertools.combinations(self.names, 2)
        return tuple(pair for pair in pairs if self.why_unchecked(*pair) is None)

    def why_unchecked(self, a: str, b: str) -> str | None:
        """Return the reason, or None for a checked pair of known names."""
        mover_a = self._moved_by[a]
        mover_b = self._moved_by[b]
        if mover_a[1] == 0 and mover_b[1] == 0:
            return "neither moves"
        for attached in self.attached:
            if attached.name not in (a, b):
                continue
            if mover_a == mover_b:
                return "rigid"
            if a in attached.touch_links or b in attached.touch_links:
                return f"held by {attached.link}"
        return self._reasons.get((a, b) if a < b else (b, a))

    @cached_property
    def _reasons(self) -> dict[tuple[str, str], str]:
        return {(a, b): reason for a, b, reason in self.allowed}

    @cached_property
    def _moved_by(self) -> dict[str, tuple[str, int]]:
        """(side, number of joints that move it) by part; equal within a rigid piece."""
        movers = {
            name: (link.side, link.joints_before) for name, link in links_of(self.robot).items()
        }
        for obstacle in self.obstacles:
            movers[obstacle.name] = ("", 0)
        attached_movers = {attached.name: movers[attached.link] for attached in self.attached}
        return movers | attached_movers

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
        """Return the allowed pairs but this one."""
        for name in (a, b):
            check_name("link or obstacle", name, self.names)
        pair = {a, b}
        return frozenset(row for row in self.allowed if {row[0], row[1]} != pair)
