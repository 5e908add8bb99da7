"""Both hands follow one object: inverse kinematics of 14 joints to an object's pose, from a configuration near by.

Newton steps of least norm for each arm, q <- q + J^T (J J^T)^-1 log6(T_tcp_target): near a solution the error squares
with every step, so one or two steps of some 40 us solve a point of a path. No limits are active inside: a solution
outside them is refused, which keeps the solution a smooth function of pose and start.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from minidual.collision.errors import ClosedChainError
from minidual.robot.constants import ARMS, DOF_PER_ARM, JOINT_NAMES, Q_LOWER, Q_UPPER, Array
from minidual.robot.kinematics import Kinematics

_SMALL = 1e-4
"""Error after which one more step leaves about its square: below every tolerance in use."""
_DAMPING = 1e-9
_ITERATIONS = 8
_STEP_MAX_RAD = 1.0
_LIMIT_BAND_RAD = 0.35
_LIMIT_PUSH_RAD_PER_M = 3.0
_RELAX_STEPS_N = 12
_RELAX_STEP_M = 0.05
_ARM_M = 0.2
JUMP_MAX_RAD = 0.15
"""Largest joint step between neighbouring points of a path: more is a jump, not a motion."""


@dataclass(frozen=True)
class Stuck:
    """Where a continuation ended and why.

    point: Index of the pose that was not reached.
    arm: Arm that failed.
    why: "limit" (a joint would leave its range), "reach" (the error stays) or "jump".
    detail: The numbers, for a message.
    """

    point: int
    arm: str
    why: str
    detail: str


class HandsIK:
    """Solves both arms for the pose of an object that they hold.

    Args:
        T_object_tcp_left: Grasp of the left hand (4, 4).
        T_object_tcp_right: Grasp of the right hand (4, 4).
        kinematics: Workspace.
    """

    def __init__(self, T_object_tcp_left: Array, T_object_tcp_right: Array, kinematics: Kinematics) -> None:
        self._grasps = (pin.SE3(T_object_tcp_left), pin.SE3(T_object_tcp_right))
        self._kinematics = kinematics
        self._e = np.empty((2, 6, 1))
        self._J = np.empty((2, 6, DOF_PER_ARM))
        self._J_t = self._J.transpose(0, 2, 1)
        self._damping = _DAMPING * np.eye(6)

    def _linearise(self, q: Array, target: pin.SE3) -> float:
        """Fill errors and Jacobians at q for an object pose; return the norm of all errors [m and rad together]."""
        model, data = self._kinematics.model, self._kinematics.data
        left, right = self._kinematics.tcp_ids
        pin.computeJointJacobians(model, data, q)
        e, J = self._e, self._J
        here = pin.updateFramePlacement(model, data, left)
        e[0, :, 0] = pin.log6(here.actInv(target * self._grasps[0])).vector
        J[0] = pin.getFrameJacobian(model, data, left, pin.LOCAL)[:, :DOF_PER_ARM]
        here = pin.updateFramePlacement(model, data, right)
        e[1, :, 0] = pin.log6(here.actInv(target * self._grasps[1])).vector
        J[1] = pin.getFrameJacobian(model, data, right, pin.LOCAL)[:, DOF_PER_ARM:]
        flat = e.ravel()
        return math.sqrt(flat @ flat)

    def _step(self, e: Array, wish: Array | None = None) -> Array:
        """Return the step (14,) that takes errors (2, 6, 1) away: the shortest, or the one nearest to a wish (14,)."""
        H = self._J @ self._J_t
        H += self._damping
        if wish is None:
            return (self._J_t @ np.linalg.solve(H, e)).ravel()
        e = e - self._J @ wish.reshape(2, DOF_PER_ARM, 1)
        return wish + (self._J_t @ np.linalg.solve(H, e)).ravel()

    def solve(self, T_world_object: Array, q_near: Array) -> Array | None:
        """Return q (14,) with both hands at their grasps, inside the limits, or None.

        The solution is the projection of q_near: the same pose and q_near give the same q whatever came before.
        """
        target = pin.SE3(T_world_object)
        q = q_near
        for _ in range(_ITERATIONS):
            error = self._linearise(q, target)
            step = self._step(self._e)
            if not step @ step < _STEP_MAX_RAD**2:  # NaN ends here, too
                return None
            q = q + step
            if error < _SMALL:
                return q if _inside(q) else None
        return None

    def elbow_swing(self, q: Array, swings_rad: Array) -> Array:
        """Return the step (14,) at q (14,) that moves no hand: each arm along its one free direction, by swings (2,)."""
        model, data = self._kinematics.model, self._kinematics.data
        pin.computeJointJacobians(model, data, q)
        step = np.empty_like(q)
        for k, frame in enumerate(self._kinematics.tcp_ids):
            joints = slice(k * DOF_PER_ARM, (k + 1) * DOF_PER_ARM)
            pin.updateFramePlacement(model, data, frame)
            J = pin.getFrameJacobian(model, data, frame, pin.LOCAL)[:, joints]
            free = np.linalg.svd(J)[2][-1]
            step[joints] = swings_rad[k] * (free if free[np.argmax(np.abs(free))] > 0.0 else -free)
        return step

    def relaxed(self, T_world_object: Array, q: Array) -> Array:
        """Return the posture (14,) at the same object pose with its joints off their limits, as far as it goes."""
        for _ in range(_RELAX_STEPS_N):
            wish = _RELAX_STEP_M * off_limits(q)
            if not wish.any():
                break
            self._linearise(q, pin.SE3(T_world_object))
            moved = self.solve(T_world_object, q + self._step(self._e, wish))
            if moved is None:
                break
            q = moved
        return q

    def follow(self, Ts_world_object: Array, q_start: Array) -> tuple[Array, Stuck | None]:
        """Continue along poses (n, 4, 4) from q_start (14,), which must be at the first one.

        Each arm moves as little as it can from pose to pose, but keeps its joints off their limits where its
        redundancy allows (see `off_limits`).

        Returns:
            Q (m, 14) as far as it got, and why it ended there (None if m = n).
        """
        poses = [pin.SE3(T) for T in Ts_world_object]
        Q = np.empty((len(poses), len(q_start)))
        Q[0] = q_start
        self._linearise(q_start, poses[0])
        ahead = np.empty((2, 6, 1))
        for k in range(1, len(poses)):
            # The first step comes from the path itself: how each hand's target moves, seen from the hand.
            moved = poses[k - 1].actInv(poses[k])
            for i, grasp in enumerate(self._grasps):
                ahead[i, :, 0] = pin.log6(grasp.actInv(moved * grasp)).vector
            way = math.hypot(np.linalg.norm(moved.translation), _ARM_M * np.linalg.norm(pin.log3(moved.rotation)))
            q = Q[k - 1] + self._step(ahead, way * off_limits(Q[k - 1]))
            for _ in range(_ITERATIONS):
                error = self._linearise(q, poses[k])
                step = self._step(self._e)
                if not step @ step < _STEP_MAX_RAD**2:
                    return Q[:k], self._stuck(k, "reach", Q[k - 1], q)
                q = q + step
                if error < _SMALL:
                    break
            else:
                return Q[:k], self._stuck(k, "reach", Q[k - 1], q)
            if np.abs(q - Q[k - 1]).max() > JUMP_MAX_RAD:
                return Q[:k], self._stuck(k, "jump", Q[k - 1], q)
            if not _inside(q):
                return Q[:k], self._stuck(k, "limit", Q[k - 1], q)
            Q[k] = q
        return Q, None

    def _stuck(self, point: int, why: str, before: Array, q: Array) -> Stuck:
        if why == "limit":
            joint = int(np.argmax(np.maximum(Q_LOWER - q, q - Q_UPPER)))
            detail = (
                f"{JOINT_NAMES[joint]} would go to {q[joint]:.3f} rad, its limits are "
                f"{Q_LOWER[joint]:.3f} to {Q_UPPER[joint]:.3f} rad"
            )
            return Stuck(point, ARMS[joint // DOF_PER_ARM], why, detail)
        steps = np.abs(q - before).reshape(2, DOF_PER_ARM).max(axis=1)
        arm = int(np.argmax(np.nan_to_num(steps, nan=np.inf)))
        if why == "jump":
            return Stuck(point, ARMS[arm], why, f"{steps[arm]:.2f} rad")
        distance, angle = np.linalg.norm(self._e[arm, :3]), np.linalg.norm(self._e[arm, 3:])
        return Stuck(point, ARMS[arm], why, f"it stays {distance * 1e3:.1f} mm and {angle:.3f} rad away")

    def off_grasp(self, q: Array, T_world_object: Array) -> tuple[tuple[float, float], ...]:
        """Return for each hand how far it is from its grasp at q (14,): ([m], [rad])."""
        hands = self._kinematics.tcp_poses(q)
        return tuple(
            _apart(hand[None], (T_world_object @ grasp.homogeneous)[None])
            for hand, grasp in zip(hands, self._grasps, strict=True)
        )

    def strays(self, Q: Array, Ts_world_object: Array) -> tuple[float, float]:
        """Return the largest error of a hand against its grasp, or of the hands against each other: ([m], [rad]).

        Args:
            Q: Configurations (n, 14).
            Ts_world_object: Pose of the object at each (n, 4, 4).
        """
        hands = np.array([self._kinematics.tcp_poses(q) for q in Q])
        wanted = [Ts_world_object @ grasp.homogeneous for grasp in self._grasps]
        grasp = (self._grasps[0].inverse() * self._grasps[1]).homogeneous
        pairs = ((hands[:, 0], wanted[0]), (hands[:, 1], wanted[1]), (hands[:, 1], hands[:, 0] @ grasp))
        return tuple(np.max([_apart(a, b) for a, b in pairs], axis=0).tolist())


def off_limits(q: Array) -> Array:
    """Return where joints (14,) near a limit should go, away from it [rad per metre of the object's way].

    Zero farther than 0.35 rad from both limits, growing with the square of what is missing, so that it has no corner.
    """
    low = np.maximum(0.0, _LIMIT_BAND_RAD - (q - Q_LOWER)) / _LIMIT_BAND_RAD
    high = np.maximum(0.0, _LIMIT_BAND_RAD - (Q_UPPER - q)) / _LIMIT_BAND_RAD
    return _LIMIT_PUSH_RAD_PER_M * (low**2 - high**2)


def _inside(q: Array) -> bool:
    return bool(((q >= Q_LOWER) & (q <= Q_UPPER)).all())


def _apart(A: Array, B: Array) -> tuple[float, float]:
    """Return the largest distance [m] and angle [rad] between poses (n, 4, 4)."""
    R = np.swapaxes(A[:, :3, :3], 1, 2) @ B[:, :3, :3]
    sine = 0.5 * np.linalg.norm(
        np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]]), axis=0
    )
    cosine = 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0)
    angles = np.arctan2(sine, cosine)
    return float(np.linalg.norm(A[:, :3, 3] - B[:, :3, 3], axis=1).max()), float(angles.max())


def require_followed(stuck: Stuck | None, Ts_world_object: Sequence[Array]) -> None:
    """Check that a continuation went to the end.

    Raises:
        ClosedChainError: It did not; with arm, place and numbers.
    """
    if stuck is None:
        return
    x, y, z = Ts_world_object[stuck.point][:3, 3]
    where = f"({x:.3f}, {y:.3f}, {z:.3f}) m"
    if stuck.why == "jump":
        raise ClosedChainError(
            f"the {stuck.arm} arm would jump by {stuck.detail} between neighbouring points of the object's path at "
            f"{where} (a joint limit or a singular posture)",
            remedy="start from another posture of the arm",
        )
    raise ClosedChainError(
        f"the {stuck.arm} hand cannot follow the object to {where}: {stuck.detail}",
        remedy="choose waypoints within reach of both arms, or another grasp",
    )
