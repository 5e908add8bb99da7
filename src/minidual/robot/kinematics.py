"""Kinematics and dynamics of both arms through Pinocchio, from the same URDF that MuJoCo simulates."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pinocchio as pin

from minidual.robot.constants import (
    DOF,
    FINGER_JOINT_NAMES,
    FINGER_TRAVEL_M,
    JOINT_ARMATURE,
    JOINT_NAMES,
    TCP_NAMES,
    Array,
)
from minidual.robot.description import dual_panda_urdf


@functools.cache
def _shared_model() -> Any:
    full = pin.buildModelFromXML(dual_panda_urdf())
    q_reference = pin.neutral(full)
    locked = []
    for name in FINGER_JOINT_NAMES:
        joint_id = full.getJointId(name)
        q_reference[full.joints[joint_id].idx_q] = FINGER_TRAVEL_M
        locked.append(joint_id)
    model = pin.buildReducedModel(full, locked, q_reference)
    names = tuple(model.names[i] for i in range(1, model.njoints))
    if names != JOINT_NAMES:
        raise RuntimeError(f"Pinocchio orders the joints {names}; the toolkit needs {JOINT_NAMES}")
    model.armature = np.full(DOF, JOINT_ARMATURE)
    return model


class Kinematics:
    """Forward kinematics, Jacobians and inverse dynamics of the 14 arm joints (fingers locked open).

    One instance holds one Pinocchio workspace: give each thread or process its own.
    """

    def __init__(self) -> None:
        self.model = _shared_model()
        self.data = self.model.createData()
        self.tcp_ids: tuple[int, int] = tuple(self.model.getFrameId(n) for n in TCP_NAMES)  # type: ignore[assignment]

    def tcp_poses(self, q: Array) -> tuple[Array, Array]:
        """Return (T_world_left_tcp, T_world_right_tcp), each (4, 4), for q (14,)."""
        pin.forwardKinematics(self.model, self.data, q)
        left, right = self.tcp_ids
        return (
            pin.updateFramePlacement(self.model, self.data, left).homogeneous,
            pin.updateFramePlacement(self.model, self.data, right).homogeneous,
        )

    def tcp_jacobians(self, q: Array) -> tuple[Array, Array]:
        """Return the two (6, 14) Jacobians of the tool centre points, [linear; angular], world-aligned."""
        pin.computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        left, right = self.tcp_ids
        frame = pin.LOCAL_WORLD_ALIGNED
        return (
            pin.getFrameJacobian(self.model, self.data, left, frame),
            pin.getFrameJacobian(self.model, self.data, right, frame),
        )

    def mass_matrix(self, q: Array) -> Array:
        """Return the (14, 14) joint-space inertia, rotor inertia included."""
        M = pin.crba(self.model, self.data, q)
        return np.triu(M) + np.triu(M, 1).T

    def bias(self, q: Array, v: Array) -> Array:
        """Return Coriolis, centrifugal and gravity torques (14,) [Nm]."""
        return pin.nonLinearEffects(self.model, self.data, q, v)

    def gravity(self, q: Array) -> Array:
        """Return the torques (14,) [Nm] that hold the arms still against gravity."""
        return pin.computeGeneralizedGravity(self.model, self.data, q)

    def rnea(self, q: Array, v: Array, a: Array) -> Array:
        """Return the torques (14,) [Nm] that give acceleration a (14,) [rad/s^2] (no joint friction)."""
        return pin.rnea(self.model, self.data, q, v, a)
