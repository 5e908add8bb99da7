"""Close the hands to a force F, without knowing what they hold.

    closing   target' = -sat(k (F - f), speed),  f measured
    opening   target' = +speed

The target stays within half the travel of the fingers. Pinch and squeeze: docs/force-control.md.
"""

import math

import numpy as np
from numba.core import types

from minidual.errors import UsageError
from minidual.plant.protocol import Plant
from minidual.robot.compiled import ROWS, VIEW, kernel
from minidual.robot.pair import SIDES, Array

SAFETY = 1.5  # friction varies by some tenths between pads and days
GRAVITY_M_PER_S2 = 9.81


def pinch_force(
    squeeze_n: float,
    mu: float,
    mass_kg: float = 0.0,
    *,
    safety: float = SAFETY,
) -> float:
    """Return each finger's normal force [N].

    Raises:
        UsageError: A value is out of range.
    """
    if not mu > 0.0:
        raise UsageError(
            f"friction coefficient {mu}: must be above 0, no pinch holds without friction",
        )
    if not mass_kg >= 0.0:
        raise UsageError(f"mass {mass_kg} kg: must be at least 0")
    if not safety >= 1.0:
        raise UsageError(f"safety factor {safety}: must be at least 1")
    if not squeeze_n >= 0.0:
        raise UsageError(f"squeeze {squeeze_n} N: must be at least 0, hands do not pull")
    return safety * math.hypot(squeeze_n, 0.5 * mass_kg * GRAVITY_M_PER_S2) / (2.0 * mu)


CLOSE_BELOW = 0.4
OPEN_ABOVE = 0.6
"""Hysteresis against opening commands wavering about the middle."""
JOINT_PINCH_N = 60.0
"""Pinch force in joint-space modes: 1.5 times the internal force a stiff pair can demand."""
_SERVO_N_PER_M = 5000.0  # k: this servo settles with a 20 ms time constant
_COMPLIANCE_M_PER_NS = 0.01
_HOLDS_N = 5.0
"""A hand that feels more at the start holds something."""
_NEAR = 0.9
_FIRMER = 1.3
_MOST = 0.95
"""Where an object slips, the pinch rises by this factor, to no more than this share of what the motors give."""
_LOST = 0.5
_LOST_S = 0.004
"""Below this share for this long, a grip is lost."""
_LAG_M = 0.005
"""Fingers on the way are no further from their target."""
_NOTHING_M = 0.002
"""Nearer to the middle, fingers have closed on nothing."""
_SLIPPED_M = 0.0003
"""Fingers that close further have lost the object, or were shaken."""


_OPEN, _TARGET, _HELD, _LOST_N = range(4)
_OPENS = 1
_LOSES = 2
_WIDE = 4


@kernel(types.intp(VIEW, VIEW, VIEW, ROWS, types.float64, types.UniTuple(types.float64, 3)))
def advance(
    command: Array,
    felt: Array,
    fingers: Array,
    hands: Array,
    force_n: float,
    how: tuple[float, float, float],
) -> int:
    """Advance `hands` (4, 2): open or closed, target [m], fingers [m] when they held, ticks without the grip.

    command: NaN keeps the target. how: gain, step [m], travel [m]. Return the sum of 1 if a hand begins to open, 2 if a
    closed one has lost its grip in this tick, and 4 if both are fully open.
    """
    found = 0
    wide_n = 0
    (gain, step_m, travel_m) = how
    if len(felt) != 2 or len(fingers) != 2:
        raise ValueError("the grip and the fingers of both hands are two numbers each")
    for i in range(2):
        if math.isnan(command[i]):
            continue
        if command[i] > OPEN_ABOVE:
            if not hands[_OPEN, i]:
                found = found | _OPENS
                hands[_LOST_N, i] = 0.0
            hands[_OPEN, i] = 1.0
        elif command[i] < CLOSE_BELOW:
            hands[_OPEN, i] = 0.0
        if hands[_OPEN, i]:
            hands[_HELD, i], hands[_TARGET, i] = math.nan, min(hands[_TARGET, i] + step_m, travel_m)
            wide_n += hands[_TARGET, i] == travel_m
            continue
        moved = fingers[i] - hands[_HELD, i]
        away = abs(moved) > _NOTHING_M or math.isnan(
            fingers[i],
        )  # opened, closed on less than it held, or not known
        way = gain * (felt[i] - force_n)
        target = min(
            hands[_TARGET, i] + (step_m if way > step_m else -step_m if way < -step_m else way),
            travel_m,
        )
        if felt[i] >= _NEAR * force_n and not away:
            if math.isnan(hands[_HELD, i]):
                hands[_HELD, i] = fingers[i]
            hands[_TARGET, i], hands[_LOST_N, i] = target, 0.0
            continue
        if not math.isnan(felt[i]):  # else the target stays; it is not far ahead of the fingers
            behind = min(
                fingers[i] - 0.5 * travel_m,
                hands[_TARGET, i] + step_m,
            )  # one reading may be wrong
            hands[_TARGET, i] = max(min(target, hands[_TARGET, i]), behind)
        lost = away or (not felt[i] >= _LOST * force_n and moved > -_SLIPPED_M)
        hands[_LOST_N, i], found = (
            (hands[_LOST_N, i] + 1.0, found | _LOSES) if lost else (0.0, found)
        )
    return found | (_WIDE if wide_n == 2 else 0)


class Grippers:
    """Turns opening commands (0 closed, 1 open) into finger targets [m].

    The closing force is limited to what the motors give.
    """

    def __init__(
        self,
        plant: Plant,
        *,
        pinch_force_n: float = JOINT_PINCH_N,
        speed_m_per_s: float = 0.08,
    ) -> None:
        self._plant = plant
        self._travel_m = plant.robot.hand.travel_m
        self._usual_n = min(pinch_force_n, plant.grip_max_n)
        self._firm_n = max(self._usual_n, min(_FIRMER * self._usual_n, _MOST * plant.grip_max_n))
        self._lost_ticks = max(1.0, _LOST_S / plant.dt)
        self._how = (
            min(_COMPLIANCE_M_PER_NS * plant.dt, 0.5 / _SERVO_N_PER_M),
            speed_m_per_s * plant.dt,
            self._travel_m,
        )
        self.reset()

    def reset(self) -> None:
        """Start with open hands, or closed where they hold something, and the usual pinch.

        Raises:
            UsageError: The grip is not measured.
        """
        grip = self._plant.grip
        self._force_n = self._usual_n
        if not np.isfinite(grip + self._plant.fingers).all():
            raise UsageError(
                f"the grip is not measured ({grip} N)",
                remedy="begin once both hands are measured",
            )
        self.closed = grip > _HOLDS_N
        """(2,) of the start; a program that begins anew lets nothing fall."""
        self._hands = np.ones((4, 2))
        self.wide = not self.closed.any()
        """wide: whether both hands are fully open."""
        self.targets_m = np.where(
            self.closed,
            self._plant.fingers - grip / _SERVO_N_PER_M,
            self._travel_m,
        )
        self._hands[_OPEN], self._hands[_TARGET] = ~self.closed, self.targets_m
        self.forget_grip()

    def forget_grip(self, *, excused: bool = False) -> None:
        """Expect no grip until hands close on something anew; `excused`: nor fingers to be measured, where they are not."""
        self._hands[_HELD:] = [[math.nan], [0.0]]
        self.fault = ""
        """fault: which hand lost its grip, or empty."""
        if excused:
            self._hands[
                _LOST_N,
                np.isnan(self._plant.fingers),
            ] = -np.inf  # until they are measured, or the hand opens

    def close(self, targets_m: Array) -> None:
        """Start closed on an object, at finger targets (2,) [m]."""
        self._hands[_OPEN], self._hands[_TARGET], self.targets_m, self.wide = (
            0.0,
            targets_m,
            targets_m.copy(),
            False,
        )

    def firmer(self) -> None:
        """From now on, pinch harder."""
        self._force_n = self._firm_n

    def stop(self) -> Array:
        """Return the command (2,) of a stop: fingers on the way stay where they are (NaN), other hands go on."""
        fingers = self._plant.fingers
        (opening, target_m, held_m, _) = self._hands
        moving = np.isnan(held_m) & ((opening == 0.0) | (target_m < self._travel_m))
        free = moving & ~(self._plant.grip > _HOLDS_N) & np.isfinite(fingers)
        near = np.clip(
            fingers,
            target_m - _LAG_M,
            target_m + _LAG_M,
        )  # the reading may be what the stop is for
        target_m[free] = np.clip(near[free], 0.0, self._travel_m)
        return np.where(moving, np.nan, opening)

    @property
    def openings(self) -> Array:
        """What was commanded last (2,), 0 closed or 1 open; a stop changes nothing."""
        return self._hands[_OPEN].copy()

    def step(self, command: Array) -> Array:
        """Advance towards command (2,), NaN for fingers that stay; return finger targets (2,) [m]."""
        if self.wide and min(command.tolist()) > OPEN_ABOVE:
            return self.targets_m
        grip = self._plant.grip
        fingers = self._plant.fingers
        found = advance(command, grip, fingers, self._hands, self._force_n, self._how)
        self.targets_m = self._hands[_TARGET].copy()
        self.wide = found >= _WIDE
        if found & _OPENS:
            self.fault = ""
        if found & _LOSES:
            self._name_lost(grip, fingers)
        return self.targets_m

    def holds(self, hand: int) -> bool:
        """Return whether a hand has closed on something and feels it."""
        between_m = min(self._hands[_HELD, hand], self._plant.fingers[hand])
        return bool(between_m > _NOTHING_M and self._plant.grip[hand] >= _LOST * self._force_n)

    def lost(self, hand: int) -> bool:
        """Return whether a hand had closed on something that has slid out, or been torn out."""
        torn = self._hands[_LOST_N, hand] > self._lost_ticks
        return bool(
            self._hands[_HELD, hand] > _NOTHING_M
            and (torn or self._plant.fingers[hand] <= _NOTHING_M),
        )

    def _name_lost(self, grip: Array, fingers: Array) -> None:
        for hand, (_, _, held_m, lost_n) in enumerate(self._hands.T):
            if lost_n > self._lost_ticks:
                what = f"{grip[hand]:.0f} of {self._force_n:.0f} N, fingers {1e3 * (fingers[hand] - held_m):+.1f} mm"
                self.fault = f"the {SIDES[hand]} hand: {what}"
