"""Scripted operator of the rod task: joint targets of a trial, whose start and goal it knows.

By default, fixed timing makes its motion a smooth, learnable function of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from minidual.config.learning import OperatorConfig
from minidual.config.scene import SceneConfig
from minidual.config.seeds import stream
from minidual.control.kernels import minimum_jerk
from minidual.motion.ik import posture_at
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array, pose, rot_x, rot_z
from minidual.skills.phases import PHASES
from minidual.tasks.task import Trial, grasp_offsets, level_pose, placement

REST_S = 0.1
"""Standstill at the end of a demonstration."""
_LASTS_S = {
    "approach": 1.8,
    "correct": 0.6,
    "descend": 0.9,
    "close": 0.7,
    "lift": 0.8,
    "carry": 2.0,
    "lower": 0.8,
    "land": 0.5,
    "open": PHASES["open"].hold_s,
    "retreat": 0.5,
    "rest": REST_S,
}
_OVERLAPPING = ("correct", "descend", "land")
_LANDING_M = 0.006
"""The last of the way down, taken slowly.

A policy that copies it touches the table a few millimetres early or late. At 90 mm/s the supervisor
would stop the hands, because a stop would end in the table.
"""
_PAUSED = ("lift", "lower")
_WRIST_COST = 0.1
"""Of the last joint, which only turns the hand.

With equal costs the elbow swings, and near the table joint 5 moves three times as fast.
"""
_DEFAULTS = OperatorConfig()


@dataclass(frozen=True)
class Demonstration:
    """Operator commands of one trial.

    Attributes:
        rate_hz: Of the commands.
        q: Joint targets (T, n) [rad]; q[0] is home.
        gripper: (T, 2), 0 closed or 1 open.
    """

    rate_hz: float
    q: Array
    gripper: Array

    @property
    def duration_s(self) -> float:
        """Length [s]."""
        return len(self.q) / self.rate_hz

    def at(self, elapsed_s: float) -> tuple[Array, Array]:
        """Return joint targets (n,) and openings (2,) at a time [s]."""
        tick = min(max(round(elapsed_s * self.rate_hz), 0), len(self.q) - 1)
        return self.q[tick], self.gripper[tick]


@dataclass(frozen=True)
class Style:
    """Individual variation of a trial's operator.

    Attributes:
        pace: Factors of the durations, by phase.
        pauses_s: Before phases.
        shifts_m: Of the left and right grasp along the object.
    """

    pace: Mapping[str, float] = field(default_factory=dict)
    pauses_s: Mapping[str, float] = field(default_factory=dict)
    shifts_m: tuple[float, float] = (0.0, 0.0)


class Span(NamedTuple):
    """Start and end of a phase [s]."""

    start_s: float
    end_s: float


_PLAIN = Style()


class ScriptedOperator:
    """Plans demonstrations of the rod task.

    Args:
        scene: With the rod.
        config: Errors and spreads of the operator.
        kinematics: Of the arms; two Pandas by default.
    """

    def __init__(
        self,
        scene: SceneConfig,
        config: OperatorConfig = _DEFAULTS,
        *,
        kinematics: Kinematics | None = None,
    ) -> None:
        self.scene = scene
        self.config = config
        if kinematics is None:
            kinematics = Kinematics()
        self._robot = kinematics.robot
        self._costs = np.ones(self._robot.dof)
        for arm in range(len(SIDES)):
            self._costs[self._robot.joints_of(arm).stop - 1] = _WRIST_COST
        self._home_poses = kinematics.tcp_poses(self._robot.home)
        self._grasps = grasp_offsets(scene)

    def style(self, seed: int, trial: Trial) -> Style:
        """Draw the style of a trial."""
        rng = stream(seed, f"operator-style/{trial.purpose}", trial.index)
        config = self.config
        pace = 1.0 + config.speed_spread * rng.uniform(-1.0, 1.0, len(_LASTS_S))
        pauses_s = config.pause_s * rng.uniform(0.0, 1.0, len(_PAUSED))
        left_m, right_m = config.grasp_spread_m * rng.uniform(-1.0, 1.0, 2)
        return Style(
            pace=dict(zip(_LASTS_S, pace, strict=True)),
            pauses_s=dict(zip(_PAUSED, pauses_s, strict=True)),
            shifts_m=(left_m, right_m),
        )

    def phases(self, style: Style = _PLAIN) -> dict[str, Span]:
        """Return the spans of the phases.

        They overlap above the rod and above the table, where a policy without speed or time could
        learn to wait for ever.
        """
        phases: dict[str, Span] = {}
        end_s = 0.0
        for name, lasts_s in _LASTS_S.items():
            overlap_s = self.config.overlap_s if name in _OVERLAPPING else 0.0
            start_s = end_s - overlap_s + style.pauses_s.get(name, 0.0)
            end_s = start_s + lasts_s * style.pace.get(name, 1.0)
            phases[name] = Span(start_s, end_s)
        return phases

    def approach_error(self, seed: int, trial: Trial) -> Array:
        """Return the random error (3,): across and along the object [m], and in yaw [rad]."""
        config = self.config
        scale = np.array([config.approach_noise_m, config.along_noise_m, config.approach_noise_rad])
        rng = stream(seed, f"operator/{trial.purpose}", trial.index)
        return scale * np.clip(rng.standard_normal(3), -2.0, 2.0)

    def plan(self, trial: Trial, *, seed: int, rate_hz: float = 50.0) -> Demonstration:
        """Return a trial's demonstration.

        Raises:
            UsageError: A pose is out of reach.
        """
        style = self.style(seed, trial)
        phases = self.phases(style)
        grasps: list[Array] = []
        for shift_m, T_rod_tcp in zip(style.shifts_m, self._grasps, strict=True):
            grasps.append(pose(np.eye(3), (0.0, shift_m, 0.0)) @ T_rod_tcp)
        ticks = round(phases["rest"].end_s * rate_hz)
        times = np.arange(ticks) / rate_hz
        error = self.approach_error(seed, trial)
        q = np.empty((ticks, self._robot.dof))
        posture = self._robot.home.copy()
        for tick, t_s in enumerate(times.tolist()):
            progress = _progress(phases, t_s)
            hands = self._hand_poses(trial, error, grasps, progress)
            posture = posture_at(self._robot, hands, posture, self._robot.home, self._costs)
            q[tick] = posture
        closes = times >= phases["close"].start_s - 1e-9
        is_closed = closes & (times < phases["open"].start_s - 1e-9)
        gripper = np.where(is_closed[:, None], 0.0, 1.0) * np.ones(2)
        return Demonstration(rate_hz, q, gripper)

    def _hand_poses(
        self,
        trial: Trial,
        error: Array,
        grasps: Sequence[Array],
        progress: Mapping[str, float],
    ) -> tuple[Array, Array]:
        """Return the left and right T_world_tcp (4, 4).

        Args:
            trial: Start and goal of the rod.
            error: (3,), of the approach.
            grasps: Left and right T_rod_tcp (4, 4).
            progress: Of each phase, 0 to 1.
        """
        name = self.scene.object.name
        begin = np.array(placement(trial.start[name]))
        goal = np.array(placement(trial.goal[name]))
        # Along the object, the error is corrected on the way down: corrected any earlier, the hands
        # would tell a policy where the grasp is, and its own error would feed itself
        # (docs/learning.md).
        corrected = np.array([progress["correct"], progress["descend"], progress["correct"]])
        start = begin + rot_z(begin[2]) @ (error * (1.0 - corrected))
        x, y, yaw = start + (goal - start) * progress["carry"]
        away = 1.0 - progress["descend"] + progress["retreat"]
        above_m = PHASES["approach"].rise_m * away
        lift_m = self.scene.task.lift_height_m
        lifted_m = lift_m * progress["lift"]
        lifted_m -= (lift_m - _LANDING_M) * progress["lower"]
        lifted_m -= (_LANDING_M + self.config.set_down_m) * progress["land"]
        height_m = self.scene.object.rest_height_m + above_m + lifted_m
        T_world_rod = level_pose(x, y, height_m, yaw)
        left, right = (T_world_rod @ T_rod_tcp for T_rod_tcp in grasps)
        arrived = progress["approach"]
        if arrived < 1.0:
            left_home, right_home = self._home_poses
            left = _between(left_home, left, arrived)
            right = _between(right_home, right, arrived)
        return left, right


def _progress(phases: Mapping[str, Span], t_s: float) -> dict[str, float]:
    """Return how far each phase is at a time, 0 to 1."""
    progress: dict[str, float] = {}
    for name, span in phases.items():
        share, _, _ = minimum_jerk((t_s - span.start_s) / (span.end_s - span.start_s))
        progress[name] = share
    return progress


def _between(T_from: Array, T_to: Array, s: float) -> Array:
    """Return the pose (4, 4) of a hand that points down, a share s of the way."""
    position = T_from[:3, 3] + s * (T_to[:3, 3] - T_from[:3, 3])
    yaw_from = np.arctan2(T_from[1, 0], T_from[0, 0])
    yaw_to = np.arctan2(T_to[1, 0], T_to[0, 0])
    turn = np.arctan2(np.sin(yaw_to - yaw_from), np.cos(yaw_to - yaw_from))
    return pose(rot_z(yaw_from + s * turn) @ rot_x(np.pi), position)
