"""From any goal of the family to a proven plan: names become joints, frames become world poses, lines become moves."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter

import numpy as np
import pinocchio as pin

from minidual.collision.links import LINKS
from minidual.collision.scene import PlanningScene
from minidual.errors import UsageError, unknown_name
from minidual.motion.api import Planner
from minidual.motion.goal_types import Goal, JointGoal, PoseGoal, RelativeGoal, StateGoal, TipOffset, TipPose
from minidual.motion.goals import PoseGoals, check_joints, goal_joints, group_arms
from minidual.motion.ik import check_pose
from minidual.motion.linear import LinearMove, LinearPlanner
from minidual.motion.result import PHASES, PlanResult
from minidual.motion.semantics import Semantics, link_names
from minidual.robot.constants import ARMS, JOINT_NAMES, Array
from minidual.robot.kinematics import Kinematics
from minidual.robot.poses import pose, rotation_from_quat


@dataclass(frozen=True, eq=False)
class Resolved:
    """A goal in the planner's own words: joints, or poses of the group's tcps.

    Attributes:
        q: All 14 joints [rad], or None.
        targets: {arm: T_world_tcp (4, 4)} of exactly the group's arms, or None.
        linear: Whether the tcps go there on straight lines.
        fraction_min: Least part of the lines.
    """

    q: Array | None = None
    targets: Mapping[str, Array] | None = None
    linear: bool = False
    fraction_min: float = 1.0


class GoalPlanner:
    """Resolves and plans goals of every kind. One instance a process: it holds workspaces.

    Args:
        planner: Does the planning.
        semantics: Groups and named states; the built-in ones by default.
    """

    def __init__(self, planner: Planner | None = None, semantics: Semantics | None = None) -> None:
        self.planner = planner or Planner()
        self.semantics = semantics or Semantics()
        self._linear = LinearPlanner(self.planner.limits)
        self._kinematics = Kinematics()
        self._poses = PoseGoals()

    def resolve(self, group: str, q_start: Array, goal: Goal, scene: PlanningScene | None = None) -> Resolved:
        """Return what a goal means from a start.

        Args:
            group: "left_arm", "right_arm" or "both_arms".
            q_start: All 14 joints [rad].
            goal: Of any kind.
            scene: Its obstacles and held objects are frames, too.

        Raises:
            UsageError: Unknown group, state, joint, arm or frame (with the nearest that exists), a value that is not
                finite, an arm outside the group.
            OutOfLimitsError: Joints outside their limits.
        """
        arms = group_arms(group)
        q_start = check_joints(q_start, "start")
        match goal:
            case StateGoal():
                return Resolved(q=self.semantics.state(goal.name, group, q_start))
            case JointGoal():
                return Resolved(q=_joints(goal, group, q_start))
            case PoseGoal():
                _require_arms(goal.poses, arms, group)
                frames = _Frames(self._kinematics, q_start, scene or self.planner.scene)
                targets = {arm: frames.target(arm, goal.poses.get(arm)) for arm in arms}
            case RelativeGoal():
                _require_arms(goal.offsets, arms, group)
                frames = _Frames(self._kinematics, q_start, scene or self.planner.scene)
                targets = {arm: frames.moved(arm, goal.offsets.get(arm), goal.frame) for arm in arms}
        return Resolved(targets=targets, linear=goal.linear, fraction_min=goal.fraction_min)

    def start_joints(
        self, group: str, q_near: Array, start: Goal, scene: PlanningScene | None = None, *, seed: int = 0
    ) -> Array:
        """Return a goal of any kind as a start (14,): poses by the nearest free solution to q_near (14,).

        Raises:
            What `resolve` raises, and IKUnreachableError or GoalInCollisionError for poses.
        """
        resolved = self.resolve(group, q_near, start, scene)
        if resolved.q is not None:
            return resolved.q
        assert resolved.targets is not None
        config = self.planner.config
        return self._poses.candidates(
            group,
            q_near,
            resolved.targets,
            self.planner.engines(scene).mujoco,
            np.random.default_rng([seed, 3]),
            restarts_n=config.ik_restarts_n,
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
        """Plan to a goal of any kind; see `Planner.plan_to_joints` for the rest.

        A straight move that covers at least its fraction_min is a plan; `linear_move` tells how far it goes. It follows
        its line and searches nothing, so neither `seed` nor `budget_s` changes anything there.

        Raises:
            LinearMoveError: A straight line ends too early.
            And all that `resolve` and the planner raise.
        """
        resolved = self.resolve(group, q_start, goal, scene)
        if resolved.q is not None:
            return self.planner.plan_to_joints(group, q_start, resolved.q, scene=scene, seed=seed, budget_s=budget_s)
        assert resolved.targets is not None
        if not resolved.linear:
            return self.planner.plan_to_poses(
                group, q_start, resolved.targets, scene=scene, seed=seed, budget_s=budget_s
            )
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
        """Return the straight move to resolved poses: trajectory, fraction and reason."""
        if resolved.targets is None:
            raise UsageError("a straight move needs poses as its goal")
        return self._linear.plan(
            group, q_start, resolved.targets, self.planner.engines(scene), fraction_min=resolved.fraction_min
        )


def _joints(goal: JointGoal, group: str, q_start: Array) -> Array:
    """Return the goal as (14,)."""
    if not isinstance(goal.values, Mapping):
        return goal_joints(group, q_start, np.array(goal.values, dtype=float))
    q = np.array(q_start)
    for name, value in goal.values.items():
        if name not in JOINT_NAMES:
            close = difflib.get_close_matches(name, JOINT_NAMES, n=1)
            raise UsageError(
                f"no joint '{name}'; there are {JOINT_NAMES[0]} to {JOINT_NAMES[6]} and {JOINT_NAMES[7]} to "
                f"{JOINT_NAMES[13]}",
                remedy=f"did you mean '{close[0]}'?" if close else None,
            )
        q[JOINT_NAMES.index(name)] = value
    return goal_joints(group, q_start, q)


def _require_arms(named: Mapping[str, object], arms: tuple[str, ...], group: str) -> None:
    for arm in named:
        if arm not in ARMS:
            raise unknown_name("arm", arm, ARMS)
        if arm not in arms:
            raise UsageError(f"the goal moves the {arm} hand; {group} moves {' and '.join(arms)} only")
    if not named:
        raise UsageError(f"the goal names no hand; {group} has {', '.join(arms)}")


class _Frames:
    """Frames of one scene, the arms standing at the start."""

    def __init__(self, kinematics: Kinematics, q_start: Array, scene: PlanningScene) -> None:
        self._kinematics = kinematics
        self._q = q_start
        self._scene = scene
        self.tips = dict(zip(ARMS, kinematics.tcp_poses(q_start), strict=True))

    def target(self, arm: str, tip: TipPose | None) -> Array:
        """Return T_world_tcp of a pose goal; without one the tcp stays."""
        if tip is None:
            return self.tips[arm]
        T_world_frame = self.frame(tip.frame)
        what = f"the target of the {arm} hand"
        if tip.quat_wxyz is None:
            at = T_world_frame @ np.append(np.asarray(tip.position_m, dtype=float), 1.0)
            return check_pose(pose(self.tips[arm][:3, :3], at[:3]), what)
        T = pose(rotation_from_quat(np.array(tip.quat_wxyz)), np.asarray(tip.position_m, dtype=float))
        return check_pose(T_world_frame @ check_pose(T, what), what)

    def moved(self, arm: str, offset: TipOffset | None, axes: str) -> Array:
        """Return T_world_tcp of a relative goal; without one the tcp stays."""
        T = self.tips[arm]
        if offset is None:
            return T
        if axes not in ("world", "tcp"):
            raise unknown_name("frame for offsets", axes, ("world", "tcp"))
        shift, turn = np.array(offset.offset_m, dtype=float), np.array(offset.rotation_rad, dtype=float)
        if not (np.isfinite(shift).all() and np.isfinite(turn).all()):
            raise UsageError(f"the offset of the {arm} hand is not finite: {shift.tolist()} m, {turn.tolist()} rad")
        R, turned = T[:3, :3], pin.exp3(turn)
        if axes == "tcp":
            return pose(R @ turned, T[:3, 3] + R @ shift)
        return pose(turned @ R, T[:3, 3] + shift)

    def frame(self, name: str) -> Array:
        """Return T_world_frame (4, 4).

        Raises:
            UsageError: No such frame.
        """
        if name == "world":
            return np.eye(4)
        for shape in self._scene.obstacles:
            if shape.name == name:
                return shape.T_parent_shape
        for held in self._scene.attached:
            if held.name == name:
                return self.frame(held.link) @ held.shape.T_parent_shape
        if name not in link_names():
            raise unknown_name("frame", name, frame_names(self._scene))
        model, data = self._kinematics.model, self._kinematics.data
        pin.forwardKinematics(model, data, self._q)
        return pin.updateFramePlacement(model, data, model.getFrameId(name)).homogeneous


def frame_names(scene: PlanningScene) -> tuple[str, ...]:
    """Return every frame that a goal may name: the world, links, obstacles and held objects."""
    others = tuple(name for name in scene.names if name not in LINKS)
    return tuple(dict.fromkeys(("world", *link_names(), *others)))
