"""Conditions of success on the true state of an object, which methods never read.

`observe` runs after every physics step, `end` once. A trial is finished when all conditions hold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from minidual.robot.pair import SIDES
from minidual.tasks.failures import of_limit
from minidual.tasks.truth import AIRBORNE_M, ObjectTruth, Truth

_FLOORS = ("pinch_min_n", "internal_force_min_n", "rise_m")
"""Measured numbers of which the least is the worst; of the others it is the largest."""


class SuccessCondition:
    """Base class; demands nothing."""

    name: str
    """Unique name."""
    stage: bool = False
    """Counts for `progress`."""
    optional: bool = False
    """Only measured unless demanded."""

    def each(self) -> Sequence[tuple[str, SuccessCondition]]:
        """Return its parts, each with the prefix of its violations."""
        return [("", self)]

    def has(self, method: str) -> bool:
        """Return whether it does more in `observe` or `holds` than this base class."""
        return getattr(type(self), method) is not getattr(SuccessCondition, method)

    def observe(self, truth: Truth) -> str:
        """Return the violation, or ""."""
        return ""

    def disturbed(self) -> None:
        """Tell that somebody has just moved an object: positions seen earlier may not hold."""

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
    """A condition of the final state: met unless `end` returns a violation."""

    def holds(self, truth: Truth) -> bool:
        return not self.end(truth)


@dataclass
class Level(OfObject):
    """Tilt limit."""

    name = "level"
    limit_rad: float
    _largest_rad: float = 0.0

    def observe(self, truth: Truth) -> str:
        tilt_rad = truth[self.object].tilt_rad
        if tilt_rad > self._largest_rad:
            self._largest_rad = tilt_rad
        if tilt_rad > self.limit_rad:
            limit_deg = np.degrees(self.limit_rad)
            return f"object tilted too far ({np.degrees(tilt_rad):.1f} deg, limit {limit_deg:.1f})"
        return ""

    def measured(self, truth: Truth) -> dict[str, float]:
        return {"tilt_max_rad": self._largest_rad}


@dataclass
class Whole(OfObject):
    """Pinch and hand force limits of a fragile object; None: it stands any."""

    name = "whole"
    pinch_max_n: float | None
    force_max_n: float | None

    def has(self, method: str) -> bool:
        fragile = self.pinch_max_n is not None or self.force_max_n is not None
        return fragile and super().has(method)

    def observe(self, truth: Truth) -> str:
        item = truth[self.object]
        pinch_n = max(item.pinch)
        if self.pinch_max_n is not None and pinch_n > self.pinch_max_n:
            return f"object broken (pinched with {pinch_n:.1f} N, limit {self.pinch_max_n:.0f})"
        if self.force_max_n is None:
            return ""
        left, right = item.hand_forces
        force_n = max(math.hypot(*left), math.hypot(*right))
        if force_n > self.force_max_n:
            return f"object broken (pressed with {force_n:.1f} N, limit {self.force_max_n:.0f})"
        return ""


@dataclass
class Clear(SuccessCondition):
    """No contact with the obstacle."""

    name = "clear"
    geom: str

    def observe(self, truth: Truth) -> str:
        if truth.touches(self.geom):
            return f"obstacle touched ({self.geom})"
        return ""


@dataclass
class Held(OfObject):
    """The hands pinch the object while it is off the table.

    Attributes:
        both: Whether both hands must pinch it, or any one.
        hand: Index of the one hand that must; None: see `both`.
    """

    name = "held"
    stage = True
    limit_n: float
    both: bool = True
    hand: int | None = None
    _least_n: float = math.inf

    def _judged_pinch(self, item: ObjectTruth) -> tuple[int, float]:
        """Return the hand that decides and its pinch [N]: the weaker one, or the firmer."""
        left, right = item.pinch
        if self.hand is not None:
            return self.hand, item.pinch[self.hand]
        right_decides = right < left if self.both else right > left
        return (1, right) if right_decides else (0, left)

    def observe(self, truth: Truth) -> str:
        item = truth[self.object]
        if not item.airborne:
            return ""
        hand, pinch_n = self._judged_pinch(item)
        if pinch_n < self._least_n:
            self._least_n = pinch_n
        if pinch_n > self.limit_n:
            return ""
        who = f"{SIDES[hand]} hand" if self.both else "firmer hand"
        return f"grip lost ({who} pinches {pinch_n:.1f} N, needs > {self.limit_n:.0f})"

    def reached(self, truth: Truth) -> bool:
        _, pinch_n = self._judged_pinch(truth[self.object])
        return pinch_n > self.limit_n

    def measured(self, truth: Truth) -> dict[str, float]:
        return {"pinch_min_n": _zero_if_infinite(self._least_n)}


@dataclass
class Squeezed(OfObject):
    """Least internal force off the table."""

    name = "squeezed"
    optional = True
    limit_n: float
    _least_n: float = math.inf

    def observe(self, truth: Truth) -> str:
        item = truth[self.object]
        if not item.airborne:
            return ""
        squeeze_n = item.squeeze_n
        if squeeze_n < self._least_n:
            self._least_n = squeeze_n
        if squeeze_n > self.limit_n:
            return ""
        return f"internal force lost ({squeeze_n:.1f} N, needs > {self.limit_n:.0f})"

    def measured(self, truth: Truth) -> dict[str, float]:
        return {"internal_force_min_n": _zero_if_infinite(self._least_n)}


@dataclass
class Rose(OfObject):
    """The object rises and comes down again."""

    name = "rose"
    stage = True
    limit_m: float
    _highest_m: float = 0.0

    def observe(self, truth: Truth) -> str:
        clearance_m = truth[self.object].clearance_m
        if clearance_m > self._highest_m:
            self._highest_m = clearance_m
        return ""

    def holds(self, truth: Truth) -> bool:
        return self._highest_m > AIRBORNE_M and not truth[self.object].airborne

    def reached(self, truth: Truth) -> bool:
        return self._highest_m > self.limit_m

    def end(self, truth: Truth) -> str:
        if self._highest_m > self.limit_m:
            return ""
        return f"object not lifted ({of_limit(1e3 * self._highest_m, 1e3 * self.limit_m, 'mm')})"

    def measured(self, truth: Truth) -> dict[str, float]:
        return {"rise_m": self._highest_m}


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
        error_m = truth[self.object].distance_m(self.goal)
        if error_m < self.limit_m:
            return ""
        return (
            f"object not at its goal ({1e3 * error_m:.1f} mm away, limit {1e3 * self.limit_m:.0f})"
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

    def _error_rad(self, truth: Truth) -> float:
        off_rad = truth[self.object].yaw_rad - self.goal_rad
        return abs(math.remainder(off_rad, math.tau / self.symmetry))

    def holds(self, truth: Truth) -> bool:
        return self._error_rad(truth) < self.limit_rad

    def end(self, truth: Truth) -> str:
        if self.holds(truth):
            return ""
        error_deg = np.degrees(self._error_rad(truth))
        limit_deg = np.degrees(self.limit_rad)
        return f"object points the wrong way ({error_deg:.1f} deg off, limit {limit_deg:.0f})"

    def measured(self, truth: Truth) -> dict[str, float]:
        return {"yaw_error_rad": self._error_rad(truth)}


@dataclass
class Released(AtEnd):
    """No part of an arm touches it."""

    name = "released"
    stage = True

    def holds(self, truth: Truth) -> bool:
        item = truth[self.object]
        return not item.in_fingers and not item.at_an_arm

    def end(self, truth: Truth) -> str:
        item = truth[self.object]
        if item.in_fingers:
            return f"object not released (a finger still touches the {self.object})"
        if item.at_an_arm:
            return f"object not released (an arm still touches the {self.object})"
        return ""


@dataclass
class AtRest(AtEnd):
    """It rests on the table."""

    name = "at_rest"
    limit_m_per_s: float

    def holds(self, truth: Truth) -> bool:
        item = truth[self.object]
        return item.speed_m_per_s < self.limit_m_per_s and item.on_table

    def end(self, truth: Truth) -> str:
        if self.holds(truth):
            return ""
        item = truth[self.object]
        place = "on the table" if item.on_table else "off the table"
        return f"object not at rest ({item.speed_m_per_s:.3f} m/s, {place})"


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
        for part in self.parts:
            detail = part.end(truth)
            if detail:
                return f"{part.object}: {detail}"
        return ""

    def measured(self, truth: Truth) -> dict[str, float]:
        rows = [part.measured(truth) for part in self.parts]
        numbers: dict[str, float] = {}
        for name in rows[0]:
            worst = min if name in _FLOORS else max
            numbers[name] = worst(row[name] for row in rows)
        return numbers


@dataclass
class OnTime(SuccessCondition):
    """Time limit."""

    name = "on_time"
    limit_s: float

    def end(self, truth: Truth) -> str:
        if truth.duration_s > self.limit_s:
            return f"too late ({truth.duration_s:.1f} s, limit {self.limit_s:.0f})"
        return ""


def _zero_if_infinite(least_n: float) -> float:
    """Return a least force [N]; 0 if none was measured."""
    return least_n if math.isfinite(least_n) else 0.0
