"""Lever arms: how far each moving part reaches from each joint's axis in a posture, from MuJoCo's kinematics.

The farthest point of a geom is bounded by the distance of its bounding ball's centre from the axis plus the ball's
radius, so a lever is never too short.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from minidual.planning.links import joints_before
from minidual.robot.constants import ARMS, DOF_PER_ARM, JOINT_NAMES, Array


@dataclass(frozen=True, eq=False)
class _Arm:
    """Indices of one arm: rows of its parts, its joints, its geoms sorted by part, where each part's begin."""

    rows: Array
    joints: Array
    geoms: Array
    starts: Array
    radii: Array
    moves: Array


class LeverArms:
    """Computes the levers of one compiled scene.

    Args:
        model: Compiled scene.
        parts: Names of the moving bodies (links and attached objects), in the order of the rows.
        carriers: The link that carries each of them (itself for a link).
    """

    def __init__(self, model: mujoco.MjModel, parts: Sequence[str], carriers: Sequence[str]) -> None:
        self._parts_n = len(parts)
        self._arms: list[_Arm] = []
        for arm in ARMS:
            rows = [k for k, link in enumerate(carriers) if link.startswith(f"{arm}_")]
            geoms: list[int] = []
            starts: list[int] = []
            for k in rows:
                body = model.body(parts[k])
                starts.append(len(geoms))
                geoms += range(int(body.geomadr[0]), int(body.geomadr[0]) + int(body.geomnum[0]))
            joints = [model.joint(n).id for n in JOINT_NAMES if n.startswith(f"{arm}_")]
            counts = np.array([joints_before(carriers[k]) for k in rows])
            self._arms.append(
                _Arm(
                    np.array(rows), np.array(joints), np.array(geoms), np.array(starts),
                    model.geom_rbound[geoms].copy(), np.arange(DOF_PER_ARM) < counts[:, None],
                )
            )  # fmt: skip

    def of(self, geom_xpos: Array, xanchor: Array, xaxis: Array) -> Array:
        """Return the levers (n, m, 7) [m] of n postures; 0 where a joint does not move the part.

        Args:
            geom_xpos: (n, geoms, 3) centres of all geoms, world frame.
            xanchor: (n, joints, 3) points on the joints' axes.
            xaxis: (n, joints, 3) unit axes.
        """
        levers = np.zeros((len(geom_xpos), self._parts_n, DOF_PER_ARM))
        for arm in self._arms:
            axis = xaxis[:, arm.joints]
            off = geom_xpos[:, arm.geoms, None, :] - xanchor[:, None, arm.joints, :]
            along = np.einsum("ngjk,njk->ngj", off, axis)
            square = np.einsum("ngjk,ngjk->ngj", off, off) - along * along
            far = np.sqrt(np.maximum(square, 0.0)) + arm.radii[:, None]
            levers[:, arm.rows] = np.maximum.reduceat(far, arm.starts, axis=1) * arm.moves
        return levers
