"""Inverse kinematics of one arm: descents on SE(3) with active joint limits, from several starts."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from minidual.collision.errors import IKUnreachableError
from minidual.errors import UsageError, unknown_name
from minidual.motion.ik_descent import descend, frames_of_arm, measure, tcp_pose
from minidual.robot.compiled import floats
from minidual.robot.constants import ARMS, DOF_PER_ARM, GROUPS, HOME, Q_LOWER, Q_UPPER, Array
from minidual.robot.kinematics import Kinematics
from minidual.robot.vectors import cross, inner

TOLERANCE = 1e-7
"""Norm of the SE(3) error [m and rad together] at which the pose counts as reached."""
_ITERATIONS = 80
_DISTINCT_RAD = 0.1


@dataclass(frozen=True)
class IKSolution:
    """Joints q (7,) of one arm and what is left of the error."""

    q: Array
    residual_m: float
    residual_rad: float
    reached: bool


def check_pose(T: Array, what: str) -> Array:
    """Return T as a (4, 4) array.

    Raises:
        UsageError: Wrong shape, a value that is not finite, or no rotation in it.
    """
    T = np.asarray(T, dtype=float)
    if T.shape != (4, 4):
        raise UsageError(f"{what} has shape {T.shape}; a pose is (4, 4)")
    # On so few numbers plain floats are ten times faster than arrays.
    x, y, z, last = T.tolist()
    if not all(map(math.isfinite, (*x, *y, *z, *last))):
        raise UsageError(f"{what} holds a value that is not finite: {T.ravel().tolist()}")
    rows = x[:3], y[:3], z[:3]
    off = max(abs(inner(u, v) - (u is v)) for u in rows for v in rows)
    det = inner(cross(rows[0], rows[1]), rows[2])
    if off > 1e-6 or det < 0.0 or max(map(abs, (*last[:3], last[3] - 1.0))) > 1e-9:
        raise UsageError(f"{what} is no rigid pose: R R^T is {off:.2g} from the identity, det {det:.3f}")
    return T


class ArmIK:
    """Inverse kinematics of one arm to its tcp, in the world frame."""

    def __init__(self, arm: str) -> None:
        if arm not in ARMS:
            raise unknown_name("arm", arm, ARMS)
        self.arm = arm
        columns = GROUPS[f"{arm}_arm"]
        kinematics = Kinematics()
        self._frames = frames_of_arm(kinematics.model, columns, kinematics.tcp_ids[ARMS.index(arm)])
        self.lower, self.upper = Q_LOWER[columns].copy(), Q_UPPER[columns].copy()
        self._home = HOME[columns].copy()

    def tcp_pose(self, q: Array) -> Array:
        """Return T_world_tcp (4, 4) at q (7,)."""
        T = np.empty((4, 4))
        tcp_pose(self._frames, floats(q).reshape(DOF_PER_ARM), T)
        return T

    def error_and_jacobian(self, q: Array, T_world_tcp: Array) -> tuple[Array, Array]:
        """Return the error (6,) and its derivative by q (6, 7); held to finite differences by the tests."""
        error, J = np.empty(6), np.empty((6, DOF_PER_ARM))
        measure(self._frames, floats(T_world_tcp).reshape(4, 4), floats(q).reshape(DOF_PER_ARM), error, J)
        return error, J

    def solve(self, T_world_tcp: Array, q_start: Array, iterations: int = _ITERATIONS) -> IKSolution:
        """Descend from q_start (7,) to the pose; `reached` tells whether the tolerance was met."""
        q = np.clip(floats(q_start).reshape(DOF_PER_ARM), self.lower, self.upper)
        target = floats(T_world_tcp).reshape(4, 4)
        off, residual_m, residual_rad = descend(self._frames, target, q, self.lower, self.upper, iterations, TOLERANCE)
        return IKSolution(q, residual_m, residual_rad, off < TOLERANCE)

    def solutions(
        self, T_world_tcp: Array, q_near: Array, rng: np.random.Generator, restarts_n: int
    ) -> Iterator[Array]:
        """Yield distinct solutions (7,): the descent from q_near first, then from home and from random starts.

        Raises:
            IKUnreachableError: None of `restarts_n` starts reached the pose; the message names the best residual.
        """
        found: list[Array] = []
        best: IKSolution | None = None
        for attempt in range(restarts_n):
            if attempt == 0:
                start = q_near
            elif attempt == 1:
                start = self._home
            else:
                start = rng.uniform(self.lower, self.upper)
            solution = self.solve(T_world_tcp, start)
            if solution.reached:
                if all(np.max(np.abs(solution.q - q)) > _DISTINCT_RAD for q in found):
                    found.append(solution.q)
                    yield solution.q
            elif best is None or solution.residual_m + solution.residual_rad < best.residual_m + best.residual_rad:
                best = solution
        if not found and best is not None:
            x, y, z = T_world_tcp[:3, 3]
            raise IKUnreachableError(
                f"the {self.arm} hand cannot reach ({x:.3f}, {y:.3f}, {z:.3f}) m as asked: the best of {restarts_n} "
                f"starts stays {best.residual_m * 1e3:.1f} mm and {best.residual_rad:.3f} rad away",
                remedy="move the goal nearer to the base (reach 0.85 m) or change its orientation",
            )
