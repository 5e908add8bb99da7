"""Kinematics and dynamics of both arms, through Pinocchio."""

import functools
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pinocchio import computeJointJacobians, getFrameJacobian, updateFramePlacement

from minidual.robot.description import pair_urdf
from minidual.robot.pair import DUAL_PANDA, SIDES, Array, Robot

_RATE_SPAN_S = 0.008
"""Time over which the rate of a torque is averaged."""


def largest(x: Array) -> Array:
    """Return the largest |x| per column. NaN propagates."""
    return np.abs(np.ascontiguousarray(x.T)).max(axis=1)


def path_length(path: NDArray[np.floating]) -> Any:
    """Return the lengths (...) of polylines (n, ..., d)."""
    return np.linalg.norm(np.diff(path, axis=0), axis=-1).sum(axis=0)


class FullModel(NamedTuple):
    """Pinocchio's model with fingers.

    Attributes:
        model: A `pin.Model`.
        fingers: Ids of the finger joints.
        q: A configuration with open hands.
    """

    model: Any
    fingers: list[int]
    q: Array


def full_model(robot: Robot) -> FullModel:
    """Return Pinocchio's model with fingers."""
    model = pin.buildModelFromXML(pair_urdf(robot))
    fingers = [model.getJointId(name) for name in robot.finger_joint_names]
    q = pin.neutral(model)
    for joint in fingers:
        q[model.joints[joint].idx_q] = robot.hand.travel_m
    return FullModel(model, fingers, q)


@functools.cache
def _shared_model(robot: Robot) -> Any:
    """Return Pinocchio's model of the arms, fingers locked open."""
    full = full_model(robot)
    model = pin.buildReducedModel(full.model, full.fingers, full.q)
    names = tuple(model.names)[1:]
    if names != robot.joint_names:
        raise RuntimeError(
            f"Pinocchio orders the joints {names}; the toolkit needs {robot.joint_names}",
        )
    model.armature = robot.per_joint([arm.armature for arm in robot.arms])
    return model


def link_frame(model: Any, link: str) -> int:
    """Return the number of a link's frame; a joint of a URDF may have the same name."""
    return model.getFrameId(link, pin.FrameType.BODY)


class Hinges(NamedTuple):
    """Joint frames whose z axis is the hinge.

    Attributes:
        placements: (n,), each in the frame before it.
        turns: (n + 1,), from the model's joint frames to these.
    """

    placements: tuple[pin.SE3, ...]
    turns: tuple[pin.SE3, ...]


@functools.cache
def hinges(robot: Robot) -> Hinges:
    """Return the hinges of both arms.

    Raises:
        ValueError: The arms are no chains of hinges that end at their tool centre points.
    """
    model = _shared_model(robot)
    left_n = robot.dofs[0]
    n = robot.dof
    parents = list(model.parents)[1:]
    chains = [0, *range(1, left_n), 0, *range(left_n + 1, n)]
    tcp_joints = [model.frames[link_frame(model, name)].parentJoint for name in robot.tcp_names]
    if parents != chains or tcp_joints != [left_n, n]:
        raise ValueError(
            f"{robot.name}: joints on {parents}, tcps on {tcp_joints}; chains are needed",
        )
    turned = [pin.SE3.Identity()]
    placements = []
    for k in range(1, robot.dof + 1):
        turned.append(_hinge_frame(model, k))
        before = turned[model.parents[k]].inverse()
        placements.append(before * model.jointPlacements[k] * turned[k])
    return Hinges(tuple(placements), tuple(turn.inverse() for turn in turned))


def _hinge_frame(model: Any, joint: int) -> pin.SE3:
    """Return the frame whose z axis is a joint's hinge, in the joint's frame."""
    data = model.joints[joint].createData()
    model.joints[joint].calc(data, np.ones(model.nq))
    axis = pin.log3(data.M.rotation)  # at one radian
    is_unit = abs(float(np.linalg.norm(axis)) - 1.0) <= 1e-9
    if not is_unit or np.any(data.M.translation):
        kind = model.joints[joint].shortname()
        raise ValueError(f"{model.names[joint]} is a {kind}; arms need hinges")
    z_axis = np.array([0.0, 0.0, 1.0])
    rotation = pin.Quaternion.FromTwoVectors(z_axis, axis).matrix()
    return pin.SE3(rotation, np.zeros(3))


class TorqueUse(NamedTuple):
    """Largest use of the motors by a motion, in shares of their limits.

    Attributes:
        torque: (n,), of |torque|.
        rate: (n,), of the torque's mean rate over 8 ms.
    """

    torque: Array
    rate: Array


class Kinematics:
    """Kinematics and dynamics of all arm joints, fingers locked open.

    Instances own a workspace: one per thread.

    Attributes:
        model: Pinocchio's model.
        data: Pinocchio's workspace.
        tcp_ids: Frames of the left and right tool centre point.
        placed: Joints, as bytes, of the hands and Jacobians in `data`; empty if unknown.
    """

    def __init__(self, robot: Robot = DUAL_PANDA) -> None:
        self.robot = robot
        self.model = _shared_model(robot)
        self.data = self.model.createData()
        left, right = robot.tcp_names
        self.tcp_ids: tuple[int, int] = (
            link_frame(self.model, left),
            link_frame(self.model, right),
        )
        self.placed = b""

    def tcp_poses(self, q: Array) -> tuple[Array, Array]:
        """Return the left and right T_world_tcp (4, 4) at q (n,)."""
        self.placed = b""
        pin.forwardKinematics(self.model, self.data, q)
        left, right = self.tcp_ids
        return (
            updateFramePlacement(self.model, self.data, left).homogeneous,
            updateFramePlacement(self.model, self.data, right).homogeneous,
        )

    def tcp_jacobians(self, q: Array) -> tuple[Array, Array]:
        """Return the left and right Jacobian (6, n), [linear; angular], world-aligned."""
        self.placed = b""
        computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        axes = pin.LOCAL_WORLD_ALIGNED
        left, right = self.tcp_ids
        return (
            getFrameJacobian(self.model, self.data, left, axes),
            getFrameJacobian(self.model, self.data, right, axes),
        )

    def mass_matrix(self, q: Array) -> Array:
        """Return the inertia (n, n) at q (n,), including rotors."""
        self.placed = b""
        M = pin.crba(self.model, self.data, q)
        return np.triu(M) + np.triu(M, 1).T

    def bias(self, q: Array, v: Array) -> Array:
        """Return Coriolis, centrifugal and gravity torques (n,) [Nm]."""
        return pin.nonLinearEffects(self.model, self.data, q, v)

    def gravity(self, q: Array) -> Array:
        """Return gravity torques (n,) [Nm]."""
        return pin.computeGeneralizedGravity(self.model, self.data, q)

    def rnea(self, q: Array, v: Array, a: Array) -> Array:
        """Return inverse-dynamics torques (n,) [Nm], frictionless."""
        return pin.rnea(self.model, self.data, q, v, a)

    @functools.cached_property
    def _single_arms(self) -> list[tuple[slice, Any]]:
        """Joints of each arm, and a pool of its own model with the other arm locked."""
        joints = range(self.robot.dof)
        pools = []
        for side in SIDES:
            arm = self.robot.groups[f"{side}_arm"]
            others = [1 + j for j in joints if j not in joints[arm]]
            alone = pin.buildReducedModel(self.model, others, self.robot.home)
            pools.append((arm, pin.ModelPool(alone, 1)))
        return pools

    def torques(self, q: Array, v: Array, a: Array) -> Array:
        """Return `rnea` for rows (m, n); for an arm that stands still, of one row."""
        tau = np.empty(q.shape)
        for arm, pool in self._single_arms:
            moves = v[:, arm].any() or a[:, arm].any() or (q[:, arm] != q[0, arm]).any()
            rows = slice(None) if moves else slice(1)
            q_columns = _columns(q[rows, arm])
            torques = np.empty_like(q_columns)
            pin.rneaInParallel(
                1,
                pool,
                q_columns,
                _columns(v[rows, arm]),
                _columns(a[rows, arm]),
                torques,
            )
            tau[:, arm] = torques.T
        return tau

    def torque_use(self, q: Array, v: Array, a: Array, dt_s: float, every: int) -> TorqueUse:
        """Return the use of the motors over every `every`-th row of (m, n), and the last row.

        Rates are averaged over 8 ms, because the supervisor spreads a rate that is too large for
        1 ms only.
        """
        rows = np.append(np.arange(0, len(q) - 1, every), len(q) - 1)
        tau = self.torques(q[rows], v[rows], a[rows])
        span = max(1, min(round(_RATE_SPAN_S / dt_s) // every, len(rows) - 1))
        spans_s = dt_s * (rows[span:] - rows[:-span])
        rates = (tau[span:] - tau[:-span]) / spans_s[:, None]
        return TorqueUse(
            largest(tau) / self.robot.tau_max,
            largest(rates) / self.robot.tau_rate_max,
        )


def _columns(rows: Array) -> Array:
    """Return rows (m, n) as columns (n, m) in Fortran order, as Pinocchio's pools need them."""
    return np.array(rows.T, dtype=float, order="F")


class Hands:
    """Placement of both hands, in Pinocchio's own memory: reading costs nothing, copy to keep.

    Attributes:
        p: Left and right tcp position (3,) [m].
        R: Left and right tcp orientation (3, 3).
        J: (6, n), [linear; angular], of the moving bodies' points at the world's origin.
        views: J, both positions, both orientations, joints of the left arm: one argument of kernels.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        self._kinematics = kinematics
        self._data = kinematics.data
        left, right = (self._data.oMf[frame] for frame in kinematics.tcp_ids)
        self.p: tuple[Array, Array] = (left.translation, right.translation)
        self.R: tuple[Array, Array] = (left.rotation, right.rotation)
        self.J: Array = self._data.J
        self.views = (self.J, *self.p, *self.R, kinematics.robot.dofs[0])

    def update(self, q: Array) -> None:
        """Update all arrays, unless they are of q (n,): estimate and law ask in the same step."""
        kinematics = self._kinematics
        placed = q.tobytes()
        if kinematics.placed == placed:
            return
        model = kinematics.model
        data = self._data
        left, right = kinematics.tcp_ids
        computeJointJacobians(model, data, q)
        updateFramePlacement(model, data, left)
        updateFramePlacement(model, data, right)
        kinematics.placed = placed

    def place(self, q: Array) -> None:
        """Update positions and orientations alone."""
        kinematics = self._kinematics
        kinematics.placed = b""
        pin.forwardKinematics(kinematics.model, self._data, q)
        for frame in kinematics.tcp_ids:
            updateFramePlacement(kinematics.model, self._data, frame)

    def rise(self, arm: int) -> Array:
        """Return how far a hand rises with each joint of its arm (m,) [m/rad]."""
        J = self.J[:, self._kinematics.robot.joints_of(arm)]
        x, y, _ = self.p[arm]
        return J[2] + y * J[3] - x * J[4]
