"""Proofs that no posture reaches hand poses: out of reach, or the hand itself inside something."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from minidual.collision.engines import CoalEngine
from minidual.collision.scene import PlanningScene
from minidual.robot.description import links_of
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array, inverse

_INSIDE_M = 1e-5
"""Penetration that counts as contact: far above coal's tolerance."""


def out_of_reach(targets: Mapping[str, Array], kinematics: Kinematics) -> str:
    """Return which hand is farther away than its arm is long, or "".

    The tcp fixes the origin of the last joint. The first joint's origin stands still. Between both
    lie the fixed distances from each joint to the next, so their sum bounds how far they can be
    apart.

    Args:
        targets: {arm: T_world_tcp (4, 4)}.
        kinematics: Of the arms.
    """
    model = kinematics.model
    dof_per_arm = kinematics.robot.dof_per_arm
    for arm, T_world_tcp in targets.items():
        first = 1 + dof_per_arm * SIDES.index(arm)
        shoulder = model.jointPlacements[first].translation
        T_last_tcp = model.frames[kinematics.tcp_ids[SIDES.index(arm)]].placement
        T_world_last = T_world_tcp @ T_last_tcp.inverse().homogeneous
        distance_m = float(np.linalg.norm(T_world_last[:3, 3] - shoulder))
        length_m = sum(
            float(np.linalg.norm(model.jointPlacements[first + k].translation))
            for k in range(1, dof_per_arm)
        )
        if distance_m > length_m:
            return (
                f"the {arm} hand's last joint is {distance_m:.3f} m from the shoulder; "
                f"the arm bridges {length_m:.3f} m"
            )
    return ""


class RigidHands:
    """The parts that move with the tcps whatever the arms do: last links, hands, what they hold."""

    def __init__(self, scene: PlanningScene) -> None:
        robot = scene.robot
        q = robot.home
        engine = CoalEngine(scene)
        geometry = engine.geometry
        placements = pin.GeometryData(geometry)
        pin.updateGeometryPlacements(
            engine.model,
            engine.model.createData(),
            geometry,
            placements,
            q,
        )
        self._items = engine.items
        self._solids = [item.geometry for item in geometry.geometryObjects]
        self._Ts_world_solid = [placement.homogeneous for placement in placements.oMg]
        tips = Kinematics(robot).tcp_poses(q)
        self._T_tcp_world = {arm: inverse(T) for arm, T in zip(SIDES, tips, strict=True)}
        self._arm_of = _arms_of_parts(scene)
        still = {shape.name for shape in scene.obstacles}
        relevant = self._arm_of.keys() | still
        self._pairs = [(a, b) for a, b in scene.checked_pairs if a in relevant and b in relevant]

    def inside(self, targets: Mapping[str, Array]) -> str:
        """Return which two parts are inside each other with the hands at T_world_tcp, or ""."""
        for first, second in self._pairs:
            for first_solid, T_first in self._placed(first, targets):
                for second_solid, T_second in self._placed(second, targets):
                    depth_m = -coal.distance(
                        first_solid,
                        T_first,
                        second_solid,
                        T_second,
                        coal.DistanceRequest(),
                        coal.DistanceResult(),
                    )
                    if depth_m > _INSIDE_M:
                        return f"{first} is {depth_m * 1e3:.1f} mm inside {second}"
        return ""

    def _placed(self, part: str, targets: Mapping[str, Array]) -> Iterator[tuple[Any, Any]]:
        """Yield coal's solids of a part and their placements."""
        for index in self._items[part]:
            T_world_solid = self._Ts_world_solid[index]
            if part in self._arm_of:
                arm = self._arm_of[part]
                T_world_solid = targets[arm] @ self._T_tcp_world[arm] @ T_world_solid
            placement = coal.Transform3s(T_world_solid[:3, :3], T_world_solid[:3, 3])
            yield self._solids[index], placement


def _arms_of_parts(scene: PlanningScene) -> dict[str, str]:
    """Return {part: arm} of the links behind the last joint and of what they hold."""
    arms = {
        name: link.side
        for name, link in links_of(scene.robot).items()
        if link.joints_before == scene.robot.dof_per_arm
    }
    held = {held.name: arms[held.link] for held in scene.attached if held.link in arms}
    return arms | held
