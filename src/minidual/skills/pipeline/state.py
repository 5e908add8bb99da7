"""What stages hand to each other: the state of arms, hands and object, and the motion between two of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from minidual.collision.scene import Attached, PlanningScene
from minidual.collision.shapes import Shape
from minidual.proof.verify import Verification
from minidual.robot.constants import ARMS, Array
from minidual.robot.poses import inverse
from minidual.robot.trajectory import Trajectory

OPEN, CLOSED = 1.0, 0.0


@dataclass(frozen=True, eq=False)
class State:
    """An interface state.

    Attributes:
        q: All 14 joints [rad].
        T_world_object: Pose (4, 4) of the object.
        held_by: {arm: T_object_tcp (4, 4)} of the hands that hold it.
        openings: Opening of each hand (left, right), 0 closed to 1 open.
        T_world_place: Where it shall be put down, once that is chosen.
    """

    q: Array
    T_world_object: Array
    held_by: Mapping[str, Array] = field(default_factory=dict)
    openings: tuple[float, float] = (OPEN, OPEN)
    T_world_place: Array | None = None

    def opened(self, arms: tuple[str, ...], opening: float) -> State:
        """Return the state with these hands at an opening."""
        left, right = (opening if arm in arms else now for arm, now in zip(ARMS, self.openings, strict=True))
        return replace(self, openings=(left, right))


@dataclass(frozen=True, eq=False)
class Segment:
    """What is driven between two states.

    Attributes:
        stage: Name of the stage that it belongs to.
        trajectory: Timed motion; None holds the arms still while the hands move.
        hold_s: How long to hold still.
        openings: Opening command of each hand meanwhile.
        scene: Scene in which the motion was proven.
        verification: The proof of the motion; None where nothing moves.
        Ts_world_object: Planned poses (n, 4, 4) of a carried object at the samples.
    """

    stage: str
    trajectory: Trajectory | None
    openings: tuple[float, float]
    hold_s: float = 0.0
    scene: PlanningScene | None = None
    verification: Verification | None = None
    Ts_world_object: Array | None = None

    @property
    def duration_s(self) -> float:
        """Time that it takes [s]."""
        return self.hold_s if self.trajectory is None else self.trajectory.duration_s


@dataclass(frozen=True)
class TaskObject:
    """What is handled.

    Attributes:
        shape: In the object's own frame; its name is the object's.
        rests_on: Obstacles that it may touch while it is lifted off or put down.
    """

    shape: Shape
    rests_on: tuple[str, ...] = ("table",)

    @property
    def name(self) -> str:
        """Name in the planning scene."""
        return self.shape.name


def hand_links(arms: tuple[str, ...] | Mapping[str, object]) -> tuple[str, ...]:
    """Return the links with which hands touch what they hold."""
    return tuple(f"{arm}_panda_{part}" for arm in arms for part in ("hand", "leftfinger", "rightfinger"))


def placed(shape: Shape, T: Array) -> Shape:
    """Return a shape given in some frame, put into the frame in which that frame has the pose T (4, 4)."""
    T_shape = T @ shape.T_parent_shape
    quat = pin.Quaternion(T_shape[:3, :3]).normalized()
    x, y, z = (float(v) for v in T_shape[:3, 3])
    return replace(shape, position_m=(x, y, z), quat_wxyz=(float(quat.w), float(quat.x), float(quat.y), float(quat.z)))


def scene_of(
    around: PlanningScene, thing: TaskObject, state: State, *, touching: tuple[str, ...] = (), resting: bool = False
) -> PlanningScene:
    """Return the planning scene of a state.

    Args:
        around: What stands there beside the object.
        thing: The object: an obstacle where it lies, or attached to the first hand that holds it.
        state: Says which.
        touching: Arms whose hands may touch the object (they are about to hold it, or just let go).
        resting: Whether the object may touch what it rests on.
    """
    name = thing.name
    if state.held_by:
        first = next(iter(state.held_by))
        shape = placed(thing.shape, inverse(np.asarray(state.held_by[first])))
        scene = around.with_attached(
            Attached(shape, f"{first}_panda_hand_tcp", hand_links((*state.held_by, *touching)))
        )
        for obstacle in thing.rests_on if resting else ():
            scene = scene.allowing(name, obstacle, "the object is lifted off it or put down on it")
        return scene
    scene = around.with_obstacles(placed(thing.shape, state.T_world_object))
    for link in hand_links(touching):
        scene = scene.allowing(name, link, "the hand is at the object to hold it or let it go")
    return scene


def raised(T: Array, height_m: float) -> Array:
    """Return the pose moved up by a height [m]."""
    T = np.array(T)
    T[2, 3] += height_m
    return T
