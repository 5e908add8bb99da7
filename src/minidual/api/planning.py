"""Plan motions and prove them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from minidual.collision import scene_file
from minidual.collision.scene import PlanningScene
from minidual.config.scene import RobotConfig
from minidual.durable import expanded
from minidual.motion import api
from minidual.motion.checks import check_joints
from minidual.motion.goal import Goal, goal_of
from minidual.motion.goal_plan import GoalPlanner
from minidual.robot.pair import GROUP_ARMS, SIDES, Array, Robot, robot_from
from minidual.robot.trajectory import JointSamples, Trajectory

_RATIOS = ("velocity", "acceleration", "jerk", "torque", "torque_rate")


@dataclass(frozen=True, eq=False)
class Plan:
    """A timed motion of both arms that is proven free of collisions and within all limits.

    Attributes:
        group: "left_arm", "right_arm" or "both_arms"; the other arm stands still.
        trajectory: Samples at 1 kHz: `times` (k,) [s], `q` (k, n) [rad], `v`, `a`.
        proven: Whether the proof holds, between the samples too. Planners return no other plan.
        planning_s: Wall time of planning and proof [s], without building the scene's geometry.
        times_s: Wall time of each phase [s]: scene, ik, search, shortcut, blend, timing, verify.
        clearance_m: Smallest distance [m] between parts that may not touch; 0.05 means "at least".
        limits_used: Largest fraction of each limit: velocity, acceleration, jerk, torque,
            torque_rate.
        attempts_n: Attempts until the proof held.
        notes: Why earlier attempts failed, or why a straight line ends early.
    """

    group: str
    trajectory: Trajectory
    proven: bool
    planning_s: float
    times_s: Mapping[str, float]
    clearance_m: float
    limits_used: Mapping[str, float]
    attempts_n: int
    notes: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        """Length of the motion [s]."""
        return self.trajectory.duration_s

    @property
    def q_end_rad(self) -> Array:
        """Joints of both arms (n,) [rad] at the end."""
        return self.trajectory.q[-1]

    def sample(self, t_s: float) -> JointSamples:
        """Return q [rad], v [rad/s] and a [rad/s^2], each (n,), at a time [s]."""
        return self.trajectory.sample(t_s)


type Joints = Array | Sequence[float]
"""Joints [rad] of the group, or of both arms (n,), left arm first."""
type Target = str | Goal | Joints | Mapping[str, Array]
"""A named state, a goal file, a `Goal`, joints, or {"left"/"right": T_world_tcp (4, 4)}."""
type Start = str | Joints | Plan
"""A named state, joints of both arms, or a plan, at its end."""


class Planner:
    """Plans motions of one or both arms, and proves each.

    A planner keeps the geometry of its scene: make one and ask it often. The first plan of a
    process loads compiled code.

    Attributes:
        scene: Obstacles, held objects and allowed collisions.
        robot: The arms of the scene: `joint_names`, `q_lower`, `q_upper` (n,) [rad], ...

    Args:
        scene: By default the bare table.
        arm: Arm model of a planner without a scene: "panda", "xarm7" or "ur5".

    Raises:
        UsageError: Unknown arm.
    """

    def __init__(self, scene: PlanningScene | None = None, *, arm: str = "panda") -> None:
        self.scene = scene if scene is not None else PlanningScene(robot=_robot(arm))
        self.robot = self.scene.robot
        self._engine = api.Planner(self.scene)
        self._goals = GoalPlanner(self._engine)

    @property
    def home(self) -> Array:
        """Joints of both arms at home (n,) [rad]; a copy."""
        return self.robot.home.copy()

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the postures that a goal or start may name."""
        return tuple(self._goals.states)

    def tcp_poses(self, q_rad: Joints) -> dict[str, Array]:
        """Return {"left": T_world_tcp (4, 4), "right": ...} at joints of both arms (n,) [rad]."""
        q = check_joints(np.asarray(q_rad, dtype=float), "q_rad", self.robot)
        poses = self._engine.kinematics.tcp_poses(q)
        return {side: pose.copy() for side, pose in zip(SIDES, poses, strict=True)}

    def plan(
        self,
        goal: Target,
        *,
        group: str = "both_arms",
        start: Start = "home",
        seed: int = 0,
        budget_s: float | None = None,
    ) -> Plan:
        """Plan from `start` to `goal`; the same query and seed give the same motion.

        Args:
            goal: A named state ("ready"), a goal file, a `Goal`, joints [rad] of the group or of
                both arms, or tcp poses {"left": T_world_tcp (4, 4)}; a hand without a pose keeps
                its own.
            group: "left_arm", "right_arm" or "both_arms".
            start: A named state, joints of both arms (n,) [rad], or a plan, to go on from its end.
            seed: Of the random search.
            budget_s: Wall time after which the search gives up [s]. By default it counts work, so
                that the result does not depend on the machine.

        Raises:
            PlanningError: Start or goal is out of reach, out of limits or in collision, or there
                is no proven path within the budget.
            UsageError: An unknown name, or a goal that moves an arm outside the group.
        """
        q_start = self._start(start)
        result = self._result(goal, group, q_start, seed, budget_s)
        proof = result.verification
        return Plan(
            group=group,
            trajectory=result.trajectory,
            proven=proof.ok,
            planning_s=result.total_s - result.times_s["scene"],
            times_s=dict(result.times_s),
            clearance_m=self._engine.engines().clearance(result.trajectory),
            limits_used={name: getattr(proof, f"{name}_ratio") for name in _RATIOS},
            attempts_n=result.attempts_n,
            notes=result.notes,
        )

    def _start(self, start: Start) -> Array:
        """Return the joints of both arms (n,) [rad] of a start."""
        if isinstance(start, Plan):
            return start.q_end_rad
        if isinstance(start, str):
            return self._goals.states.joints(start, "both_arms", self.robot.home)
        return check_joints(np.asarray(start, dtype=float), "start", self.robot)

    def _result(
        self,
        goal: Target,
        group: str,
        q_start: Array,
        seed: int,
        budget_s: float | None,
    ) -> api.PlanResult:
        options: api.QueryOptions = {"seed": seed}
        if budget_s is not None:
            options["budget_s"] = budget_s
        if isinstance(goal, str):
            goal = goal_of(goal, self._goals.states)
        if isinstance(goal, Goal):
            return self._goals.plan(group, q_start, goal, **options)
        if isinstance(goal, Mapping):
            arms = GROUP_ARMS[group]
            kept = {arm: pose for arm, pose in self.tcp_poses(q_start).items() if arm in arms}
            return self._engine.plan_to_poses(group, q_start, {**kept, **goal}, **options)
        q_goal = np.asarray(goal, dtype=float)
        return self._engine.plan_to_joints(group, q_start, q_goal, **options)


def load_scene(path: str | Path, *, arm: str = "panda") -> PlanningScene:
    """Read a planning scene in YAML: obstacles, meshes, held objects, allowed collisions.

    Args:
        path: The scene file (docs/planning-scenes.md); meshes are relative to it.
        arm: Arm model that the scene is for: "panda", "xarm7" or "ur5".

    Raises:
        ConfigError: Invalid file; the message names line and dotted path.
        UsageError, DataError: Unknown name, or an unfit mesh.
    """
    scene, _ = scene_file.load_scene(expanded(str(path)), _robot(arm))
    return scene


def _robot(arm: str) -> Robot:
    return robot_from(RobotConfig(arm=arm))
