"""Conditions of success on the true state of an object, which methods never read.

`observe` runs after every physics step, `end` once. A trial is finished when all conditions hold.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from minidual.config.scene import ObjectConfig
from minidual.plant.bodies import lie
from minidual.robot.pair import SIDES, Array

if TYPE_CHECKING:  # reading a configuration must not import MuJoCo
    from minidual.plant.world import World

AIRBORNE_M = 0.003
"""An object is off the table above this clearance."""
NEAR_M = 0.05
"""An object may be on the table this near to its start or goal."""
_FLOORS = (
    "pinch_min_n",
    "internal_force_min_n",
    "rise_m",
)  # measured numbers of which the least is the worst
TOUCH_N = 0.1
"""Smaller forces do not count as touch."""


class ObjectTruth:
    """True state of one object.

    Attributes:
        xyz: (x, y, z) [m] of its centre.
        tilt_rad: Of its long axis from the horizontal, or from the vertical if upright.
        solids: (k, 8), place and half extents (3,) [m] in its frame, whether round, and its axis; as they are in the trial.
        clearance_m: Height of its lowest point above the table.
        pinch: Normal force of each hand's weaker finger [N].
        squeeze_n: Internal force: the smaller inward hand force along y.
        yaw_rad: Yaw of its y axis.
    """

    def __init__(self, name: str, body: ObjectConfig) -> None:
        self.name = name
        self.body = body
        self._upright = body.upright
        self.half_m = body.solids[0].half_m
        self._world: World | None = None

    def refresh(self, world: World) -> None:
        """Read the world."""
        if world is not self._world:
            self._world = world
            self._object = world.truth(self.name)
            # A condition may have changed their size.
            solids = zip(self.body.solids, self._object.solids(self.body.solids), strict=True)
            rows = [
                (*at, *half, p.shape == "cylinder", "xyz".index(p.axis)) for p, (at, half) in solids
            ]
            self.solids = np.array(rows)
            self.half_m = rows[0][3:6]
        seen = self._object.look()
        self.tilt_rad, self.clearance_m = lie(seen, self.solids, self._upright)
        # Plain floats: a success test of arrays costs four times as much.
        self._seen = numbers = seen.tolist()
        x, y, z, *_, left, right, self.squeeze_n, self.yaw_rad = numbers
        self.xyz = (x, y, z)
        self.pinch = (left, right)
        self.airborne = self.clearance_m > AIRBORNE_M

    def distance_m(self, xy: Sequence[float]) -> float:
        """Return the horizontal distance of its centre."""
        return math.hypot(self.xyz[0] - xy[0], self.xyz[1] - xy[1])

    @property
    def hand_forces(self) -> tuple[list[float], list[float]]:
        """Net force (3,) [N] of each hand."""
        return self._seen[6:9], self._seen[9:12]

    @property
    def frame(self) -> tuple[Array, Array]:
        """Orientation (3, 3) and position (3,) [m] in the world, in MuJoCo's own memory: they change with it."""
        return self._object.frame

    @property
    def T(self) -> Array:
        """Pose (4, 4) in the world."""
        return self._object.pose()

    @property
    def speed_m_per_s(self) -> float:
        return math.hypot(*self._object.twist()[:3].tolist())

    @property
    def on_table(self) -> bool:
        return self._world is not None and self._world.on_table(self.name)


class Truth(dict[str, ObjectTruth]):
    """True state of a task's objects, by name.

    duration_s is the time of the finish, else of now; the judge sets it before `end`.
    """

    def __init__(self, objects: Mapping[str, ObjectConfig]) -> None:
        super().__init__({name: ObjectTruth(name, body) for name, body in objects.items()})
        self._world: World | None = None
        self.time = self.duration_s = 0.0

    def refresh(self, world: World) -> None:
        """Read the world."""
        self._world = world
        self.time = world.time
        for item in self.values():
            item.refresh(world)

    def touches(self, geom: str) -> bool:
        """See `World`."""
        return self._world is not None and self._world.touches(geom)


class SuccessCondition:
    """Base class; demands nothing."""

    name: str
    """Unique name."""
    stage: bool = False
    """Counts for `progress`."""
    optional: bool = False
    """Only measured unless demanded."""

    def each(self) -> Sequence[tuple[str, SuccessCondition]]:
        """Return its parts, each with what introduces its violations."""
        return [("", self)]

    def has(self, method: str) -> bool:
        """Return whether it does more in `observe` or `holds` than this base class."""
        return getattr(type(self), method) is not getattr(SuccessCondition, method)

    def observe(self, truth: Truth) -> str:
        """Return the violation, or ""."""
        return ""

    def disturbed(self) -> None:
        """Tell that somebody has just moved an object; what was seen before may not hold."""

    def holds(self, truth: Truth) -> bool:
        """Return whether the final state is reached."""
        return True

    def reached(self, truth: Truth) -> bool:
        """Return whether its stage is reached."""
        return self.holds(truth)

    def end(self, truth: Truth) -> str:
        """Return the final violation, or ""."""
        return ""

    def measured(self, truth: Truth) -> dict[str, float]:
        """Return numbers by name."""
        return {}


@dataclass
class OfObject(SuccessCondition):
    """A condition of one object, by its name."""

    object: str


class AtEnd(OfObject):
    """A condition of the final state: met unless `end` says what is wrong."""

    def holds(self, truth: Truth) -> bool:
        return not self.end(truth)


@dataclass
class Level(OfObject):
    """Tilt limit."""

    name = "level"
    limit_rad: float
    _largest: float = 0.0

    def observe(self, truth: Truth) -> str:
        tilt = truth[self.object].tilt_rad
        if tilt > self._largest:
            self._largest = tilt
        if tilt > self.limit_rad:
            return f"tilt {np.degrees(tilt):.1f} deg, limit {np.degrees(self.limit_rad):.1f}"
        return ""

    def measured(self, truth: Truth) -> dict[str, float]:
        return {"tilt_max_rad": self._largest}


@dataclass
class Whole(OfObject):
    """Pinch and hand force limits of a fragile object."""

    name = "whole"
    pinch_max_n: float | None
    force_max_n: float | None

    def has(self, method: str) -> bool:
        return super().has(method) and not (self.pinch_max_n is self.force_max_n is None)

    def observe(self, truth: Truth) -> str:
        item = truth[self.object]
        pinch = max(item.pinch)
        if self.pinch_max_n is not None and pinch > self.pinch_max_n:
            return f"the object broke: pinch {pinch:.1f} N, it stands {self.pinch_max_n:.0f} N"
        if self.force_max_n is not None:
            left, right = item.hand_forces
            force = max(math.hypot(*left), math.hypot(*right))
            if force > self.force_max_n:
                return f"the object broke: a hand pressed with {force:.1f} N, it stands {self.force_max_n:.0f} N"
        return ""


@dataclass
class Clear(SuccessCondition):
    """No contact with the obstacle."""

    name = "clear"
    geom: str

    def observe(self, truth: Truth) -> str:
        return f"something touches the {self.geom}" if truth.touches(self.geom) else ""


@dataclass
class Held(OfObject):
    """Once lifted, both hands (`both=False`: one; `hand`: this one) pinch the object while it is off the table or moves.

    On the table it may slip or roll by `slip_m` after its release.
    """

    name = "held"
    stage = True
    limit_n: float
    both: bool = True
    slip_m: float = 0.02
    hand: int | None = None
    _least: float = math.inf
    _let_go: tuple[float, float, float] | None = None

    def _pinch(self, item: ObjectTruth) -> tuple[int, float]:
        left, right = pinch = item.pinch
        hand = self.hand
        if hand is None:  # the weaker one, or the firmer
            hand = 1 if (right < left if self.both else right > left) else 0
        return hand, pinch[hand]

    def observe(self, truth: Truth) -> str:
        item = truth[self.object]
        if not item.airborne and self._let_go is None:
            return ""
        hand, pinch = self._pinch(item)
        if item.airborne and pinch < self._least:
            self._least = pinch
        if pinch > self.limit_n:
            self._let_go = item.xyz
            return ""
        self._let_go = self._let_go or item.xyz
        if not (item.airborne or item.distance_m(self._let_go) > self.slip_m):
            return ""
        who = f"{SIDES[hand]} hand pinches" if self.both else "the firmer hand pinches"
        moving = (
            ""
            if item.airborne
            else f" while it moves {1e3 * item.distance_m(self._let_go):.0f} mm on the table"
        )
        return f"{who} {pinch:.1f} N{moving}, needs > {self.limit_n:.0f}"

    def reached(self, truth: Truth) -> bool:
        return self._pinch(truth[self.object])[1] > self.limit_n

    def measured(self, truth: Truth) -> dict[str, float]:
        return {"pinch_min_n": self._least if math.isfinite(self._least) else 0.0}


@dataclass
class Carried(OfObject):
    """The object is off the table all the way between start and goal, (x, y) [m] each."""

    name = "carried"
    start: tuple[float, float]
    goal: tuple[float, float]

    def observe(self, truth: Truth) -> str:
        item = truth[self.object]
        if item.airborne:
            return ""
        start = item.distance_m(self.start)
        goal = item.distance_m(self.goal)
        if min(start, goal) < NEAR_M:
            return ""
        return f"on the table {1e3 * start:.0f} mm from its start and {1e3 * goal:.0f} mm from its goal"


@dataclass
class Stood(OfObject):
    """On the table, the object stays where it came down: nothing pushes, drags or rolls it."""

    name = "stood"
    limit_m: float = 0.02
    _at: tuple[float, float] | None = None

    def observe(self, truth: Truth) -> str:
        item = truth[self.object]
        if item.airborne:
            self._at = None
            return ""
        self._at = self._at or item.xyz[:2]
        off = item.distance_m(self._at)
        return (
            f"moved {1e3 * off:.0f} mm on the table, limit {1e3 * self.limit_m:.0f}"
            if off > self.limit_m
            else ""
        )

    def disturbed(self) -> None:
        self._at = None


@dataclass
class Exchanged(AtEnd):
    """Both hands pinch the object off the table."""

    name = "exchanged"
    stage = True
    limit_n: float
    _seen: bool = False

    def observe(self, truth: Truth) -> str:
        item = truth[self.object]
        self._seen = self._seen or (item.airborne and min(item.pinch) > self.limit_n)
        return ""

    def end(self, truth: Truth) -> str:
        return (
            ""
            if self._seen
            else f"both hands never pinched it in the air with more than {self.limit_n:.0f} N"
        )


@dataclass
class Squeezed(OfObject):
    """Least internal force off the table."""

    name = "squeezed"
    optional = True
    limit_n: float
    _least: float = math.inf

    def observe(self, truth: Truth) -> str:
        item = truth[self.object]
        if not item.airborne:
            return ""
        squeeze = item.squeeze_n
        if squeeze < self._least:
            self._least = squeeze
        return (
            ""
            if squeeze > self.limit_n
            else f"internal force {squeeze:.1f} N, needs > {self.limit_n:.0f}"
        )

    def measured(self, truth: Truth) -> dict[str, float]:
        return {"internal_force_min_n": self._least if math.isfinite(self._least) else 0.0}


@dataclass
class Rose(OfObject):
    """The object rises and comes down again."""

    name = "rose"
    stage = True
    limit_m: float
    _most: float = 0.0

    def observe(self, truth: Truth) -> str:
        clearance_m = truth[self.object].clearance_m
        if clearance_m > self._most:
            self._most = clearance_m
        return ""

    def holds(self, truth: Truth) -> bool:
        return self._most > AIRBORNE_M and not truth[self.object].airborne

    def reached(self, truth: Truth) -> bool:
        return self._most > self.limit_m

    def end(self, truth: Truth) -> str:
        return (
            ""
            if self._most > self.limit_m
            else f"rose {1e3 * self._most:.0f} mm, needs > {1e3 * self.limit_m:.0f}"
        )

    def measured(self, truth: Truth) -> dict[str, float]:
        return {"rise_m": self._most}


@dataclass
class Arrived(AtEnd):
    """The object is near its goal (x, y) [m]."""

    name = "arrived"
    stage = True
    goal: tuple[float, float]
    limit_m: float

    def holds(self, truth: Truth) -> bool:
        return truth[self.object].distance_m(self.goal) < self.limit_m

    def end(self, truth: Truth) -> str:
        error = truth[self.object].distance_m(self.goal)
        return (
            ""
            if error < self.limit_m
            else f"{1e3 * error:.1f} mm from the goal, limit {1e3 * self.limit_m:.0f}"
        )

    def measured(self, truth: Truth) -> dict[str, float]:
        return {"goal_error_m": truth[self.object].distance_m(self.goal)}


@dataclass
class Turned(OfObject):
    """The yaw is near the goal; 1 / `symmetry` of a turn is equal."""

    name = "turned"
    goal_rad: float
    limit_rad: float
    symmetry: int = 1

    def _error(self, truth: Truth) -> float:
        return abs(
            math.remainder(truth[self.object].yaw_rad - self.goal_rad, math.tau / self.symmetry),
        )

    def holds(self, truth: Truth) -> bool:
        return self._error(truth) < self.limit_rad

    def end(self, truth: Truth) -> str:
        off, limit = np.degrees([self._error(truth), self.limit_rad])
        return "" if off < limit else f"{off:.1f} deg off its direction, limit {limit:.0f}"

    def measured(self, truth: Truth) -> dict[str, float]:
        return {"yaw_error_rad": self._error(truth)}


@dataclass
class Released(OfObject):
    """No finger touches it."""

    name = "released"
    stage = True

    def holds(self, truth: Truth) -> bool:
        item = truth[self.object]
        left, right = item.pinch
        free = left < TOUCH_N and right < TOUCH_N
        return free and all(abs(f) <= TOUCH_N for hand in item.hand_forces for f in hand)

    def end(self, truth: Truth) -> str:
        return "" if self.holds(truth) else f"a finger still touches the {self.object}"


@dataclass
class AtRest(AtEnd):
    """It rests on the table."""

    name = "at_rest"
    limit_m_per_s: float

    def holds(self, truth: Truth) -> bool:
        item = truth[self.object]
        return item.speed_m_per_s < self.limit_m_per_s and item.on_table

    def end(self, truth: Truth) -> str:
        item = truth[self.object]
        return (
            ""
            if self.holds(truth)
            else f"speed {item.speed_m_per_s:.3f} m/s, on the table: {item.on_table}"
        )


class Each(SuccessCondition):
    """One condition of several objects; its numbers are the worst."""

    def __init__(self, parts: Sequence[OfObject], *, stage: bool = False) -> None:
        self.name = parts[0].name
        self.optional = parts[0].optional
        self.parts = parts
        self.stage = stage

    def each(self) -> Sequence[tuple[str, SuccessCondition]]:
        return [(f"{part.object}: ", part) for part in self.parts]

    def disturbed(self) -> None:
        for part in self.parts:
            part.disturbed()

    def reached(self, truth: Truth) -> bool:
        return all(part.reached(truth) for part in self.parts)

    def end(self, truth: Truth) -> str:
        return next(
            (f"{part.object}: {detail}" for part in self.parts if (detail := part.end(truth))),
            "",
        )

    def measured(self, truth: Truth) -> dict[str, float]:
        rows = [part.measured(truth) for part in self.parts]
        return {
            name: (min if name in _FLOORS else max)(row[name] for row in rows) for name in rows[0]
        }


@dataclass
class OnTime(SuccessCondition):
    """Time limit."""

    name = "on_time"
    limit_s: float

    def end(self, truth: Truth) -> str:
        late = truth.duration_s > self.limit_s
        return f"{truth.duration_s:.1f} s, limit {self.limit_s:.0f}" if late else ""
