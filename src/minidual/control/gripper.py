"""Close the hands to a force F, without knowing what they hold.

    closing   target' = -sat(k (F - f), speed),  f measured
    opening   target' = +speed

The target stays within half the travel of the fingers. Pinch and squeeze: docs/force-control.md.
"""

import math

import numpy as np

from minidual.errors import UsageError
from minidual.plant.protocol import Plant
from minidual.robot.pair import SIDES, Array

SAFETY = 1.5  # friction varies by some tenths between pads and days
_GRAVITY = 9.81


def pinch_force(squeeze_n: float, mu: float, mass_kg: float = 0.0, *, safety: float = SAFETY) -> float:
    """Return each finger's normal force [N].

    Raises:
        UsageError: A value is out of range.
    """
    if not mu > 0.0:
        raise UsageError(f"friction coefficient {mu}: must be above 0, no pinch holds without friction")
    if not mass_kg >= 0.0:
        raise UsageError(f"mass {mass_kg} kg: must be at least 0")
    if not safety >= 1.0:
        raise UsageError(f"safety factor {safety}: must be at least 1")
    if not squeeze_n >= 0.0:
        raise UsageError(f"squeeze {squeeze_n} N: must be at least 0, hands do not pull")
    return safety * math.hypot(squeeze_n, 0.5 * mass_kg * _GRAVITY) / (2.0 * mu)


CLOSE_BELOW, OPEN_ABOVE = 0.4, 0.6
"""Hysteresis against opening commands wavering about the middle."""
JOINT_PINCH_N = 60.0
"""Pinch force in joint-space modes: 1.5 times the internal force a stiff pair can demand."""
_COMPLIANCE_M_PER_NS = 0.01  # k: a 5000 N/m servo settles with a 20 ms time constant
_NEAR = 0.9
_FIRMER, _MOST = 1.3, 0.95
"""Where an object slips, the pinch rises by this factor, to no more than this share of what the motors give."""
_LOST, _LOST_S = 0.5, 0.004
"""Below this share for this long, a grip is lost."""
_NOTHING_M = 0.002
"""Nearer to the middle, fingers have closed on nothing."""
_SLIPPED_M = 0.0003
"""Fingers that close further have lost the object, or were shaken."""


class Grippers:
    """Turns opening commands (0 closed, 1 open) into finger targets [m].

    The closing force is limited to what the motors give.
    """

    def __init__(self, plant: Plant, *, pinch_force_n: float = JOINT_PINCH_N, speed_m_per_s: float = 0.08) -> None:
        self._plant, self._travel_m = plant, plant.robot.hand.travel_m
        self._force_n = min(pinch_force_n, plant.grip_max_n)
        self._firm_n = max(self._force_n, min(_FIRMER * self._force_n, _MOST * plant.grip_max_n))
        self._step_m, self._gain = speed_m_per_s * plant.dt, _COMPLIANCE_M_PER_NS * plant.dt
        self.fault = ""
        """Which hand lost its grip, or empty."""
        self.reset()

    def reset(self) -> None:
        """Start with open hands."""
        self.is_open = [True, True]
        """By command, each hand."""
        self.forget_grip()
        self._targets = [self._travel_m] * 2
        self.targets_m = np.array(self._targets)

    def forget_grip(self) -> None:
        """Expect no grip until hands close on something anew."""
        self._held_m, self._lost, self.fault = [math.nan] * 2, [0, 0], ""

    def close(self, targets_m: Array) -> None:
        """Start closed on an object, at finger targets (2,) [m]."""
        self.is_open, self._targets, self.targets_m = [False, False], targets_m.tolist(), targets_m.copy()

    @property
    def wide(self) -> bool:
        """Whether both hands are fully open."""
        return all(self.is_open) and self._targets == [self._travel_m] * 2

    def firmer(self) -> None:
        """From now on, pinch harder."""
        self._force_n = self._firm_n

    def step(self, command: Array) -> Array:
        """Advance towards command (2,); return finger targets (2,) [m]."""
        is_open = self.is_open
        for hand, wanted in enumerate(command.tolist()):
            if wanted > OPEN_ABOVE:
                if not is_open[hand]:
                    self._lost[hand], self.fault = 0, ""
                is_open[hand] = True
            elif wanted < CLOSE_BELOW:
                is_open[hand] = False
        targets, step, travel = self._targets, self._step_m, self._travel_m
        if is_open[0] and is_open[1] and targets[0] == travel == targets[1]:
            return self.targets_m
        for hand, felt in enumerate(self._plant.grip.tolist()):
            if is_open[hand]:
                self._held_m[hand] = math.nan
                targets[hand] = min(targets[hand] + step, travel)
                continue
            way = self._gain * (felt - self._force_n)
            target = min(targets[hand] + (step if way > step else -step if way < -step else way), travel)
            if felt >= _NEAR * self._force_n:
                if math.isnan(self._held_m[hand]):
                    self._held_m[hand] = float(self._plant.fingers[hand])
                targets[hand] = target
                self._lost[hand] = 0
                continue
            if not math.isnan(felt):  # else the target stays; it is not far ahead of the fingers
                targets[hand] = max(target, float(self._plant.fingers[hand]) - 0.5 * travel)
            self._compare(hand, felt)
        self.targets_m = self.targets_m.copy()  # a third of the time of `np.array(targets)`
        self.targets_m[0], self.targets_m[1] = targets
        return self.targets_m

    def holds(self, hand: int) -> bool:
        """Return whether a hand has closed on something and feels it."""
        return self._held_m[hand] > _NOTHING_M and bool(self._plant.grip[hand] >= _LOST * self._force_n)

    def _compare(self, hand: int, grip_n: float) -> None:
        moved_m = float(self._plant.fingers[hand]) - self._held_m[hand]
        lost = not grip_n >= _LOST * self._force_n and moved_m > -_SLIPPED_M
        self._lost[hand] = self._lost[hand] + 1 if lost else 0
        if self._lost[hand] * self._plant.dt > _LOST_S:
            what = f"{grip_n:.0f} of {self._force_n:.0f} N, fingers {1e3 * moved_m:+.1f} mm"
            self.fault = f"the {SIDES[hand]} hand: {what}"
