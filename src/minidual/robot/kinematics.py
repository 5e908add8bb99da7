"""Timed joint trajectories; kinematics and dynamics through Pinocchio."""

import functools
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pinocchio import computeJointJacobians, getFrameJacobian, updateFramePlacement

from minidual.durable import replacing, write_text
from minidual.errors import DataError, UsageError
from minidual.robot.description import pair_urdf
from minidual.robot.pair import DUAL_PANDA, SIDES, Array, Robot


def largest(x: Array) -> Array:
    """Return the largest |x| per column. NaN propagates."""
    return np.abs(np.ascontiguousarray(x.T)).max(axis=1)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Samples at regular times.

    Attributes:
        times: (n,) [s], from 0; n >= 2.
        q: (n, dof) [rad].
        v: [rad/s].
        a: [rad/s^2].
    """

    times: Array
    q: Array
    v: Array
    a: Array
    group: str

    def __post_init__(self) -> None:
        n = len(self.times)
        if (
            n < 2
            or self.q.ndim != 2
            or any(x.shape != (n, self.q.shape[1]) for x in (self.q, self.v, self.a))
        ):
            got = f"got {self.times.shape}, {self.q.shape}, {self.v.shape}, {self.a.shape}"
            raise UsageError(
                f"a trajectory needs n >= 2 times and q, v, a of one shape (n, joints); {got}",
            )
        if not all(np.isfinite(x).all() for x in (self.times, self.q, self.v, self.a)):
            raise DataError("a trajectory holds a value that is not finite")
        even = np.arange(n) * self.times[1]
        if self.times[0] != 0.0 or self.times[1] <= 0.0 or np.abs(self.times - even).max() > 1e-9:
            raise UsageError("the times of a trajectory must start at 0 and grow in equal steps")

    @property
    def duration_s(self) -> float:
        """Last time [s]."""
        return float(self.times[-1])

    @property
    def dt_s(self) -> float:
        """Time step."""
        return float(self.times[1] - self.times[0])

    def sample(self, t: float) -> tuple[Array, Array, Array]:
        """Return q, v, a (dof,) at t, clamped to the ends."""
        q, v, a = self.sample_many(np.array([t]))
        return q[0], v[0], a[0]

    def sample_many(self, times: Array) -> tuple[Array, Array, Array]:
        """Return q, v, a (m, dof) at times (m,).

        q is a cubic Hermite interpolant, v its derivative; a is linear.
        """
        t = np.clip(np.asarray(times, dtype=float), 0.0, self.duration_s)
        h = self.dt_s
        i = np.minimum((t / h).astype(int), len(self.times) - 2)
        x = ((t - self.times[i]) / h)[:, None]
        q0 = self.q[i]
        q1 = self.q[i + 1]
        v0 = self.v[i] * h
        v1 = self.v[i + 1] * h
        shares = 2 * x**3 - 3 * x**2 + 1, x**3 - 2 * x**2 + x, 3 * x**2 - 2 * x**3, x**3 - x**2
        q = q0 * shares[0] + v0 * shares[1] + q1 * shares[2] + v1 * shares[3]
        v = (
            (q0 - q1) * (6 * x**2 - 6 * x) + v0 * (3 * x**2 - 4 * x + 1) + v1 * (3 * x**2 - 2 * x)
        ) / h
        a = self.a[i] * (1 - x) + self.a[i + 1] * x
        return q, v, a

    def variation_rates(self) -> Array:
        """Return bounds on the speed within each step (n - 1, dof) [rad/s], from Bezier coefficients."""
        h = self.dt_s
        middle = 3.0 * np.diff(self.q, axis=0) / h - self.v[:-1] - self.v[1:]
        return np.abs([self.v[:-1], self.v[1:], middle]).max(axis=0)

    def digest(self) -> str:
        """Return a sha256 of all samples."""
        h = hashlib.sha256(self.group.encode())
        for x in (self.times, self.q, self.v, self.a):
            h.update(np.ascontiguousarray(x).tobytes())
        return h.hexdigest()

    def write_json(self, path: Path, joint_names: Sequence[str], every: int = 1) -> None:
        """Write every `every`-th sample and the last, atomically."""
        rows = np.unique(np.append(np.arange(0, len(self.times), every), len(self.times) - 1))
        columns = {
            "times_s": self.times,
            "q_rad": self.q,
            "v_rad_per_s": self.v,
            "a_rad_per_s2": self.a,
        }
        content: dict[str, Any] = {"group": self.group, "joint_names": list(joint_names)}
        content |= {name: x[rows].round(9).tolist() for name, x in columns.items()}
        write_text(path, json.dumps(content))

    def write_csv(self, path: Path, joint_names: Sequence[str]) -> None:
        """Write time, q, v, a atomically."""
        header = [
            f"{name}_{unit}" for unit in ("rad", "rad_per_s", "rad_per_s2") for name in joint_names
        ]
        table = np.column_stack([self.times, self.q, self.v, self.a])
        header = ",".join(["time_s", *header])
        with replacing(path) as partial:  # cut off, it would be a shorter trajectory
            np.savetxt(partial, table, "%.9g", ",", "\r\n", header, comments="", encoding="utf-8")


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
        raise RuntimeError(
            f"Pinocchio orders the joints {names}; the toolkit needs {robot.joint_names}",
        )
    model.armature = np.full(robot.dof, robot.arm.armature)
    return model


@functools.cache
def hinges(robot: Robot) -> tuple[tuple[pin.SE3, ...], tuple[pin.SE3, ...]]:
    """Return placements (n,) of joint frames whose z is the hinge, and maps (n + 1,) of the model's frames into these.

    Raises:
        ValueError: The arms are no chains of hinges that end at their tcps.
    """
    model = _shared_model(robot)
    n = robot.dof_per_arm
    ends = [model.frames[model.getFrameId(name)].parentJoint for name in robot.tcp_names]
    if [*model.parents][1:] != [0, *range(1, n), 0, *range(n + 1, 2 * n)] or ends != [n, 2 * n]:
        raise ValueError(
            f"{robot.arm.name}: joints on {[*model.parents][1:]}, tcps on {ends}; chains are needed",
        )
    turned = [pin.SE3.Identity()]
    placements = []
    for k in range(1, robot.dof + 1):
        data = model.joints[k].createData()
        model.joints[k].calc(data, np.ones(model.nq))
        axis = pin.log3(data.M.rotation)  # at one radian
        if abs(float(np.linalg.norm(axis)) - 1.0) > 1e-9 or np.any(data.M.translation):
            raise ValueError(
                f"{model.names[k]} is a {model.joints[k].shortname()}; arms need hinges",
            )
        turned.append(
            pin.SE3(
                pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).matrix(),
                np.zeros(3),
            ),
        )
        placements.append(turned[model.parents[k]].inverse() * model.jointPlacements[k] * turned[k])
    return tuple(placements), tuple(turn.inverse() for turn in turned)


def path_length(path: NDArray[np.floating]) -> Any:
    """Return the lengths (...) of polylines (n, ..., d)."""
    return np.linalg.norm(np.diff(path, axis=0), axis=-1).sum(axis=0)


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
        left, right = (
            updateFramePlacement(self.model, self.data, i).homogeneous for i in self.tcp_ids
        )
        return left, right

    def tcp_jacobians(self, q: Array) -> tuple[Array, Array]:
        """Return Jacobians (6, n), [linear; angular], world-aligned."""
        self.placed = b""
        computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        left, right = (
            getFrameJacobian(self.model, self.data, i, pin.LOCAL_WORLD_ALIGNED)
            for i in self.tcp_ids
        )
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
    def _single_arms(self) -> list[tuple[slice, Any]]:
        arms = (self.robot.groups[f"{side}_arm"] for side in SIDES)
        joints = range(self.robot.dof)
        locked = [(arm, [1 + j for j in joints if j not in joints[arm]]) for arm in arms]
        return [
            (arm, pin.ModelPool(pin.buildReducedModel(self.model, ids, self.robot.home), 1))
            for arm, ids in locked
        ]

    def torques(self, q: Array, v: Array, a: Array) -> Array:
        """Return `rnea` for rows of states; for an arm that stands still, of one row."""
        tau = np.empty(q.shape)
        for arm, pool in self._single_arms:
            still = not (v[:, arm].any() or a[:, arm].any() or (q[:, arm] != q[0, arm]).any())
            columns = [
                np.array(x[: 1 if still else None, arm].T, dtype=float, order="F")
                for x in (q, v, a)
            ]
            pin.rneaInParallel(1, pool, *columns, (out := np.empty_like(columns[0])))
            tau[:, arm] = out.T
        return tau

    def torque_use(
        self,
        q: Array,
        v: Array,
        a: Array,
        dt_s: float,
        every: int,
    ) -> tuple[Array, Array]:
        """Return each joint's largest |torque| and mean rate over 8 ms, / limit (n,), over every `every`-th row and the last.

        The mean, because the supervisor spreads what exceeds the rate for 1 ms alone.
        """
        rows = np.append(np.arange(0, len(q) - 1, every), len(q) - 1)
        tau = self.torques(q[rows], v[rows], a[rows])
        span = max(1, min(round(0.008 / dt_s) // every, len(rows) - 1))
        rates = (tau[span:] - tau[:-span]) / (dt_s * (rows[span:] - rows[:-span]))[:, None]
        return largest(tau) / self.robot.tau_max, largest(rates) / self.robot.arm.tau_rate_max


class Hands:
    """Placement of both hands, in Pinocchio's own memory: reading costs nothing, copy what you keep.

    Attributes:
        p, R: Left and right tcp positions (3,) [m] and orientations (3, 3).
        J: (6, n), [linear; angular], of the moving bodies' points at the world's origin.
        views: J, both positions, both orientations: one argument of kernels.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        self._kinematics = kinematics
        self._data = kinematics.data
        left, right = (self._data.oMf[i] for i in kinematics.tcp_ids)
        self.p: tuple[Array, Array] = (left.translation, right.translation)
        self.R: tuple[Array, Array] = (left.rotation, right.rotation)
        self.J: Array = self._data.J
        self.views = (self.J, *self.p, *self.R)

    def update(self, q: Array) -> None:
        """Update all arrays, unless they are of these joints: estimate and law ask in the same step."""
        kinematics = self._kinematics
        placed = q.tobytes()
        if kinematics.placed == placed:
            return
        model = kinematics.model
        data = self._data
        (left, right) = kinematics.tcp_ids
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
        """Return how far a tip rises (m,) [m/rad] with each joint of its arm."""
        J = self.J[:, self._kinematics.robot.joints_of(arm)]
        (x, y, _) = self.p[arm]
        return J[2] + y * J[3] - x * J[4]
