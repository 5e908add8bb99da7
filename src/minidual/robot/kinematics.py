"""Kinematics and dynamics through Pinocchio."""

import functools
from typing import Any

import numpy as np
import pinocchio as pin
from pinocchio import computeJointJacobians, getFrameJacobian, updateFramePlacement

from minidual.robot.description import pair_urdf
from minidual.robot.pair import DUAL_PANDA, Array, Robot
from minidual.robot.trajectory import largest

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


@functools.cache
def hinges(robot: Robot) -> tuple[tuple[pin.SE3, ...], tuple[pin.SE3, ...]]:
    """Return placements (n,) of joint frames whose z is the hinge, and maps (n + 1,) of the model's frames into these.

    Raises:
        ValueError: The arms are no chains of hinges that end at their tcps.
    """
    model, n = _shared_model(robot), robot.dof_per_arm
    ends = [model.frames[model.getFrameId(name)].parentJoint for name in robot.tcp_names]
    if [*model.parents][1:] != [0, *range(1, n), 0, *range(n + 1, 2 * n)] or ends != [n, 2 * n]:
        raise ValueError(f"{robot.arm.name}: joints on {[*model.parents][1:]}, tcps on {ends}; chains are needed")
    turned, placements = [pin.SE3.Identity()], []
    for k in range(1, robot.dof + 1):
        data = model.joints[k].createData()
        model.joints[k].calc(data, np.ones(model.nq))
        axis = pin.log3(data.M.rotation)  # at one radian
        if abs(float(np.linalg.norm(axis)) - 1.0) > 1e-9 or np.any(data.M.translation):
            raise ValueError(f"{model.names[k]} is a {model.joints[k].shortname()}; arms need hinges")
        to_axis = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).matrix()
        turned.append(pin.SE3(to_axis, np.zeros(3)))
        placements.append(turned[model.parents[k]].inverse() * model.jointPlacements[k] * turned[k])
    return tuple(placements), tuple(turn.inverse() for turn in turned)


class Kinematics:
    """Of all arm joints, fingers locked open.

    Instances own a workspace: one per thread.
    """

    def __init__(self, robot: Robot = DUAL_PANDA) -> None:
        self.robot = robot
        self.model = _shared_model(robot)
        self.data = self.model.createData()
        self.tcp_ids: tuple[int, int] = tuple(self.model.getFrameId(n) for n in robot.tcp_names)  # type: ignore[assignment]
        self.placed = b""
        """Joints, as bytes, of the hands and Jacobians in `data`; empty if unknown."""

    def tcp_poses(self, q: Array) -> tuple[Array, Array]:
        """Return left and right T_world_tcp for q."""
        self.placed = b""
        pin.forwardKinematics(self.model, self.data, q)
        left, right = (updateFramePlacement(self.model, self.data, i).homogeneous for i in self.tcp_ids)
        return left, right

    def tcp_jacobians(self, q: Array) -> tuple[Array, Array]:
        """Return Jacobians (6, n), [linear; angular], world-aligned."""
        self.placed = b""
        computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        left, right = (getFrameJacobian(self.model, self.data, i, _WORLD_ALIGNED) for i in self.tcp_ids)
        return left, right

    def mass_matrix(self, q: Array) -> Array:
        """Return inertia (n, n), including rotors."""
        self.placed = b""
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

    def torque_use(self, q: Array, v: Array, a: Array, every: int) -> Array:
        """Return each joint's largest |torque| / limit (n,) over every `every`-th row of states and the last."""
        rows = np.append(np.arange(0, len(q), every), len(q) - 1)
        return largest(self.torques(q[rows], v[rows], a[rows])) / self.robot.tau_max


class Hands:
    """Placement of both hands, in Pinocchio's own memory: reading costs nothing, copy what you keep.

    Attributes:
        p, R: Left and right tcp positions (3,) [m] and orientations (3, 3).
        J: (6, n), [linear; angular], of the moving bodies' points at the world's origin.
        views: J, both positions, both orientations: one argument of kernels.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        self._kinematics, self._data = kinematics, kinematics.data
        left, right = (self._data.oMf[i] for i in kinematics.tcp_ids)
        self.p: tuple[Array, Array] = (left.translation, right.translation)
        self.R: tuple[Array, Array] = (left.rotation, right.rotation)
        self.J: Array = self._data.J
        self.views = (self.J, *self.p, *self.R)

    def update(self, q: Array) -> None:
        """Update all arrays, unless they are of these joints: estimate and law ask in the same step."""
        kinematics, data, placed = self._kinematics, self._data, q.tobytes()
        if kinematics.placed == placed:
            return
        computeJointJacobians(kinematics.model, data, q)
        for frame in kinematics.tcp_ids:
            updateFramePlacement(kinematics.model, data, frame)
        kinematics.placed = placed
