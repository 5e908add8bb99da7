"""The parts of a task, its trials, and the placements of objects."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from minidual.config.root import Config
from minidual.config.scene import ObjectConfig, ObstacleConfig, SceneConfig
from minidual.config.seeds import stream
from minidual.errors import ConfigError
from minidual.robot.pair import SIDES, Array, pose, rot_x, rot_z
from minidual.tasks.success import SuccessCondition

Placement = tuple[float, float, float]
"""(x [m], y [m], yaw [rad]) on the table."""
ObjectPose = Array | Placement
"""As in minidual.plant.bodies."""
Poses = dict[str, ObjectPose]
"""By object."""
DOWN = rot_z(np.pi / 2.0) @ rot_x(np.pi)
"""Orientation (3, 3) of a hand over an object that lies along y."""
_ROOM_M = 0.02


@dataclass(frozen=True)
class Trial:
    """Randomised trial `index` of the random stream `purpose`."""

    purpose: str
    index: int
    start: Mapping[str, ObjectPose]
    goal: Mapping[str, ObjectPose]


@dataclass(frozen=True)
class TaskObject:
    """An object of a task.

    Attributes:
        grasps: T_object_tcp (4, 4) by hand.
        symmetry: Yaws that look alike in a turn: 2 for a rod.
        touches_m: (x, y, z) in its frame where it touches others first.
    """

    body: ObjectConfig
    grasps: Mapping[str, Array] = field(default_factory=dict)
    symmetry: int = 1
    touches_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Step:
    """One step of a plan.

    Attributes:
        phase: Row of minidual.skills.phases.
        objects: One for all hands or one a hand; empty for the task's first.
        places: Target poses (4, 4) of the object, or {object: pose}, preferred first; empty for the
            trial's goals.
        grasps: T_object_tcp (4, 4) of the hand, preferred first; empty for the object's.
    """

    phase: str
    hands: tuple[str, ...] = SIDES
    objects: tuple[str, ...] = ()
    places: tuple[Array | Mapping[str, Array], ...] = ()
    grasps: tuple[Array, ...] = ()


@dataclass(frozen=True)
class Task:
    """A task.

    Attributes:
        instruction: For people and language-conditioned policies.
        objects: By name; the first is carried, disturbed and measured.
        success: (task, trial) -> new conditions.
        draw: (task, rng, widen) -> start and goal, each {object: pose}.
        arrange: (task, trial, sensed poses) -> lists of steps, preferred first, where they depend on the start.
    """

    name: str
    instruction: str
    config: Config
    objects: Mapping[str, TaskObject]
    success: Callable[[Task, Trial], Sequence[SuccessCondition]]
    draw: Callable[[Task, np.random.Generator, float], tuple[Poses, Poses]]
    steps: tuple[Step, ...] = ()
    stream: str = "trial"
    arrange: Callable[[Task, Trial, Mapping[str, Array]], Iterable[Sequence[Step]]] | None = None

    @property
    def scene(self) -> SceneConfig:
        """The scene."""
        return self.config.scene

    @property
    def carried(self) -> str:
        """Name of the first object."""
        return next(iter(self.objects))

    @property
    def together(self) -> bool:
        """Whether both hands hold one object all the way."""
        return bool(self.steps) and all(
            step.hands == SIDES and len(step.objects) < 2 for step in self.steps
        )

    @property
    def time_limit_s(self) -> float:
        """Simulated time limit."""
        return self.scene.task.time_limit_s

    def trial(self, seed: int, purpose: str, index: int, *, widen: float = 1.0) -> Trial:
        """Draw a trial; `widen` scales the start's range."""
        rng = stream(seed, f"{self.stream}/{purpose}", index)
        start, goal = self.draw(self, rng, widen)
        return Trial(purpose, index, start, goal)


def check_objects(task: str, scene: SceneConfig, names: Sequence[str]) -> None:
    """Check that the scene holds no other objects than those that a task handles by name.

    Raises:
        ConfigError: Another object.
    """
    for name in scene.objects:
        if name not in names:
            raise ConfigError(
                f"the task '{task}' has no object '{name}'; there are {', '.join(names)}",
                remedy=f"leave the names of the scene's objects as they are in '{task}', "
                "or choose other tasks",
            )


def placement(pose: ObjectPose) -> Placement:
    """Return the placement of an object pose."""
    if isinstance(pose, tuple):
        return pose
    return float(pose[0, 3]), float(pose[1, 3]), float(np.arctan2(-pose[0, 1], pose[1, 1]))


def level_pose(x: float, y: float, z: float, yaw_rad: float) -> Array:
    """Return the pose (4, 4) of a level object."""
    return pose(rot_z(yaw_rad), (x, y, z))


def level_part(T_world_object: Array) -> Array:
    """Return the pose without tilt or roll."""
    return pose(rot_z(placement(T_world_object)[2]), T_world_object[:3, 3])


def pose_of(body: ObjectConfig, where: ObjectPose) -> Array:
    """Return the pose (4, 4) for a pose or (x, y, yaw) on the table."""
    if not isinstance(where, tuple):
        return where
    x, y, yaw = where
    return level_pose(x, y, body.rest_height_m, yaw)


def near(
    rng: np.random.Generator,
    middle: Placement,
    range_m: float,
    range_rad: float,
) -> Placement:
    """Draw a placement uniformly within +- range_m (x and y) and +- range_rad round a middle."""
    x, y, yaw = middle
    dx, dy, turn = (rng.uniform(-1.0, 1.0, 3) * (range_m, range_m, range_rad)).tolist()
    return x + dx, y + dy, yaw + turn


def beside(body: ObjectConfig, block: ObstacleConfig, place: Placement) -> bool:
    """Return whether a body keeps 2 cm from a block."""
    x, y, yaw = place
    half_x = max(abs(part.position_m[0]) + part.half_m[0] for part in body.solids)
    half_y = max(abs(part.position_m[1]) + part.half_m[1] for part in body.solids)
    c = abs(math.cos(yaw))
    s = abs(math.sin(yaw))
    x_block, y_block = block.xy_m
    size_x, size_y, _ = block.size_m
    gap_x = abs(x - x_block) - c * half_x - s * half_y
    gap_y = abs(y - y_block) - s * half_x - c * half_y
    return gap_x > size_x / 2 + _ROOM_M or gap_y > size_y / 2 + _ROOM_M


def grasp_offsets(scene: SceneConfig) -> tuple[Array, Array]:
    """Return left and right T_object_tcp, pointing down; left is the +y end."""
    y = scene.object.grasp_offset_m
    z = scene.object.grasp_height_m
    return pose(DOWN, (0.0, y, z)), pose(DOWN, (0.0, -y, z))


def tilt_rad(T_world_object: Array, body: ObjectConfig) -> float:
    """Return the long axis' tilt."""
    if body.upright:
        return math.acos(min(1.0, abs(T_world_object.item(2, 2))))
    along = abs(T_world_object.item(2, 1))  # a rounded matrix may have more than 1
    return math.asin(along if along < 1.0 else 1.0)
