"""Kinematics and dynamics through Pinocchio."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pinocchio as pin
from pinocchio import computeJointJacobians, forwardKinematics, getFrameClassicalAcceleration, getFrameJacobian

from minidual.robot.arms import DUAL_PANDA
from minidual.robot.description import pair_urdf
from minidual.robot.pair import Array, Robot

_WORLD_ALIGNED = pin.LOCAL_WORLD_ALIGNED


def full_model(robot: Robot) -> tuple[Any, list[int], Array]:
    """Return Pinocchio's model with fingers, their joints, and a configuration with open hands."""
    full = pin.buildModelFromXML(pair_urdf(robot))
    fingers = [full.getJointId(name) for name in robot.finger_joint_names]
    q = pin.neutral(full)
    for joint in fingers:
        q[full.joints[joint].idx_q] = robot.hand.travel_m
    return full, fingers, q


@functools.cache
def _shared_model(robot: Robot) -> Any:
    model = pin.buildReducedModel(*full_model(robot))
    names = tuple(model.names)[1:]
    if names != robot.joint_names:
        raise RuntimeError(f"Pinocchio orders the joints {names}; the toolkit needs {robot.joint_names}")
    model.armature = np.full(robot.dof, robot.arm.armature)
    return model


class Kinematics:
    """Of all arm joints, fingers locked open.

    Instances own a workspace: one per thread.
    """

    def __init__(self, robot: Robot = DUAL_PANDA) -> None:
        self.robot = robot
        self.model = _shared_model(robot)
        self.data = self.model.createData()
        self.tcp_ids: tuple[int, int] = tuple(self.model.getFrameId(n) for n in robot.tcp_names)  # type: ignore[assignment]

    def tcp_poses(self, q: Array) -> tuple[Array, Array]:
        """Return left and right T_world_tcp for q."""
        pin.forwardKinematics(self.model, self.data, q)
        left, right = (pin.updateFramePlacement(self.model, self.data, i).homogeneous for i in self.tcp_ids)
        return left, right

    def tcp_jacobians(self, q: Array) -> tuple[Array, Array]:
        """Return Jacobians (6, n), [linear; angular], world-aligned."""
        pin.computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        left, right = (getFrameJacobian(self.model, self.data, i, _WORLD_ALIGNED) for i in self.tcp_ids)
        return left, right

    def mass_matrix(self, q: Array) -> Array:
        """Return inertia (n, n), including rotors."""
        M = pin.crba(self.model, self.data, q)
        return np.triu(M) + np.triu(M, 1).T

    def bias(self, q: Array, v: Array) -> Array:
        """Return Coriolis, centrifugal and gravity torques [Nm]."""
        return pin.nonLinearEffects(self.model, self.data, q, v)

    def gravity(self, q: Array) -> Array:
        """Return gravity torques [Nm]."""
        return pin.computeGeneralizedGravity(self.model, self.data, q)

    def rnea(self, q: Array, v: Array, a: Array) -> Array:
        """Return inverse-dynamics torques [Nm], frictionless."""
        return pin.rnea(self.model, self.data, q, v, a)

    @functools.cached_property
    def _pool(self) -> Any:
        return pin.ModelPool(self.model, 1)

    def torques(self, q: Array, v: Array, a: Array) -> Array:
        """Return `rnea` for rows of states."""
        columns = [np.asfortranarray(np.asarray(x, dtype=float).T) for x in (q, v, a)]
        tau = np.empty_like(columns[0], order="F")
        pin.rneaInParallel(1, self._pool, *columns, tau)
        return tau.T


class HandMotion:
    """Motion of both hands, updated in place: copy what you keep.

    Attributes:
        p: Left and right tcp positions (3,) [m].
        R: Orientations (3, 3) in the world.
        J: (12, n), [linear; angular] left then right, world-aligned.
        acceleration: (12,), J a + Jdot v.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        self._model, self._data = kinematics.model, kinematics.data
        self._left, self._right = kinematics.tcp_ids
        frames = [self._data.oMf[i] for i in kinematics.tcp_ids]
        # Views of Pinocchio's own memory, so reading them costs nothing.
        self.p: tuple[Array, Array] = tuple(frame.translation for frame in frames)  # type: ignore[assignment]
        self.R: tuple[Array, Array] = tuple(frame.rotation for frame in frames)  # type: ignore[assignment]
        self.J = np.zeros((12, kinematics.robot.dof))
        self.acceleration = np.zeros(12)
        self._J_left, self._J_right = self.J[:6], self.J[6:]
        self._a_left, self._a_right = self.acceleration[:6], self.acceleration[6:]

    def update(self, q: Array, v: Array, a: Array) -> None:
        """Update all arrays."""
        model, data, left, right, frame = self._model, self._data, self._left, self._right, _WORLD_ALIGNED
        forwardKinematics(model, data, q, v, a)
        computeJointJacobians(model, data)
        self._J_left[:] = getFrameJacobian(model, data, left, frame)  # also updates the frame's placement
        self._J_right[:] = getFrameJacobian(model, data, right, frame)
        # Classical: the second derivative of the point's position, not the spatial acceleration.
        self._a_left[:] = getFrameClassicalAcceleration(model, data, left, frame).vector
        self._a_right[:] = getFrameClassicalAcceleration(model, data, right, frame).vector
