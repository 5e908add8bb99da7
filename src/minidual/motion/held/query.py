"""A query for a held object, and its scene."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import NamedTuple

import pinocchio as pin

from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Attached, Shape
from minidual.robot.pair import SIDES, Array, inverse


class HeldQuery(NamedTuple):
    """A query for a held object.

    Attributes:
        q_start: All joints (n,), hands at their grasps.
        T_world_goal: Object pose (4, 4).
        grasps: Left and right T_object_tcp (4, 4).
        scene: From `scene_holding`.
    """

    q_start: Array
    T_world_goal: Array
    grasps: tuple[Array, Array]
    scene: PlanningScene
    seed: int = 0


def placed(shape: Shape, T: Array) -> Shape:
    """Return a shape transformed by T (4, 4)."""
    T_shape = T @ shape.T_parent_shape
    x, y, z, w = pin.Quaternion(T_shape[:3, :3]).normalized().coeffs().tolist()
    return replace(shape, position_m=tuple(T_shape[:3, 3].tolist()), quat_wxyz=(w, x, y, z))


def scene_holding(
    scene: PlanningScene,
    shape: Shape,
    grasps: Mapping[str, Array],
    *,
    rests_on: Iterable[str] = ("table",),
    touching: Iterable[str] = (),
) -> PlanningScene:
    """Return the scene with a shape attached to the first hand of `grasps`.

    Args:
        scene: The rest of it.
        shape: The object, placed in its own frame.
        grasps: {arm: T_object_tcp (4, 4)}; the object may touch these hands.
        rests_on: Obstacles that it may touch.
        touching: Further arms whose hands it may touch.
    """
    robot = scene.robot
    holder = next(iter(grasps))
    hands = tuple(link for arm in (*grasps, *touching) for link in robot.hand_links(arm))
    tcp = robot.tcp_names[SIDES.index(holder)]
    scene = scene.with_attached(Attached(placed(shape, inverse(grasps[holder])), tcp, hands))
    for obstacle in rests_on:
        scene = scene.allowing(
            shape.name,
            obstacle,
            "the object is lifted off it or put down on it",
        )
    return scene
