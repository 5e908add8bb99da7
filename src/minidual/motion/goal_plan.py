"""Planning for every kind of goal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from time import perf_counter

import numpy as np
import pinocchio as pin

from minidual.collision.errors import OutOfLimitsError
from minidual.collision.scene import PlanningScene
from minidual.config.robot import SemanticsConfig
from minidual.errors import ConfigError, UsageError, unknown_name
from minidual.motion.api import Planner
from minidual.motion.goal import Goal, JointGoal, PoseGoal, RelativeGoal, StateGoal, TipOffset, TipPose
from minidual.motion.goals import check_joints, goal_joints, group_arms
from minidual.motion.ik import check_pose
from minidual.motion.linear import LinearMove, LinearPlanner
from minidual.motion.result import PHASES, PlanResult
from minidual.robot.arms import DUAL_PANDA
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array, Robot
from minidual.robot.poses import pose, rotation_from_quat


class NamedStates(Mapping[str, Mapping[str, Array]]):
    """Named postures {arm: joints [rad]} of arm model and configuration.

    Raises:
        ConfigError: A state does not fit the robot.
    """

    def __init__(self, config: SemanticsConfig | None = None, robot: Robot = DUAL_PANDA) -> None:
        self.robot = robot
        home = robot.arm.home
        self._states: dict[str, dict[str, Array]] = {"home": self._checked("home", home, home)}
        for name, posture in robot.arm.postures:
            self._states[name] = self._checked(name, posture.left, posture.right)
        for name, state in (config or SemanticsConfig()).states.items():
            self._states[name] = self._checked(name, state.left_rad, state.right_rad)

    def _checked(self, name: str, *arms: tuple[float, ...] | None) -> dict[str, Array]:
        parts: dict[str, Array] = {}
        for side, joints in zip(SIDES, arms, strict=True):
            if joints is None:
                continue
            where, n = f"semantics.states.{name}.{side}_rad", self.robot.dof_per_arm
            if len(joints) != n:
                raise ConfigError(f"{where}: {len(joints)} values; an arm has {n} joints")
            columns = self.robot.groups[f"{side}_arm"]
            q = self.robot.home.copy()
            q[columns] = joints
            try:
                parts[side] = check_joints(q, where, self.robot)[columns]
            except OutOfLimitsError as error:
                raise ConfigError(error.message) from error
        if not parts:
            raise ConfigError(f"semantics.states.{name}: it gives neither left_rad nor right_rad")
        return parts

    def __getitem__(self, name: str) -> Mapping[str, Array]:
        if name not in self._states:
            raise unknown_name("named state", name, self._states)
        return self._states[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._states)

    def __len__(self) -> int:
        return len(self._states)

    def joints(self, name: str, group: str, q_others: Array) -> Array:
        """Return a state as q (n,), other arms from `q_others` (n,).

        Raises:
            UsageError: Unknown state, or it lacks an arm of the group.
        """
        parts = self[name]
        q = np.array(q_others, dtype=float)
        for arm in group_arms(group):
            if arm not in parts:
                raise UsageError(
                    f"the state '{name}' says nothing about the {arm} arm, which {group} moves",
                    remedy=f"give semantics.states.{name}.{arm}_rad, or plan for another group",
                )
            q[self.robot.groups[f"{arm}_arm"]] = parts[arm]
        return q


@dataclass(frozen=True, eq=False)
class Resolved:
    """A goal as joints `q` (n,) [rad] or tcp poses `targets` {arm: T_world_tcp (4, 4)}; see `PoseGoal`."""

    q: Array | None = None
    targets: Mapping[str, Array] | None = None
    linear: bool = False
    fraction_min: float = 1.0


class GoalPlanner:
    """Resolves and plans goals. One instance per process; it holds workspaces."""

    def __init__(self, planner: Planner | None = None, semantics: SemanticsConfig | None = None) -> None:
        self.planner = planner or Planner()
        self.robot = self.planner.robot
        self.states = NamedStates(semantics, self.robot)
        self._linear = LinearPlanner(self.planner.limits, self.planner.kinematics)

    def resolve(self, group: str, q_start: Array, goal: Goal, scene: PlanningScene | None = None) -> Resolved:
        """Return a goal as joints or tcp poses.

        Raises:
            UsageError: Unknown name, value not finite, or arm outside the group.
            OutOfLimitsError: Joints outside limits.
        """
        arms = group_arms(group)
        q_start = check_joints(q_start, "start", self.robot)
        match goal:
            case StateGoal():
                return Resolved(q=self.states.joints(goal.name, group, q_start))
            case JointGoal():
                return Resolved(q=self._joints(goal, group, q_start))
        tips = goal.poses if isinstance(goal, PoseGoal) else goal.offsets
        _require_arms(tips, arms, group)
        frames = _Frames(self.planner.kinematics, q_start, scene or self.planner.scene)
        targets = dict(frames.tips)
        for arm, tip in tips.items():
            if isinstance(tip, TipPose):
                targets[arm] = frames.target(arm, tip)
            else:
                targets[arm] = frames.moved(arm, tip, goal.frame if isinstance(goal, RelativeGoal) else "world")
        return Resolved(None, {arm: targets[arm] for arm in arms}, goal.linear, goal.fraction_min)

    def start_joints(
        self, group: str, q_near: Array, start: Goal, scene: PlanningScene | None = None, *, seed: int = 0
    ) -> Array:
        """Return a goal as start joints (n,); for poses the free IK solution nearest to q_near (n,)."""
        resolved = self.resolve(group, q_near, start, scene)
        if resolved.q is not None:
            return resolved.q
        assert resolved.targets is not None
        return self.planner.goals.candidates(
            group,
            q_near,
            resolved.targets,
            self.planner.engines(scene),
            np.random.default_rng([seed, 3]),
            restarts_n=self.planner.config.ik_restarts_n,
            candidates_n=1,
        )[0]

    def plan(
        self,
        group: str,
        q_start: Array,
        goal: Goal,
        *,
        scene: PlanningScene | None = None,
        seed: int = 0,
        budget_s: float | None = None,
    ) -> PlanResult:
        """Plan to a goal; see `Planner.plan_to_joints`. Straight moves ignore `seed` and `budget_s`.

        Raises:
            LinearMoveError: A line ends before its fraction_min.
            And what `resolve` and the planner raise.
        """
        resolved = self.resolve(group, q_start, goal, scene)
        how = {"scene": scene, "seed": seed, "budget_s": budget_s}
        if resolved.q is not None:
            return self.planner.plan_to_joints(group, q_start, resolved.q, **how)
        assert resolved.targets is not None
        if not resolved.linear:
            return self.planner.plan_to_poses(group, q_start, resolved.targets, **how)
        began = perf_counter()
        move = self.linear_move(group, q_start, resolved, scene=scene)
        assert move.trajectory is not None
        assert move.verification is not None
        took = perf_counter() - began
        path = move.trajectory.q[[0, -1]]
        note = () if move.fraction == 1.0 else (f"the line covers {move.fraction:.1%}: {move.reason}",)
        times = {**dict.fromkeys(PHASES, 0.0), "search": took}
        return PlanResult(
            move.trajectory, path, path[-1], move.verification, times, took, 1, direct=True, rejections=note
        )

    def linear_move(
        self, group: str, q_start: Array, resolved: Resolved, *, scene: PlanningScene | None = None
    ) -> LinearMove:
        """Return the straight move to resolved poses."""
        if resolved.targets is None:
            raise UsageError("a straight move needs poses as its goal")
        return self._linear.plan(
            group, q_start, resolved.targets, self.planner.engines(scene), fraction_min=resolved.fraction_min
        )

    def _joints(self, goal: JointGoal, group: str, q_start: Array) -> Array:
        if not isinstance(goal.values, Mapping):
            return goal_joints(group, q_start, np.array(goal.values, dtype=float), self.robot)
        names = self.robot.joint_names
        q = np.array(q_start)
        for name, value in goal.values.items():
            if name not in names:
                raise unknown_name("joint", name, names)
            q[names.index(name)] = value
        return goal_joints(group, q_start, q, self.robot)


def _require_arms(named: Mapping[str, object], arms: tuple[str, ...], group: str) -> None:
    for arm in named:
        if arm not in SIDES:
            raise unknown_name("arm", arm, SIDES)
        if arm not in arms:
            raise UsageError(f"the goal moves the {arm} hand; {group} moves {' and '.join(arms)} only")
    if not named:
        raise UsageError(f"the goal names no hand; {group} has {', '.join(arms)}")


class _Frames:
    def __init__(self, kinematics: Kinematics, q_start: Array, scene: PlanningScene) -> None:
        self._kinematics = kinematics
        self._q = q_start
        self._scene = scene
        self.tips = dict(zip(SIDES, kinematics.tcp_poses(q_start), strict=True))

    def target(self, arm: str, tip: TipPose) -> Array:
        T_world_frame = self.frame(tip.frame)
        what = f"the target of the {arm} hand"
        position = np.asarray(tip.position_m, dtype=float)
        if tip.quat_wxyz is None:
            at = T_world_frame @ np.append(position, 1.0)
            return check_pose(pose(self.tips[arm][:3, :3], at[:3]), what)
        T = pose(rotation_from_quat(np.array(tip.quat_wxyz)), position)
        return check_pose(T_world_frame @ check_pose(T, what), what)

    def moved(self, arm: str, offset: TipOffset, axes: str) -> Array:
        if axes not in ("world", "tcp"):
            raise unknown_name("frame for offsets", axes, ("world", "tcp"))
        shift, turn = np.array(offset.offset_m, dtype=float), np.array(offset.rotation_rad, dtype=float)
        if not (np.isfinite(shift).all() and np.isfinite(turn).all()):
            raise UsageError(f"the offset of the {arm} hand is not finite: {shift.tolist()} m, {turn.tolist()} rad")
        T, turned = self.tips[arm], pin.exp3(turn)
        R = T[:3, :3]
        if axes == "tcp":
            return pose(R @ turned, T[:3, 3] + R @ shift)
        return pose(turned @ R, T[:3, 3] + shift)

    def frame(self, name: str) -> Array:
        """Return T_world_frame, or raise UsageError."""
        if name == "world":
            return np.eye(4)
        for shape in self._scene.obstacles:
            if shape.name == name:
                return shape.T_parent_shape
        for held in self._scene.attached:
            if held.name == name:
                return self.frame(held.link) @ held.shape.T_parent_shape
        model, data = self._kinematics.model, self._kinematics.data
        links = [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY]
        if name not in links:
            raise unknown_name("frame", name, {"world", *links, *self._scene.names})
        pin.forwardKinematics(model, data, self._q)
        return pin.updateFramePlacement(model, data, model.getFrameId(name, pin.FrameType.BODY)).homogeneous
