"""Goals of every kind, the schema of goal files (docs/planning-scenes.md), and planning to them.

poses:
  left: {position_m: [0.5, 0.25, 0.3], rpy_rad: [3.1416, 0, 0]}
linear: true
"""

from collections.abc import Iterable
from pathlib import Path
from time import perf_counter
from typing import Literal, Self, Unpack

import numpy as np
import pinocchio as pin
from pydantic import Field, model_validator

from minidual.collision.errors import OutOfLimitsError
from minidual.collision.scene import PlanningScene
from minidual.collision.scene_file import Finite3, PlaceFields
from minidual.config.base import StrictModel
from minidual.config.document import read_document
from minidual.config.scene import SemanticsConfig
from minidual.config.seeds import stream
from minidual.config.validation import validate_document
from minidual.durable import kind_of, read_json
from minidual.errors import ConfigError, DataError, UsageError, check_name, unknown_name
from minidual.motion.api import PLAN_PHASES, Planner, PlanResult, QueryOptions
from minidual.motion.ik import check_joints, goal_joints, pose_goals
from minidual.motion.linear import LinearPlanner
from minidual.robot.pair import DUAL_PANDA, GROUP_ARMS, SIDES, Array, Robot, pose

_KINDS = ("state", "joints_rad", "joints_by_name_rad", "poses", "move")
_BYTES_MAX = 2**26  # a minute of motion


class TipPose(PlaceFields):
    """Tcp pose; a missing orientation is that of the start."""

    frame: str = "world"
    """"world", a link (where it is at the start), an obstacle or a held object."""


class TipOffset(StrictModel):
    """Shift, and rotation vector about the tcp's origin."""

    offset_m: Finite3 = (0.0, 0.0, 0.0)
    rotation_rad: Finite3 = (0.0, 0.0, 0.0)


class _Hands[T](StrictModel):
    left: T | None = None
    right: T | None = None

    def named(self) -> dict[str, T]:
        return {
            side: tip
            for side, tip in (("left", self.left), ("right", self.right))
            if tip is not None
        }


class Poses(_Hands[TipPose]):
    """Tcp poses; with both_arms a missing hand keeps its pose."""


class Move(_Hands[TipOffset]):
    """Tcp offsets, in the axes of the world or of each tcp."""

    frame: Literal["world", "tcp"] = "world"


class Goal(StrictModel):
    """What to plan to: exactly one of the first five fields."""

    state: str | None = None
    joints_rad: tuple[float, ...] | None = None
    """Joints of the group or of the robot."""
    joints_by_name_rad: dict[str, float] | None = None
    """Unnamed joints stay."""
    poses: Poses | None = None
    move: Move | None = None
    linear: bool = False
    """Straight lines; only with poses or move."""
    fraction_min: float = Field(default=1.0, gt=0.0, le=1.0)
    """Part of the lines that suffices."""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        kinds = [kind for kind in _KINDS if getattr(self, kind) is not None]
        if len(kinds) != 1:
            raise ValueError(
                f"it holds {' and '.join(kinds) or 'no goal'}; give one of {', '.join(_KINDS)}",
            )
        hands = self.poses or self.move
        if hands is not None and not hands.named():
            raise ValueError(f"{kinds[0]} names neither left nor right")
        if self.linear and hands is None:
            raise ValueError(f"linear goes with poses or move, not with {kinds[0]}")
        if self.fraction_min < 1.0 and not self.linear:
            raise ValueError("fraction_min goes with linear: true")
        return self


def load_goal(path: Path) -> Goal:
    """Return the goal in a YAML file, or the last sample of a JSON trajectory.

    Raises:
        ConfigError: Invalid YAML.
        DataError: Not a trajectory.
    """
    if path.suffix.lower() == ".json":
        try:
            content = read_json(path, _BYTES_MAX)
            return Goal(
                joints_by_name_rad=dict(
                    zip(content["joint_names"], content["q_rad"][-1], strict=True),
                ),
            )
        except (ValueError, TypeError, KeyError, IndexError) as error:
            what = f"{type(error).__name__}: {error}"
            raise DataError(f"{path} is no trajectory of `minidual plan --out`: {what}") from error
    if not (document := read_document(path)).tree:
        raise ConfigError(
            f"{path.name}: the goal file is empty",
            remedy=f"give one of {', '.join(_KINDS)}",
        )
    return validate_document(document, Goal)


def goal_of(word: str, state_names: Iterable[str]) -> Goal:
    """Return the goal named by a state or file.

    Raises:
        UsageError: Neither exists.
    """
    names = tuple(state_names)
    if word in names:
        return Goal(state=word)
    path = Path(word)
    if path.suffix.lower() in (".yaml", ".yml", ".json"):
        if not kind_of(path):
            raise UsageError(f"there is no file {path}")
        return load_goal(path)
    error = unknown_name("named state", word, names)
    raise UsageError(f"{error.message}; a file ends in .yaml or .json", remedy=error.remedy)


class NamedStates(dict[str, dict[str, Array]]):
    """Postures {arm: joints [rad]} of arm model and configuration, by name.

    Raises:
        ConfigError: A state does not fit the robot.
    """

    def __init__(self, config: SemanticsConfig | None = None, robot: Robot = DUAL_PANDA) -> None:
        super().__init__()
        self.robot = robot
        self._add("home", robot.arm.home, robot.arm.home)
        for name, posture in robot.arm.postures.items():
            self._add(name, *posture)
        for name, state in (config or SemanticsConfig()).states.items():
            self._add(name, state.left_rad, state.right_rad)

    def _add(self, name: str, *arms: tuple[float, ...] | None) -> None:
        parts = self[name] = dict[str, Array]()
        for side, joints in zip(SIDES, arms, strict=True):
            if joints is None:
                continue
            where = f"semantics.states.{name}.{side}_rad"
            n = self.robot.dof_per_arm
            if len(joints) != n:
                raise ConfigError(f"{where}: {len(joints)} values; an arm has {n} joints")
            try:
                q = goal_joints(f"{side}_arm", self.robot.home, np.array(joints), self.robot, where)
            except OutOfLimitsError as error:
                raise ConfigError(error.message) from error
            parts[side] = q[self.robot.groups[f"{side}_arm"]]
        if not parts:
            raise ConfigError(f"semantics.states.{name}: it gives neither left_rad nor right_rad")

    def joints(self, name: str, group: str, q_others: Array) -> Array:
        """Return a state as q (n,); arms outside the group from `q_others` (n,).

        Raises:
            UsageError: Unknown state, or it lacks an arm of the group.
        """
        check_name("named state", name, self)
        q = np.array(q_others, dtype=float)
        for arm in GROUP_ARMS[group]:
            if arm not in self[name]:
                what = f"the state '{name}' says nothing about the {arm} arm, which {group} moves"
                raise UsageError(
                    what,
                    remedy=f"give semantics.states.{name}.{arm}_rad, or plan for another group",
                )
            q[self.robot.groups[f"{arm}_arm"]] = self[name][arm]
        return q


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
        self._linear = LinearPlanner(self.planner.config, self.planner.kinematics)

    def resolve(
        self,
        group: str,
        q_start: Array,
        goal: Goal,
        scene: PlanningScene | None = None,
    ) -> Array | dict[str, Array]:
        """Return a goal as joints (n,) or tcp poses {arm: T_world_tcp (4, 4)}.

        Raises:
            UsageError, OutOfLimitsError: Unknown name, arm outside the group, or joints outside limits.
        """
        arms = GROUP_ARMS[group]
        q_start = check_joints(q_start, "start", self.robot)
        if goal.state is not None:
            return self.states.joints(goal.state, group, q_start)
        if goal.joints_rad is not None:
            return goal_joints(group, q_start, np.array(goal.joints_rad), self.robot)
        if goal.joints_by_name_rad is not None:
            names = self.robot.joint_names
            q = np.array(q_start)
            for name, value in goal.joints_by_name_rad.items():
                check_name("joint", name, names)
                q[names.index(name)] = value
            return goal_joints(group, q_start, q, self.robot)
        tips = dict(zip(SIDES, self.planner.kinematics.tcp_poses(q_start), strict=True))
        asked, axes = (goal.poses, "") if goal.move is None else (goal.move, goal.move.frame)
        assert asked is not None
        for arm, tip in asked.named().items():
            if arm not in arms:
                raise UsageError(
                    f"the goal moves the {arm} hand; {group} moves {' and '.join(arms)} only",
                )
            T = tips[arm]
            R = T[:3, :3]
            p = T[:3, 3]
            if isinstance(tip, TipPose):
                T_world_frame = self._frame(tip.frame, q_start, scene or self.planner.scene)
                quat = tip.quaternion()
                position = np.array(tip.position_m)
                if quat is None:
                    tips[arm] = pose(R, (T_world_frame @ np.append(position, 1.0))[:3])
                else:
                    tips[arm] = T_world_frame @ pose(pin.Quaternion(*quat).matrix(), position)
                continue
            shift = np.array(tip.offset_m)
            turned = pin.exp3(np.array(tip.rotation_rad))
            tips[arm] = (
                pose(R @ turned, p + R @ shift) if axes == "tcp" else pose(turned @ R, p + shift)
            )
        return {arm: tips[arm] for arm in arms}

    def _frame(self, name: str, q_start: Array, scene: PlanningScene) -> Array:
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
        return pin.updateFramePlacement(
            model,
            data,
            model.getFrameId(name, pin.FrameType.BODY),
        ).homogeneous

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
        if not isinstance(resolved := self.resolve(group, q_near, start, scene), dict):
            return resolved
        engines = self.planner.engines(scene)
        rng = stream(seed, "motion/start")
        return pose_goals(group, q_near, resolved, engines, rng, self.planner.config.ik_restarts_n)[
            0
        ]

    def plan(
        self,
        group: str,
        q_start: Array,
        goal: Goal,
        **options: Unpack[QueryOptions],
    ) -> PlanResult:
        """Plan to a goal; see `Planner.plan_to_joints`. Straight moves ignore `seed` and `budget_s`.

        Raises:
            LinearMoveError: A line ends before its fraction_min.
            And what `resolve` and the planner raise.
        """
        scene = options.get("scene")
        if not isinstance(resolved := self.resolve(group, q_start, goal, scene), dict):
            return self.planner.plan_to_joints(group, q_start, resolved, **options)
        if not goal.linear:
            return self.planner.plan_to_poses(group, q_start, resolved, **options)
        began = perf_counter()
        engines = self.planner.engines(scene)
        move = self._linear.plan(group, q_start, resolved, engines, fraction_min=goal.fraction_min)
        took = perf_counter() - began
        path = move.trajectory.q[[0, -1]]
        note = (
            () if move.fraction == 1.0 else (f"the line covers {move.fraction:.1%}: {move.reason}",)
        )
        times = {**dict.fromkeys(PLAN_PHASES, 0.0), "search": took}
        return PlanResult(move.trajectory, path, path[-1], move.verification, times, took, 1, note)
