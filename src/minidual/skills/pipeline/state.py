"""State between stages, and motion segments."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from minidual.collision.scene import Attached, PlanningScene
from minidual.collision.shapes import Shape
from minidual.proof.verify import Verification
from minidual.robot.pair import SIDES, Array, Robot
from minidual.robot.poses import inverse
from minidual.robot.trajectory import Trajectory

OPEN, CLOSED = 1.0, 0.0


@dataclass(frozen=True, eq=False)
class State:
    """Arms, hands and object between two stages.

    Attributes:
        held_by: {arm: T_object_tcp (4, 4)} of holding hands.
        reached: The same of open hands over or at a grasp.
        openings: (left, right), 0 closed to 1 open.
        rests: Whether the object is supported.
    """

    q: Array
    T_world_object: Array
    held_by: Mapping[str, Array] = field(default_factory=dict)
    reached: Mapping[str, Array] = field(default_factory=dict)
    openings: tuple[float, float] = (OPEN, OPEN)
    rests: bool = True

    def opened(self, arms: Iterable[str], opening: float) -> State:
        """Return the state with some hands' opening changed."""
        left, right = (opening if arm in arms else now for arm, now in zip(SIDES, self.openings, strict=True))
        return replace(self, openings=(left, right))


@dataclass(frozen=True, eq=False)
class Segment:
    """Motion between two states.

    Attributes:
        scene: Scene of the proof; None without motion.
        verification: The proof; None without motion.
        Ts_world_object: Planned poses (k, 4, 4) if both hands hold the object.
    """

    phase: str
    trajectory: Trajectory
    openings: tuple[float, float]
    scene: PlanningScene | None = None
    verification: Verification | None = None
    Ts_world_object: Array | None = None

    @property
    def duration_s(self) -> float:
        """Execution time [s]."""
        return self.trajectory.duration_s


@dataclass(frozen=True)
class Thing:
    """The handled object: shape in its own frame, and obstacles it may touch when lifted or lowered."""

    shape: Shape
    rests_on: tuple[str, ...] = ("table",)


def still(phase: str, q: Array, duration_s: float, openings: tuple[float, float]) -> Segment:
    """Return a segment that holds the arms at q (n,)."""
    rest = np.zeros((2, len(q)))
    times = np.array([0.0, duration_s])
    return Segment(phase, Trajectory(times, np.array([q, q]), rest, rest.copy(), "both_arms"), openings)


def placed(shape: Shape, T: Array) -> Shape:
    """Return a shape transformed by T (4, 4)."""
    T_shape = T @ shape.T_parent_shape
    quat = pin.Quaternion(T_shape[:3, :3]).normalized()
    x, y, z = (float(v) for v in T_shape[:3, 3])
    return replace(shape, position_m=(x, y, z), quat_wxyz=(float(quat.w), float(quat.x), float(quat.y), float(quat.z)))


def scene_of(
    robot: Robot,
    around: PlanningScene,
    thing: Thing,
    state: State,
    *,
    touching: Iterable[str] = (),
    resting: bool = False,
) -> PlanningScene:
    """Return the planning scene: the object is an obstacle, or attached to its first holder.

    Hands of the arms `touching` may touch the object; `resting` lets it touch what it rests on.
    """
    name = thing.shape.name
    links = [link for arm in touching for link in robot.hand_links(arm)]
    if state.held_by:
        first = next(iter(state.held_by))
        shape = placed(thing.shape, inverse(state.held_by[first]))
        holding = [link for arm in state.held_by for link in robot.hand_links(arm)]
        scene = around.with_attached(Attached(shape, f"{first}_{robot.hand.tcp_link}", (*holding, *links)))
        for obstacle in thing.rests_on if resting else ():
            scene = scene.allowing(name, obstacle, "the object is lifted off it or put down on it")
        return scene
    scene = around.with_obstacles(placed(thing.shape, state.T_world_object))
    for link in links:
        scene = scene.allowing(name, link, "the hand is at the object to hold it or let it go")
    return scene


def moved(T: Array, shift_m: Array) -> Array:
    """Return the pose shifted by (3,) [m]."""
    T = np.array(T)
    T[:3, 3] += shift_m
    return T


def raised(T: Array, height_m: float) -> Array:
    """Return the pose raised by a height [m]."""
    return moved(T, np.array([0.0, 0.0, height_m]))
