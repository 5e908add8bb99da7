"""Relative pose of two held objects, which a policy reads and moves while it joins them.

One hand pushes its part straight into the other hand's, under impedance. An action moves the
reference of that push; zeros leave it as it is. Everything is read from encoders, fingers, torques
and the camera's earlier looks: nothing is the truth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from minidual.control.hand_impedance import InHand
from minidual.environments.kernels import place_hands, wrenches
from minidual.environments.observations import CLIP
from minidual.errors import UsageError, check_name
from minidual.robot.pair import Array, inverse
from minidual.skills.askew import Meeting, excess_m, turned_in_hand

FORCE = "force"
"""Terms of force and torque, which a policy may leave out."""
ACTION = "relative_pose"
"""Name of the action space."""
_STEP = np.array([0.001, 0.0025, 0.001, 0.012, 0.012])
_LOW = np.array([-0.006, -0.060, -0.006, -0.10, -0.10])
_HIGH = np.array([0.006, 0.020, 0.006, 0.10, 0.10])
_UNIT = np.array([0.006, 0.030, 0.006, 0.04, 0.04])
"""Scale of an observation of x, y, z [m], yaw and pitch [rad]: the value that counts as 1."""
_FORCE_UNIT = np.repeat([10.0, 1.0], 3)
_GAP_UNIT_M = 0.0004
_TURN_UNIT_RAD = 0.04
_TIME_UNIT_S = 6.0
_ADVANCE_UNIT_M = 0.002

type Floats = npt.NDArray[np.float32]


class RelativePose:
    """Bounded increments of the pushed part's reference relative to the other part.

    The last two turn what the hands are taken to hold: a part that stands askew by an angle has its
    tip or its mouth beside where the encoders say, and points elsewhere.

    Attributes:
        names: Of the numbers of an action; 1 stands for `step`.
        value: Sum of the increments (5,): x, y, z [m] in the part's axes, angles [rad] by which the
            pushed part and the other one stand askew in their hands.
        action: The latest action (5,), in -1..1.
    """

    names = ("across", "along", "above", "own_askew", "other_askew")
    step = _STEP
    low = _LOW
    high = _HIGH

    def __init__(self) -> None:
        self.value = np.zeros(len(self.names))
        self.action = np.zeros(len(self.names))
        self._from = self.value

    def begin(self, action: npt.ArrayLike) -> None:
        """Take the next action (5,)."""
        self.action = np.clip(np.asarray(action, dtype=float), -1.0, 1.0)
        self._from = self.value
        self.value = np.clip(self.value + self.action * _STEP, _LOW, _HIGH)

    def at(self, share: float) -> Array:
        """Return the value (5,) after a share, 0..1, of the action's time."""
        return self._from + share * (self.value - self._from)


class Parts(NamedTuple):
    """The parts in both hands, and where they meet.

    Attributes:
        frames: (2, n / 2 + 1, 4, 4), see `ArmIK.frames`.
        tip_m: (3,) in the pushed part's frame, what goes in first.
        mouth_m: (3,) in the other part's frame, where it goes in.
        widths_m: (2,) between the fingers, of the pushed part and of the other one.
    """

    frames: Array
    tip_m: tuple[float, float, float]
    mouth_m: tuple[float, float, float]
    widths_m: tuple[float, float]


class MatingReadings(NamedTuple):
    """Readings of one moment.

    Attributes:
        q, q_ref: Measured and planned (n,) [rad].
        gaps_m: (2,) between the fingers of the left and the right hand.
        torque: (n,) [Nm] that nothing but contact explains.
        time_s: Present time.
    """

    q: Array
    q_ref: Array
    gaps_m: Array
    torque: Array
    time_s: float


class MatingSensed(NamedTuple):
    """Readings for a policy; the pushed part comes before the other one.

    Attributes:
        relative: (5,), place of the tip from the mouth (x, y, z) [m] in the other part's axes, yaw
            and pitch [rad], by encoders and grasps, as the policy has turned the parts.
        error: The reference's minus that (5,).
        wrench: (2, 6) [N, Nm] of the surroundings on each hand, in its part's axes.
        gap_excess_m: (2,), how much further apart the fingers are than round an aligned part.
        seen_rad: (2,), turn of each part in its hand, as the camera saw it before.
        guess_rad: (2,), turn by the gap, with the camera's sign.
        value, action: (5,), see `RelativePose`.
        deepest_m: Largest depth of the tip so far, negative before the mouth.
        advance_m: Gained depth since the last action.
        time_s: Since the first action.
    """

    relative: Array
    error: Array
    wrench: Array
    gap_excess_m: Array
    seen_rad: Array
    guess_rad: Array
    value: Array
    action: Array
    deepest_m: float
    advance_m: float
    time_s: float


class MatingSenses:
    """Turns measurements into readings for a policy; remembers depth and time."""

    def __init__(self, parts: Parts, meeting: Meeting) -> None:
        self._parts = parts
        self._hands = meeting.hand, 1 - meeting.hand
        self._own = meeting.own
        self._other = meeting.other
        self._Ts = np.zeros((1, 2, 4, 4))
        self._began_s: float | None = None
        self._deepest_m = -np.inf
        self._last_m: float | None = None

    def planned(self, q_ref: Array) -> Array:
        """Return the relative pose (5,) that the plan asks for, without the policy."""
        own = self._own.held.T_tcp_planned
        other = self._other.held.T_tcp_planned
        return self._relative(self._between(q_ref, own, other))

    def held(self, value: Array) -> tuple[InHand, InHand]:
        """Return the held parts, askew by a value (5,) of actions."""
        own = turned_in_hand(self._own.held, float(value[3]))
        other = turned_in_hand(self._other.held, float(value[4]))
        return own, other

    def read(self, readings: MatingReadings, actions: RelativePose) -> MatingSensed:
        """Return the readings before the next action."""
        if self._began_s is None:
            self._began_s = readings.time_s
        own, other = self.held(actions.value)
        relative = self._relative(
            self._between(readings.q, own.T_tcp_object, other.T_tcp_object),
        )
        reference = self.planned(readings.q_ref)
        reference[:3] += actions.value[:3]
        depth_m = float(relative[1])
        advance_m = 0.0 if self._last_m is None else depth_m - self._last_m
        self._last_m = depth_m
        self._deepest_m = max(self._deepest_m, depth_m)
        ordered = list(self._hands)
        gaps = [
            excess_m(float(gap), width)
            for gap, width in zip(readings.gaps_m[ordered], self._parts.widths_m, strict=True)
        ]
        return MatingSensed(
            relative,
            reference - relative,
            self._wrench(readings, own, other),
            np.array(gaps),
            np.array([self._own.seen_rad, self._other.seen_rad]),
            np.array([self._own.angle, self._other.angle]),
            actions.value,
            actions.action,
            self._deepest_m,
            advance_m,
            readings.time_s - self._began_s,
        )

    def _between(self, q: Array, own: Array, other: Array) -> Array:
        """Return the pose (4, 4) of the pushed part in the other one, held so, at q (n,)."""
        place_hands(self._parts.frames, q[None], self._Ts)
        hand, away = self._hands
        return inverse(self._Ts[0, away] @ other) @ self._Ts[0, hand] @ own

    def _relative(self, X: Array) -> Array:
        """Return place of the tip from the mouth, yaw and pitch (5,) of a relative pose (4, 4)."""
        tip = X[:3, :3] @ self._parts.tip_m + X[:3, 3] - self._parts.mouth_m
        yaw = np.arctan2(-X[0, 1], X[1, 1])
        pitch = np.arcsin(np.clip(X[2, 1], -1.0, 1.0))
        return np.array([*tip, yaw, pitch])

    def _wrench(self, readings: MatingReadings, own: InHand, other: InHand) -> Array:
        """Return the wrenches (2, 6) on the hands at `readings.q`, where `_between` was last."""
        place_hands(self._parts.frames, readings.q[None], self._Ts)
        hand_wrenches = np.zeros((1, 2, 6))
        wrenches(self._parts.frames, readings.q[None], readings.torque[None], hand_wrenches)
        rows: list[Array] = []
        for hand, held in zip(self._hands, (own, other), strict=True):
            R = self._Ts[0, hand, :3, :3] @ held.T_tcp_object[:3, :3]
            rows.append(
                np.concatenate([R.T @ hand_wrenches[0, hand, :3], R.T @ hand_wrenches[0, hand, 3:]])
            )
        return np.array(rows)


class MatingTerm(NamedTuple):
    """One term of an observation.

    Attributes:
        size: Numbers.
        unit: What 1 stands for.
        read: Returns (size,).
        senses: `FORCE`, or empty for what a policy always has.
    """

    size: int
    unit: str
    read: Callable[[MatingSensed], Array]
    senses: str = ""


MATING_TERMS: dict[str, MatingTerm] = {
    "relative": MatingTerm(
        5, "6 mm across, 30 mm along, 6 mm above, 0.04 rad", lambda s: s.relative / _UNIT
    ),
    "error": MatingTerm(
        5, "6 mm across, 30 mm along, 6 mm above, 0.04 rad", lambda s: s.error / _UNIT
    ),
    "wrenches": MatingTerm(12, "10 N, 1 Nm", lambda s: (s.wrench / _FORCE_UNIT).ravel(), FORCE),
    "gaps": MatingTerm(2, "0.4 mm", lambda s: s.gap_excess_m / _GAP_UNIT_M),
    "seen_askew": MatingTerm(2, "0.04 rad", lambda s: s.seen_rad / _TURN_UNIT_RAD),
    "askew_guess": MatingTerm(2, "0.04 rad", lambda s: s.guess_rad / _TURN_UNIT_RAD),
    "value": MatingTerm(
        5, "6 mm across, 30 mm along, 6 mm above, 0.04 rad", lambda s: s.value / _UNIT
    ),
    "last_action": MatingTerm(5, "an action's bound", lambda s: s.action),
    "progress": MatingTerm(
        3,
        "30 mm deep, 2 mm gained, 6 s",
        lambda s: np.array(
            [
                s.deepest_m / _UNIT[1],
                s.advance_m / _ADVANCE_UNIT_M,
                s.time_s / _TIME_UNIT_S,
            ],
        ),
    ),
}
"""Terms by name."""


def mating_terms(*, senses_force: bool = True) -> tuple[str, ...]:
    """Return the names of the terms that a policy reads."""
    return tuple(
        name for name, term in MATING_TERMS.items() if senses_force or term.senses != FORCE
    )


def mating_size(names: Sequence[str]) -> int:
    """Return the size of an observation.

    Raises:
        UsageError: Unknown or repeated name, or none.
    """
    if not names or len(set(names)) < len(names):
        raise UsageError(f"an observation has different terms, at least one; given {names}")
    for name in names:
        check_name("observation of a mating", name, MATING_TERMS)
    return sum(MATING_TERMS[name].size for name in names)


def mating_columns(names: Sequence[str]) -> dict[str, slice]:
    """Return where each term stands in an observation."""
    columns: dict[str, slice] = {}
    first = 0
    for name in names:
        size = MATING_TERMS[name].size
        columns[name] = slice(first, first + size)
        first += size
    return columns


def observe_mating(names: Sequence[str], sensed: MatingSensed) -> Floats:
    """Return the observation (k,), clipped to +-5."""
    rows = [MATING_TERMS[name].read(sensed) for name in names]
    return np.clip(np.concatenate(rows), -CLIP, CLIP).astype(np.float32)
