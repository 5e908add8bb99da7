"""Close the hands to a force F, without knowing what they hold.

    closing   target' = -sat(k (F - f), speed),  f measured
    opening   target' = +speed

The target stays within half the travel of the fingers. Pinch and squeeze: docs/force-control.md.
"""

import math

import numpy as np
from numba.core import types

from minidual.control.kernels import within
from minidual.errors import UsageError
from minidual.plant.protocol import Plant
from minidual.robot.compiled import ROWS, VECTOR, VIEW, kernel
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
SPEED_M_PER_S = 0.08
"""Speed of a finger."""
_SERVO_N_PER_M = 5000.0  # k: this servo settles with a 20 ms time constant
_COMPLIANCE_M_PER_NS = 0.01
_HOLDS_N = 5.0
"""A hand that feels more than this at the start holds something."""
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


_OPEN, _TARGET, _HELD, _LOST_TICKS = range(4)
_OPENS = 1
_LOSES = 2
_WIDE = 4


@kernel(types.intp(VIEW, VIEW, VIEW, ROWS, types.float64, VECTOR))
def advance(
    command: Array,
    grip_n: Array,
    fingers_m: Array,
    hands: Array,
    force_n: float,
    constants: Array,
) -> int:
    """Advance both hands by one step.

    Args:
        command: Openings (2,), 0 closed to 1 open; NaN keeps the finger target.
        grip_n, fingers_m: Measured (2,).
        hands: (4, 2), updated: 1 open or 0 closed, finger target [m], fingers [m] when they held, and ticks
            without the grip.
        force_n: Grip force of closed hands.
        constants: Gain [m/N], step [m], travel [m].

    Returns:
        The sum of 1 if a hand begins to open, 2 if a closed one has no grip in this tick, 4 if both are wide.
    """
    events = 0
    wide_n = 0
    gain = constants[0]
    step_m = constants[1]
    travel_m = constants[2]
    for i in range(2):
        if math.isnan(command[i]):
            continue
        if command[i] > OPEN_ABOVE:
            if not hands[_OPEN, i]:
                events |= _OPENS
                hands[_LOST_TICKS, i] = 0.0
            hands[_OPEN, i] = 1.0
        elif command[i] < CLOSE_BELOW:
            hands[_OPEN, i] = 0.0
        if hands[_OPEN, i]:
            hands[_HELD, i] = math.nan
            hands[_TARGET, i] = min(hands[_TARGET, i] + step_m, travel_m)
            wide_n += hands[_TARGET, i] == travel_m
            continue
        moved_m = fingers_m[i] - hands[_HELD, i]  # NaN until the hand has held something
        away = abs(moved_m) > _NOTHING_M  # opened, or closed on less than it held
        way_m = within(gain * (grip_n[i] - force_n), -step_m, step_m)
        target_m = min(hands[_TARGET, i] + way_m, travel_m)
        if grip_n[i] >= _NEAR * force_n and not away:
            if math.isnan(hands[_HELD, i]):
                hands[_HELD, i] = fingers_m[i]
            hands[_TARGET, i] = target_m
            hands[_LOST_TICKS, i] = 0.0
            continue
        # The target does not run far ahead of the fingers; one finger reading may be wrong.
        behind_m = min(fingers_m[i] - 0.5 * travel_m, hands[_TARGET, i] + step_m)
        hands[_TARGET, i] = max(min(target_m, hands[_TARGET, i]), behind_m)
        slipped = grip_n[i] < _LOST * force_n and moved_m > -_SLIPPED_M
        if away or slipped:
            hands[_LOST_TICKS, i] += 1.0
            events |= _LOSES
        else:
            hands[_LOST_TICKS, i] = 0.0
    if wide_n == 2:
        events |= _WIDE
    return events


def advance_constants(dt_s: float, travel_m: float, speed_m_per_s: float = SPEED_M_PER_S) -> Array:
    """Return the constants (3,) of `advance` for a control step [s]."""
    gain_m_per_n = min(_COMPLIANCE_M_PER_NS * dt_s, 0.5 / _SERVO_N_PER_M)
    return np.array([gain_m_per_n, speed_m_per_s * dt_s, travel_m])


class Grippers:
    """Both hands of a plant.

    Attributes:
        targets_m: Finger targets (2,) [m].
        closed: Whether each hand held something at the reset.
        wide: Whether both hands are fully open.
        fault: Which hand has lost its grip, or empty.
    """

    def __init__(
        self,
        plant: Plant,
        *,
        pinch_force_n: float = JOINT_PINCH_N,
        speed_m_per_s: float = SPEED_M_PER_S,
    ) -> None:
        self._travel_m = plant.robot.hand.travel_m
        self._usual_n = min(pinch_force_n, plant.grip_max_n)
        self._firm_n = max(self._usual_n, min(_FIRMER * self._usual_n, _MOST * plant.grip_max_n))
        self._lost_ticks = max(1.0, _LOST_S / plant.dt)
        self._constants = advance_constants(plant.dt, self._travel_m, speed_m_per_s)
        self._hands = np.ones((4, 2))
        self.reset(plant.fingers, plant.grip)

    def reset(self, fingers_m: Array, grip_n: Array) -> None:
        """Start with open hands, or closed where they hold something, and the usual pinch.

        A hand that holds something at the start stays closed, so that nothing falls when a program starts again.
        """
        self._force_n = self._usual_n
        self.closed = grip_n > _HOLDS_N
        self.wide = not self.closed.any()
        self.targets_m = np.where(self.closed, fingers_m - grip_n / _SERVO_N_PER_M, self._travel_m)
        self._hands[_OPEN] = ~self.closed
        self._hands[_TARGET] = self.targets_m
        self.forget_grip()

    def forget_grip(self) -> None:
        """Expect no grip until hands close on something anew."""
        self._hands[_HELD] = math.nan
        self._hands[_LOST_TICKS] = 0.0
        self.fault = ""

    def close(self, targets_m: Array) -> None:
        """Start closed on an object, at finger targets (2,) [m]."""
        self._hands[_OPEN] = 0.0
        self._hands[_TARGET] = targets_m
        self.targets_m = targets_m.copy()
        self.wide = False

    def firmer(self) -> None:
        """From now on, pinch harder."""
        self._force_n = self._firm_n

    def stop(self, fingers_m: Array, grip_n: Array) -> Array:
        """Return the command (2,) of a stop: moving fingers stay where they are (NaN), other hands go on."""
        opening, target_m, held_m, _ = self._hands
        on_the_way = (opening == 0.0) | (target_m < self._travel_m)
        moving = np.isnan(held_m) & on_the_way
        free = moving & ~(grip_n > _HOLDS_N)
        near_m = np.clip(
            fingers_m, target_m - _LAG_M, target_m + _LAG_M
        )  # the reading may be wrong
        target_m[free] = np.clip(near_m[free], 0.0, self._travel_m)
        return np.where(moving, np.nan, opening)

    @property
    def openings(self) -> Array:
        """What was commanded last (2,), 0 closed or 1 open; a stop changes nothing."""
        return self._hands[_OPEN].copy()

    def step(self, command: Array, fingers_m: Array, grip_n: Array) -> Array:
        """Advance towards command (2,), NaN for fingers that stay; return finger targets (2,) [m]."""
        if self.wide and min(command.tolist()) > OPEN_ABOVE:
            return self.targets_m
        events = advance(command, grip_n, fingers_m, self._hands, self._force_n, self._constants)
        self.targets_m = self._hands[_TARGET].copy()
        self.wide = bool(events & _WIDE)
        if events & _OPENS:
            self.fault = ""
        if events & _LOSES:
            self._name_lost(fingers_m, grip_n)
        return self.targets_m

    def holds(self, hand: int, fingers_m: Array, grip_n: Array) -> bool:
        """Return whether a hand has closed on something and feels it."""
        between_m = min(self._hands[_HELD, hand], fingers_m[hand])
        return bool(between_m > _NOTHING_M and grip_n[hand] >= _LOST * self._force_n)

    def lost(self, hand: int, fingers_m: Array) -> bool:
        """Return whether a hand had closed on something that has slid out, or been torn out."""
        if not self._hands[_HELD, hand] > _NOTHING_M:
            return False
        torn = self._hands[_LOST_TICKS, hand] > self._lost_ticks
        return bool(torn or fingers_m[hand] <= _NOTHING_M)

    def _name_lost(self, fingers_m: Array, grip_n: Array) -> None:
        for hand, (_, _, held_m, lost_ticks) in enumerate(self._hands.T):
            if lost_ticks > self._lost_ticks:
                force = f"{grip_n[hand]:.0f} of {self._force_n:.0f} N"
                way = f"fingers {1e3 * (fingers_m[hand] - held_m):+.1f} mm"
                self.fault = f"the {SIDES[hand]} hand: {force}, {way}"
