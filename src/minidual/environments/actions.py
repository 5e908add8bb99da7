"""Action spaces by name: how the numbers of a policy move the arms.

An action (N, k) is clipped to `low` and `high`. `begin` takes one; `step` then moves the targets
smoothly towards it, once a control tick. The environment and the method that runs a policy use the
same objects. Other distributions add rows through the entry point group `minidual.actions`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from minidual.environments.kernels import Rest, place_hands, reach
from minidual.environments.senses import Sensed, hand_yaw
from minidual.motion.ik import solvers
from minidual.registry import Registry
from minidual.robot.pair import SIDES, Array, Indices, Robot

_STEP = np.array([0.05, 0.05, 0.05, 0.25])
"""Largest increment of hands along x, y, z [m] and about z [rad]: at 10 Hz 0.5 m/s and 2.5 rad/s."""
_APART = np.array([0.02, 0.02, 0.015, 0.10])
"""Largest increment of half the difference of both hands, in the frame of the line between them."""
_LOWEST_M = np.array([0.2, -0.55, 0.03])
_HIGHEST_M = np.array([0.75, 0.55, 0.60])
"""Places that the targets of hands may take: over the table, where both arms reach."""
_TURN_RAD = 2.2
"""Largest turn of a hand from the direction that it has over an object along y."""
_ALONG_Y_RAD = np.pi / 2.0
LEAD_M = 0.012
"""Downwards the target of a closed hand leads the hand by this at most: it lands objects softly."""
_OPENS = 0.5
"""A grip above it opens, below its negative it closes, between them nothing changes."""


class Arms(NamedTuple):
    """Constants of the arms for action spaces.

    Attributes:
        frames: (2, n / 2 + 1, 4, 4), see `ArmIK.frames`.
        rest: What redundant joints prefer.
    """

    robot: Robot
    frames: Array
    rest: Rest


def arms_of(robot: Robot) -> Arms:
    """Return the arms of a robot."""
    kinematics = list(solvers(robot).values())
    frames = np.stack([arm.frames for arm in kinematics])
    limits = np.stack([arm.rest_limits for arm in kinematics])
    rest = Rest(frames, robot.home.reshape(2, -1).copy(), limits)
    return Arms(robot, frames, rest)


class Actions(ABC):
    """One action space of N worlds.

    Attributes:
        names: Of the numbers of an action, with units.
        low, high: Bounds (k,).
        target: Joint targets (N, n) [rad].
        opening: Targets of both hands (N, 2), 0 closed or 1 open.
        hands: Target poses (N, 2, 4, 4) of both hands at the end of the action.
    """

    names: tuple[str, ...]
    low: Array
    high: Array

    def __init__(self, arms: Arms, worlds_n: int) -> None:
        self.arms = arms
        self.target = np.tile(arms.robot.home, (worlds_n, 1))
        self.opening = np.ones((worlds_n, 2))
        self.hands = np.zeros((worlds_n, 2, 4, 4))
        place_hands(arms.frames, self.target, self.hands)
        self._home = self.hands[0].copy()

    def reset(self, worlds: Indices) -> None:
        """Start at home with open hands."""
        self.target[worlds] = self.arms.robot.home
        self.opening[worlds] = 1.0
        self.hands[worlds] = self._home

    @abstractmethod
    def begin(self, action: Array, sensed: Sensed) -> None:
        """Take an action (N, k)."""

    @abstractmethod
    def step(self, share: float) -> None:
        """Move `target` and `opening` to this share of the action, above 0 to 1."""


class JointTargets(Actions):
    """Joint targets [rad] and openings (below 0.4 closes, above 0.6 opens)."""

    def __init__(self, arms: Arms, worlds_n: int) -> None:
        super().__init__(arms, worlds_n)
        robot = arms.robot
        joints = tuple(f"{name}_rad" for name in robot.joint_names)
        self.names = (*joints, *(f"{side}_opening" for side in SIDES))
        self.low = np.r_[robot.q_lower, 0.0, 0.0]
        self.high = np.r_[robot.q_upper, 1.0, 1.0]

    def begin(self, action: Array, sensed: Sensed) -> None:
        """See `Actions`."""
        self.target[:] = action[:, :-2]
        self.opening[:] = action[:, -2:]
        place_hands(self.arms.frames, self.target, self.hands)

    def step(self, share: float) -> None:
        """See `Actions`; targets are held."""


class DownwardHands(Actions):
    """Base of spaces that move hands which point down, (x, y, z, yaw), by increments.

    Attributes:
        wanted: (N, 2, 4), x, y, z [m] and yaw [rad] of both hands at the end of the action.
    """

    def __init__(self, arms: Arms, worlds_n: int) -> None:
        super().__init__(arms, worlds_n)
        self.low = np.full(len(self.names), -1.0)
        self.high = np.ones(len(self.names))
        self._start = np.concatenate([self._home[:, :3, 3], hand_yaw(self._home)[:, None]], axis=1)
        self.wanted = np.tile(self._start, (worlds_n, 1, 1))
        self._before = self.wanted.copy()

    def reset(self, worlds: Indices) -> None:
        """See `Actions`."""
        super().reset(worlds)
        self.wanted[worlds] = self._start
        self._before[worlds] = self._start

    @property
    def closed(self) -> npt.NDArray[np.bool_]:
        """Whether both hands are told to close (N,)."""
        return self.opening.sum(axis=1) < 0.5

    def begin(self, action: Array, sensed: Sensed) -> None:
        """See `Actions`."""
        self._before[:] = self.wanted
        moved = self._moved(np.clip(action, self.low, self.high))
        moved[..., :3] = np.clip(moved[..., :3], _LOWEST_M, _HIGHEST_M)
        lowest_m = sensed.hands[:, :, 2, 3] - LEAD_M
        pressed = self.closed[:, None] & (moved[..., 2] < lowest_m)
        moved[..., 2] = np.where(pressed, lowest_m, moved[..., 2])
        turn = np.clip(moved[..., 3] - _ALONG_Y_RAD, -_TURN_RAD, _TURN_RAD)
        moved[..., 3] = _ALONG_Y_RAD + turn
        self.wanted[:] = moved
        self.hands[:] = downward_poses(moved)
        self.opening[:] = self._grips(action)

    def step(self, share: float) -> None:
        """See `Actions`."""
        between = self._before + share * (self.wanted - self._before)
        reach(self.arms.rest, downward_poses(between), self.target)

    @abstractmethod
    def _moved(self, action: Array) -> Array:
        """Return the hands (N, 2, 4) after an action."""

    def _grips(self, action: Array) -> Array:
        """Return the openings (N, 2) after an action; its last two numbers are grips."""
        grip = action[:, -2:]
        return np.where(grip > _OPENS, 1.0, np.where(grip < -_OPENS, 0.0, self.opening))


class HandIncrements(DownwardHands):
    """Each hand moves by increments of its own."""

    names = (
        *(f"{side}_{axis}" for side in SIDES for axis in ("dx", "dy", "dz", "dyaw")),
        *(f"{side}_grip" for side in SIDES),
    )

    def _moved(self, action: Array) -> Array:
        return self.wanted + action[:, :8].reshape(-1, 2, 4) * _STEP


class PairIncrements(DownwardHands):
    """Both hands move by a common increment, and apart by another.

    Closed hands turn about the point between them, open ones each in its place.
    """

    names = (
        *(f"common_{axis}" for axis in ("dx", "dy", "dz", "dyaw")),
        *(f"apart_{axis}" for axis in ("dx", "dy", "dz", "dyaw")),
        *(f"{side}_grip" for side in SIDES),
    )

    def _moved(self, action: Array) -> Array:
        common = action[:, :4] * _STEP
        apart = action[:, 4:8] * _APART
        turn = np.where(self.closed, common[:, 3], 0.0)
        moved = turned_together(self.wanted, turn)
        moved += common[:, None]
        frame = self.wanted[..., 3].mean(axis=1) - _ALONG_Y_RAD
        apart[:, :2] = turned_plane(apart[:, :2], frame)
        moved[:, 0] += apart
        moved[:, 1] -= apart
        return moved

    def action_to(self, wanted: Array, share: Array) -> Array:
        """Return the action (N, 10) that goes a share (N,) of the way to hands (N, 2, 4), grips 0."""
        way = wanted - self.wanted
        common = share[:, None] * way.mean(axis=1)
        turn = np.where(self.closed, common[:, 3], 0.0)
        moved = turned_together(self.wanted, turn) + common[:, None]
        remaining = self.wanted + share[:, None, None] * way - moved
        apart = 0.5 * (remaining[:, 0] - remaining[:, 1])
        frame = self.wanted[..., 3].mean(axis=1) - _ALONG_Y_RAD
        apart[:, :2] = turned_plane(apart[:, :2], -frame)
        grips = np.zeros((len(wanted), 2))
        return np.concatenate([common / _STEP, apart / _APART, grips], axis=1)


class ObjectIncrements(DownwardHands):
    """The object in both hands moves by increments, and the hands with it; one grip for both."""

    names = ("dx", "dy", "dz", "dyaw", "grip")

    def _moved(self, action: Array) -> Array:
        common = action[:, :4] * _STEP
        return turned_together(self.wanted, common[:, 3]) + common[:, None]

    def _grips(self, action: Array) -> Array:
        return super()._grips(np.repeat(action[:, 4:], 2, axis=1))


def turned_plane(xy: Array, angle: Array) -> Array:
    """Return vectors (N, 2) turned by angles (N,) [rad]."""
    c = np.cos(angle)
    s = np.sin(angle)
    x, y = xy.T
    return np.stack([c * x - s * y, s * x + c * y], axis=1)


def turned_together(hands: Array, angle: Array) -> Array:
    """Return hands (N, 2, 4) turned by angles (N,) [rad] about the point between them, yaws as they are."""
    moved = hands.copy()
    middle = hands[:, :, :2].mean(axis=1)
    for hand in range(2):
        moved[:, hand, :2] = middle + turned_plane(hands[:, hand, :2] - middle, angle)
    return moved


def downward_poses(hands: Array) -> Array:
    """Return the poses (N, 2, 4, 4), Rz(yaw) Rx(pi), of hands (N, 2, 4)."""
    Ts = np.zeros((*hands.shape[:2], 4, 4))
    c = np.cos(hands[..., 3])
    s = np.sin(hands[..., 3])
    Ts[..., 0, 0] = c
    Ts[..., 0, 1] = s
    Ts[..., 1, 0] = s
    Ts[..., 1, 1] = -c
    Ts[..., 2, 2] = -1.0
    Ts[..., :3, 3] = hands[..., :3]
    Ts[..., 3, 3] = 1.0
    return Ts


ACTIONS: Registry[type[Actions]] = Registry(
    "action space",
    {
        "joint_targets": JointTargets,
        "hand_increments": HandIncrements,
        "pair_increments": PairIncrements,
        "object_increments": ObjectIncrements,
    },
    group="minidual.actions",
)
