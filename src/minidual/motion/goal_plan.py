"""Planning to goals of every kind."""

from time import perf_counter
from typing import Unpack

import numpy as np
import pinocchio as pin

from minidual.collision.scene import PlanningScene
from minidual.config.scene import SemanticsConfig
from minidual.config.seeds import stream
from minidual.errors import UsageError, check_name, unknown_name
from minidual.motion.api import PLAN_PHASES, Planner, PlanResult, QueryOptions
from minidual.motion.checks import check_joints, goal_joints
from minidual.motion.goal import Goal, TipOffset, TipPose
from minidual.motion.linear import LinearPlanner
from minidual.motion.pose_goals import pose_goals
from minidual.motion.states import NamedStates
from minidual.robot.pair import GROUP_ARMS, SIDES, Array, pose


class GoalPlanner:
    """Plans to a `Goal`. One instance per process."""

    def __init__(
        self,
        planner: Planner | None = None,
        semantics: SemanticsConfig | None = None,
    ) -> None:
        self.planner = planner or Planner()
        self.robot = self.planner.robot
        self.states = NamedStates(semantics, self.robot)
        self._linear = LinearPlanner(
            self.planner.config,
            self.planner.kinematics,
            self.planner.timing,
        )

    def resolve(
        self,
        group: str,
        q_start: Array,
        goal: Goal,
        scene: PlanningScene | None = None,
    ) -> Array | dict[str, Array]:
        """Return a goal as joints (n,) or tcp poses {arm: T_world_tcp (4, 4)}.

        Raises:
            UsageError, OutOfLimitsError: Unknown name, arm outside the group, or joints outside
                limits.
        """
        q_start = check_joints(q_start, "start", self.robot)
        if goal.state is not None:
            return self.states.joints(goal.state, group, q_start)
        if goal.joints_rad is not None:
            return goal_joints(group, q_start, np.array(goal.joints_rad), self.robot)
        if goal.joints_by_name_rad is not None:
            q = self._with_named_joints(q_start, goal.joints_by_name_rad)
            return goal_joints(group, q_start, q, self.robot)
        return self._tip_targets(group, q_start, goal, scene or self.planner.scene)

    def _with_named_joints(self, q_start: Array, values_rad: dict[str, float]) -> Array:
        names = self.robot.joint_names
        q = np.array(q_start)
        for name, value in values_rad.items():
            check_name("joint", name, names)
            q[names.index(name)] = value
        return q

    def _tip_targets(
        self,
        group: str,
        q_start: Array,
        goal: Goal,
        scene: PlanningScene,
    ) -> dict[str, Array]:
        """Return {arm: T_world_tcp} of the group's arms for `poses` or `move`."""
        arms = GROUP_ARMS[group]
        tips = dict(zip(SIDES, self.planner.kinematics.tcp_poses(q_start), strict=True))
        entries: dict[str, TipPose] | dict[str, TipOffset] = {}
        in_tcp_axes = False
        if goal.move is not None:
            entries = goal.move.named()
            in_tcp_axes = goal.move.frame == "tcp"
        elif goal.poses is not None:
            entries = goal.poses.named()
        for arm, entry in entries.items():
            if arm not in arms:
                raise UsageError(
                    f"the goal moves the {arm} hand; {group} moves {' and '.join(arms)} only",
                )
            if isinstance(entry, TipPose):
                T_world_frame = self._frame(entry.frame, q_start, scene)
                tips[arm] = _posed(entry, T_world_frame, tips[arm])
            else:
                tips[arm] = _moved(entry, tips[arm], in_tcp_axes)
        return {arm: tips[arm] for arm in arms}

    def _frame(self, name: str, q_start: Array, scene: PlanningScene) -> Array:
        """Return the pose (4, 4) of "world", a link, an obstacle or a held object."""
        if name == "world":
            return np.eye(4)
        for solid in scene.solids:
            if solid.name == name:
                return self._frame(solid.link, q_start, scene) @ solid.shape.T_parent_shape
        model = self.planner.kinematics.model
        data = self.planner.kinematics.data
        links = [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY]
        if name not in links:
            raise unknown_name("frame", name, {"world", *links, *scene.names})
        pin.forwardKinematics(model, data, q_start)
        frame_id = model.getFrameId(name, pin.FrameType.BODY)
        return pin.updateFramePlacement(model, data, frame_id).homogeneous

    def start_joints(
        self,
        group: str,
        q_near: Array,
        start: Goal,
        scene: PlanningScene | None = None,
        *,
        seed: int = 0,
    ) -> Array:
        """Return start joints (n,); for poses the free IK solution nearest to q_near (n,)."""
        target = self.resolve(group, q_near, start, scene)
        if not isinstance(target, dict):
            return target
        engines = self.planner.engines(scene)
        rng = stream(seed, "motion/start")
        restarts_n = self.planner.config.ik_restarts_n
        return pose_goals(group, q_near, target, engines, rng, restarts_n)[0]

    def plan(
        self,
        group: str,
        q_start: Array,
        goal: Goal,
        **options: Unpack[QueryOptions],
    ) -> PlanResult:
        """Plan to a goal; see `Planner.plan_to_joints`.

        Straight moves ignore `seed` and budgets.

        Raises:
            LinearMoveError: A line ends before its fraction_min.
            And what `resolve` and the planner raise.
        """
        scene = options.get("scene")
        target = self.resolve(group, q_start, goal, scene)
        if not isinstance(target, dict):
            return self.planner.plan_to_joints(group, q_start, target, **options)
        if not goal.linear:
            return self.planner.plan_to_poses(group, q_start, target, **options)
        return self._plan_linear(group, q_start, target, goal.fraction_min, scene)

    def _plan_linear(
        self,
        group: str,
        q_start: Array,
        targets: dict[str, Array],
        fraction_min: float,
        scene: PlanningScene | None,
    ) -> PlanResult:
        began = perf_counter()
        engines = self.planner.engines(scene)
        move = self._linear.plan(group, q_start, targets, engines, fraction_min=fraction_min)
        total_s = perf_counter() - began
        path = move.trajectory.q[[0, -1]]
        notes: tuple[str, ...] = ()
        if move.fraction != 1.0:
            notes = (f"the line covers {move.fraction:.1%}: {move.reason}",)
        return PlanResult(
            trajectory=move.trajectory,
            path=path,
            q_goal=path[-1],
            verification=move.verification,
            times_s={**dict.fromkeys(PLAN_PHASES, 0.0), "search": total_s},
            total_s=total_s,
            attempts_n=1,
            notes=notes,
        )


def _posed(entry: TipPose, T_world_frame: Array, T_world_tcp: Array) -> Array:
    """Return the tcp pose (4, 4) of an entry; `T_world_tcp` is the present one."""
    position = np.array(entry.position_m)
    quat = entry.quaternion()
    if quat is None:
        return pose(T_world_tcp[:3, :3], (T_world_frame @ np.append(position, 1.0))[:3])
    return T_world_frame @ pose(pin.Quaternion(*quat).matrix(), position)


def _moved(entry: TipOffset, T_world_tcp: Array, in_tcp_axes: bool) -> Array:
    """Return the tcp pose (4, 4) after an offset, in the axes of the tcp or the world."""
    R = T_world_tcp[:3, :3]
    p = T_world_tcp[:3, 3]
    shift = np.array(entry.offset_m)
    turn = pin.exp3(np.array(entry.rotation_rad))
    if in_tcp_axes:
        return pose(R @ turn, p + R @ shift)
    return pose(turn @ R, p + shift)
