"""Scripted operator: joint targets of a trial, whose start and goal it knows.

By default, fixed timing makes its motion a smooth, learnable function of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from minidual.config.learning import OperatorConfig
from minidual.config.scene import SceneConfig
from minidual.config.seeds import stream, subseed
from minidual.control.kernels import minimum_jerk
from minidual.motion.api import Planner
from minidual.motion.ik import ArmIK, posture_at, solvers
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import GROUP_ARMS, SIDES, Array, pose, rot_x, rot_z
from minidual.skills.cycle import solve
from minidual.skills.phases import OPEN, PHASES, State
from minidual.tasks.task import Task, Trial, grasp_offsets, level_pose, placement, pose_of

_LASTS_S = {
    "approach": 1.8,
    "correct": 0.6,
    "descend": 0.9,
    "close": 0.7,
    "lift": 0.8,
    "carry": 2.0,
}
_LASTS_S |= {"lower": 0.8, "open": PHASES["open"].hold_s, "retreat": 0.5, "rest": 0.1}
_OVERLAPPING = ("correct", "descend")
_PAUSED = ("lift", "lower")
# The last joint only turns the hand. With equal costs the elbow swings, and near the table joint 5 moves three times
# as fast.
_CONFIG = OperatorConfig()
_WRIST_COST = 0.1

_SPEED_SHARE = 0.6  # of the joints' limits, where a plan is demonstrated


@dataclass(frozen=True)
class Demonstration:
    """Operator commands of one trial.

    Attributes:
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
    """What a trial's operator does in its own way.

    Attributes:
        pace: Factors of the durations, by phase.
        pauses_s: Before phases.
        shifts_m: Of the left and right grasp along the object.
    """

    pace: Mapping[str, float] = field(default_factory=dict)
    pauses_s: Mapping[str, float] = field(default_factory=dict)
    shifts_m: tuple[float, float] = (0.0, 0.0)


_PLAIN = Style()


class ScriptedOperator:
    """Plans demonstrations of the rod task."""

    def __init__(
        self,
        scene: SceneConfig,
        config: OperatorConfig = _CONFIG,
        *,
        kinematics: Kinematics | None = None,
    ) -> None:
        self.scene = scene
        self.config = config
        kinematics = kinematics or Kinematics()
        self._robot = robot = kinematics.robot
        self._costs = np.r_[np.ones(robot.dof_per_arm - 1), _WRIST_COST]
        self._home_poses = kinematics.tcp_poses(robot.home)
        self._grasps = grasp_offsets(scene)

    def style(self, seed: int, trial: Trial) -> Style:
        """Draw the style of a trial."""
        rng = stream(seed, f"operator-style/{trial.purpose}", trial.index)
        config = self.config
        pace = 1.0 + config.speed_spread * rng.uniform(-1.0, 1.0, len(_LASTS_S))
        pauses = config.pause_s * rng.uniform(0.0, 1.0, len(_PAUSED))
        left, right = config.grasp_spread_m * rng.uniform(-1.0, 1.0, 2)
        return Style(
            dict(zip(_LASTS_S, pace, strict=True)),
            dict(zip(_PAUSED, pauses, strict=True)),
            (left, right),
        )

    def phases(self, style: Style = _PLAIN) -> dict[str, tuple[float, float]]:
        """Return {name: (start, end) [s]}."""
        # they overlap over the rod, where a policy without speed or time could learn to wait for ever
        phases = {}
        end = 0.0
        for name, lasts_s in _LASTS_S.items():
            start = (
                end
                - (self.config.overlap_s if name in _OVERLAPPING else 0.0)
                + style.pauses_s.get(name, 0.0)
            )
            phases[name] = start, (end := start + lasts_s * style.pace.get(name, 1.0))
        return phases

    def approach_error(self, seed: int, trial: Trial) -> Array:
        """Return the random error across [m] and along [m] the object and in yaw [rad]."""
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
        shifts = zip(style.shifts_m, self._grasps, strict=True)
        grasps = [pose(np.eye(3), (0.0, shift, 0.0)) @ T for shift, T in shifts]
        ticks = round(phases["rest"][1] * rate_hz)
        times = np.arange(ticks) / rate_hz
        error = self.approach_error(seed, trial)
        q = np.empty((ticks, self._robot.dof))
        current = self._robot.home.copy()
        for k, t in enumerate(times.tolist()):
            progress = {
                name: minimum_jerk((t - start) / (end - start))[0]
                for name, (start, end) in phases.items()
            }
            hands = self._hand_poses(trial, error, grasps, progress)
            q[k] = current = posture_at(self._robot, hands, current, self._robot.home, self._costs)
        closed = (times >= phases["close"][0] - 1e-9) & (times < phases["open"][0] - 1e-9)
        return Demonstration(rate_hz, q, np.where(closed[:, None], 0.0, 1.0) * np.ones(2))

    def _hand_poses(
        self,
        trial: Trial,
        error: Array,
        grasps: Sequence[Array],
        progress: Mapping[str, float],
    ) -> tuple[Array, Array]:
        begin, goal = (
            np.array(placement(where[self.scene.object.name]))
            for where in (trial.start, trial.goal)
        )
        # Along the object on the way down: corrected any earlier, the hands would tell a policy where the grasp is, and
        # its own error would feed itself (docs/learning.md).
        left = 1.0 - np.array([progress[phase] for phase in ("correct", "descend", "correct")])
        start = begin + rot_z(begin[2]) @ (error * left)
        x, y, yaw = start + (goal - start) * progress["carry"]
        above = PHASES["approach"].rise_m * (1.0 - progress["descend"] + progress["retreat"])
        raised = self.scene.task.lift_height_m * (progress["lift"] - progress["lower"])
        T_world_rod = level_pose(x, y, self.scene.object.rest_height_m + above + raised, yaw)
        hands = [T_world_rod @ T_rod_tcp for T_rod_tcp in grasps]
        s = progress["approach"]
        if s < 1.0:
            hands = [
                _between(T_home, T_goal, s)
                for T_home, T_goal in zip(self._home_poses, hands, strict=True)
            ]
        return hands[0], hands[1]


def _between(T_from: Array, T_to: Array, s: float) -> Array:
    position = T_from[:3, 3] + s * (T_to[:3, 3] - T_from[:3, 3])
    turn_from, turn_to = (np.arctan2(T[1, 0], T[0, 0]) for T in (T_from, T_to))
    turn = np.arctan2(np.sin(turn_to - turn_from), np.cos(turn_to - turn_from))
    return pose(rot_z(turn_from + s * turn) @ rot_x(np.pi), position)


def demonstrate_plan(
    task: Task,
    trial: Trial,
    planner: Planner,
    *,
    seed: int,
    rate_hz: float,
) -> Demonstration:
    """Return the task's plan as a demonstration; while both are open, hands err along what they grasp until they are down.

    Raises:
        TaskFailedError: There is no plan.
    """
    robot = planner.robot
    start = State(
        robot.home,
        {name: pose_of(item.body, trial.start[name]) for name, item in task.objects.items()},
    )
    own = subseed(seed, f"operator/{trial.purpose}", trial.index)
    segments = solve(
        task,
        trial,
        start,
        planner,
        own,
        task.config.supervisor.self_collision_min_m,
    ).segments
    rng = stream(seed, f"operator/{trial.purpose}", trial.index)
    noise_m = task.config.teleop.operator.along_noise_m
    errors_m = noise_m * np.clip(rng.standard_normal(len(SIDES)), -2.0, 2.0)
    q = list[Array]()
    gripper = list[Array]()
    for segment in segments:
        # Faster, the arms would lag by up to 0.3 rad behind what is streamed and leave the proven path.
        motion = segment.trajectory
        slower = max(1.0, float(np.abs(motion.v / robot.v_max).max()) / _SPEED_SHARE)
        times: Array = np.arange(0.0, motion.duration_s, 1.0 / (slower * rate_hz), dtype=float)
        planned = motion.sample_many(times)[0]
        # a hand that takes something from the other one needs its room
        if segment.phase in ("approach", "descend") and min(segment.openings) == OPEN:
            arrived = np.array([minimum_jerk(t / motion.duration_s)[0] for t in times.tolist()])
            shares = arrived if segment.phase == "approach" else 1.0 - arrived
            for side in GROUP_ARMS[motion.group]:
                _shift_along(solvers(robot)[side], planned, shares * errors_m[SIDES.index(side)])
        q.append(planned)
        gripper.append(np.tile(segment.openings, (len(times), 1)))
    rest = round(rate_hz * _LASTS_S["rest"])
    q.append(np.tile(segments[-1].trajectory.q[-1], (rest, 1)))
    gripper.append(np.tile(segments[-1].openings, (rest, 1)))
    return Demonstration(rate_hz, np.vstack(q), np.vstack(gripper))


def _shift_along(arm: ArmIK, q: Array, offsets_m: Array) -> None:
    """Shift a hand by offsets (T,) along what lies between its fingers; q is (T, n) [rad]."""
    for row, offset_m in zip(q[:, arm.joints], offsets_m.tolist(), strict=True):
        shifted = arm.nearest(arm.tcp_pose(row) @ pose(np.eye(3), (offset_m, 0.0, 0.0)), row)
        row[:] = row if shifted is None else shifted
