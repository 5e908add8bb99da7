"""Parts askew between the fingers: their angle by the gap, and trials where one is stuck.

A box that pads hold by an edge each stands askew by friction. It keeps the fingers further apart
than its width, by the length of a pad times the angle. The gap has no sign, so a part that does not
go in is drawn back, turned by the other signs in turn, and pushed again (docs/insertion.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from minidual.control.hand_impedance import HandImpedance, InHand
from minidual.robot.pair import Array, pose, rot_z

EVERY_S = 0.02
"""Time between two updates of a mating."""
_PAD_M = 0.0165
"""Length of a pad along a part: the gap grows by 0.29 mm a degree."""
_BETWEEN_M = 0.0004
"""How much wider the gap is than a part that is aligned: the faces' contacts begin there."""
_LEAST_RAD = np.radians(0.4)
"""A smaller angle is not corrected."""
_MOST_RAD = np.radians(6.0)
_STUCK_M = 0.008
"""Lag from which a part does not follow: the spring gives its most from 5 mm on."""
_FREE_M = 0.004
"""Distance by which a part is drawn back from a contact."""
_BACK_S = 0.5
"""Time for drawing back and turning."""
_TRY_S = 1.6
"""Time of a try, with that."""
_SIGNS = ((1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0))
"""Signs of the part that is more askew and of the other one, in the order of the tries."""


def excess_m(gap_m: float, width_m: float) -> float:
    """Return how much further apart the fingers are than round an aligned part of this width."""
    return gap_m - width_m - _BETWEEN_M


def askew_rad(gap_m: float, width_m: float) -> float:
    """Return by how much a part of this width stands askew, without its sign."""
    angle = excess_m(gap_m, width_m) / _PAD_M
    return 0.0 if angle < _LEAST_RAD else min(angle, _MOST_RAD)


@dataclass(frozen=True)
class HeldPart:
    """A part in a hand.

    Attributes:
        held: As it was noted, aligned.
        angle: How askew it stands [rad], with the sign to be tried first.
        seen_rad: By how much the camera saw it turned about the hand's axis; 0 if it did not look.
    """

    held: InHand
    angle: float
    seen_rad: float = 0.0

    def turned(self, sign: float) -> InHand:
        """Return the held part, askew by sign * angle about the hand's axis."""
        return turned_in_hand(self.held, sign * self.angle)


def turned_in_hand(held: InHand, angle_rad: float) -> InHand:
    """Return the held part, askew by an angle about the hand's axis."""
    turn = pose(rot_z(angle_rad), (0.0, 0.0, 0.0))
    return held._replace(T_tcp_object=turn @ held.T_tcp_object)


class Meeting(NamedTuple):
    """Two parts in front of each other, and the soft hand that is about to push.

    Attributes:
        law: Of the soft hand.
        own, other: Parts in that hand and in the other one.
        hand: The soft hand, 0 left or 1 right.
        now_s: Present time.
    """

    law: HandImpedance
    own: HeldPart
    other: HeldPart
    hand: int
    now_s: float


class Mating(Protocol):
    """Corrects a part while a soft hand pushes it into another one."""

    def update(self, q: Array, q_ref: Array, now_s: float) -> None:
        """Act, `EVERY_S` after the last time; q and q_ref (n,) [rad] are measured and planned."""
        ...

    def busy(self, now_s: float) -> bool:
        """Whether the push must go on beyond its plan."""
        ...


class AskewSearch:
    """Corrects the parts in both hands, and tries other signs where one is stuck.

    Call `update` some times a tenth of a second while the soft hand pushes.
    """

    def __init__(self, meeting: Meeting) -> None:
        own = meeting.own
        other = meeting.other
        now_s = meeting.now_s
        self._law = meeting.law
        self._parts = own, other
        self._more = 0 if abs(own.angle) >= abs(other.angle) else 1
        self._angles = np.zeros(2)
        self._goal = np.zeros(2)
        self._from = np.zeros(2)
        self._turning_s = now_s
        self._next_s = now_s + _TRY_S
        self._back_m = 0.0
        self.tries_n = 0
        self._aim(0, now_s)

    @property
    def tries_left(self) -> int:
        """Signs that have not been tried; 0 if both parts are aligned."""
        if not any(part.angle for part in self._parts):
            return 0
        signs_n = 2 if min(abs(part.angle) for part in self._parts) == 0.0 else len(_SIGNS)
        return max(0, signs_n - self.tries_n)

    def busy(self, now_s: float) -> bool:
        """Whether a try is under way."""
        return self.tries_n > 1 and now_s < self._next_s

    def update(self, q: Array, q_ref: Array, now_s: float) -> None:
        """Turn and draw back as the present try asks, or begin the next one."""
        share = min(1.0, (now_s - self._turning_s) / _BACK_S)
        self._angles = self._from + share * (self._goal - self._from)
        self._tell()
        back_m = 0.0 if share == 1.0 else self._back_m
        self._law.shift_m = (0.0, -back_m, 0.0)
        if now_s < self._next_s or not self.tries_left:
            return
        lag_m = float(self._law.lag(q, q_ref)[1])
        if lag_m > _STUCK_M:
            self._back_m = lag_m + _FREE_M
            self._aim(self.tries_n, now_s)
            self._next_s = now_s + _TRY_S

    def _aim(self, attempt: int, now_s: float) -> None:
        """Begin a try with its signs."""
        of_more, of_other = _SIGNS[attempt]
        signs = [of_other, of_other]
        signs[self._more] = of_more
        self._from = self._angles.copy()
        self._goal = np.array(signs)
        self._turning_s = now_s
        self.tries_n += 1

    def _tell(self) -> None:
        own, other = self._parts
        self._law.correct(own.turned(self._angles[0]), other.turned(self._angles[1]))


def part_in_hand(held: InHand, gap_m: float, width_m: float, seen_rad: Sequence[float]) -> HeldPart:
    """Return the part in a hand, askew by the gap of its fingers.

    Args:
        seen_rad: Turns of the part about the hand's axis, as the camera saw it in the hand; their
            mean gives the sign that is tried first. Empty for none.
    """
    angle = askew_rad(gap_m, width_m)
    mean_rad = float(np.mean(seen_rad)) if seen_rad else 0.0
    sign = -1.0 if mean_rad < 0.0 else 1.0
    return HeldPart(held, sign * angle, mean_rad)
