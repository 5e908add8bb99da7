"""The planning scene: the two arms, what stands round them, what they hold, and which pairs may touch.

A scene is immutable and hashable; every change returns a copy. It knows no collision library: both engines are
built from `checked_pairs`, so they look at exactly the same pairs.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from dataclasses import dataclass, field
from functools import cached_property

from minidual.collision.acm import default_acm
from minidual.collision.allowed import AllowedCollisions
from minidual.collision.links import LINKS, arm_of, joints_before
from minidual.collision.shapes import Box, Shape, grown
from minidual.errors import UsageError, unknown_name

TABLE = Box("table", position_m=(0.38, 0.0, -0.2), size_m=(1.2, 1.6, 0.4))
"""The table of the simulated world. It is taken as solid down to 0.4 m: no arm reaches in under the top."""

MIN_DISTANCE_MAX_M = 0.2


@dataclass(frozen=True)
class Attached:
    """An object that moves with a link.

    shape: Its place is given in the frame of `link`.
    link: The link that carries it, for example "left_panda_hand".
    touch_links: Links that may touch it (the fingers of a hand that holds it).
    """

    shape: Shape
    link: str
    touch_links: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of the shape."""
        return self.shape.name


@dataclass(frozen=True)
class PlanningScene:
    """Obstacles, attached objects and allowed collisions.

    The table is an obstacle like the others: `PlanningScene(obstacles=())` is empty space. The bases stand on
    the table; pairs of which neither part can move are never checked.

    Raises:
        UsageError: Two things of one name, a name that a link has, or an unknown link.
    """

    obstacles: tuple[Shape, ...] = (TABLE,)
    attached: tuple[Attached, ...] = ()
    allowed: AllowedCollisions = field(default_factory=default_acm)
    min_distance_m: float = 0.0
    """Distance [m] that arms and held objects must keep from every obstacle that they may not touch: both engines see
    the obstacles grown by it, so a path that comes nearer is refused as one that collides."""

    def __post_init__(self) -> None:
        names = [*LINKS, *(o.name for o in self.obstacles), *(a.name for a in self.attached)]
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise UsageError(
                f"the scene holds the name '{twice[0]}' twice; links, obstacles and attached objects "
                "share one set of names"
            )
        for attached in self.attached:
            for link in (attached.link, *attached.touch_links):
                if arm_of(link) is None:
                    raise unknown_name("link", link, LINKS)
        if not (math.isfinite(self.min_distance_m) and 0.0 <= self.min_distance_m <= MIN_DISTANCE_MAX_M):
            raise UsageError(f"min_distance_m = {self.min_distance_m}; it must be from 0 to {MIN_DISTANCE_MAX_M} m")

    @cached_property
    def solid_obstacles(self) -> tuple[Shape, ...]:
        """What the engines are built from: the obstacles, grown by the distance to keep."""
        return tuple(grown(shape, self.min_distance_m) for shape in self.obstacles)

    @property
    def names(self) -> tuple[str, ...]:
        """Everything in the scene that can touch something: links, obstacles, attached objects."""
        return (*LINKS, *(o.name for o in self.obstacles), *(a.name for a in self.attached))

    @cached_property
    def checked_pairs(self) -> tuple[tuple[str, str], ...]:
        """Every pair that both engines check, in a fixed order."""
        return tuple(p for p in itertools.combinations(self.names, 2) if self.why_unchecked(*p) is None)

    def why_unchecked(self, a: str, b: str) -> str | None:
        """Return why the pair is not checked, or None if it is."""
        for name in (a, b):
            if name not in self.names:
                raise unknown_name("link or obstacle", name, self.names)
        if self._joints(a) == 0 and self._joints(b) == 0:
            return "neither moves"
        for mine, other in ((a, b), (b, a)):
            held = self._attached_by_name.get(mine)
            if held is not None:
                if self._carrier(mine) == self._carrier(other):
                    return "rigid"
                if other in held.touch_links:
                    return f"held by {held.link}"
        return self.allowed.reason(a, b)

    @cached_property
    def _attached_by_name(self) -> dict[str, Attached]:
        return {a.name: a for a in self.attached}

    def _link(self, name: str) -> str | None:
        held = self._attached_by_name.get(name)
        if held is not None:
            return held.link
        return name if name in LINKS else None

    def _joints(self, name: str) -> int:
        link = self._link(name)
        return 0 if link is None else joints_before(link)

    def _carrier(self, name: str) -> tuple[str | None, int]:
        """Return (arm, number of joints before it): equal for parts that move as one piece."""
        link = self._link(name)
        return (None, 0) if link is None else (arm_of(link), joints_before(link))

    def moving_joints(self, name: str) -> slice:
        """Return the joints of `q` that move this link or object (an empty slice if none does)."""
        link = self._link(name)
        if link is None:
            return slice(0, 0)
        first = 0 if arm_of(link) == "left" else 7
        return slice(first, first + joints_before(link))

    def with_obstacles(self, *shapes: Shape) -> PlanningScene:
        """Return a copy with more obstacles."""
        return dataclasses.replace(self, obstacles=(*self.obstacles, *shapes))

    def without_obstacle(self, name: str) -> PlanningScene:
        """Return a copy without the named obstacle."""
        if name not in [o.name for o in self.obstacles]:
            raise unknown_name("obstacle", name, [o.name for o in self.obstacles])
        return dataclasses.replace(self, obstacles=tuple(o for o in self.obstacles if o.name != name))

    def with_attached(self, *objects: Attached) -> PlanningScene:
        """Return a copy in which these objects move with their links."""
        return dataclasses.replace(self, attached=(*self.attached, *objects))

    def allowing(self, a: str, b: str, reason: str = "user") -> PlanningScene:
        """Return a copy in which a and b may touch."""
        self.why_unchecked(a, b)  # names must exist
        return dataclasses.replace(self, allowed=self.allowed.with_pair(a, b, reason))

    def forbidding(self, a: str, b: str) -> PlanningScene:
        """Return a copy in which a and b are checked again."""
        self.why_unchecked(a, b)
        return dataclasses.replace(self, allowed=self.allowed.without_pair(a, b))
