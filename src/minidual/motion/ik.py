"""Inverse kinematics."""

import functools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from minidual.collision.errors import IKUnreachableError
from minidual.errors import UsageError, check_name
from minidual.motion.checks import place_text
from minidual.motion.ik_descent import descend, measure, project, rest, tcp_pose
from minidual.robot.compiled import floats
from minidual.robot.kinematics import Kinematics, hinges
from minidual.robot.pair import DUAL_PANDA, Array, Robot

TOLERANCE = 1e-7
"""Error norm (m and rad combined) that counts as reached."""
_ITERATIONS = 80
_DISTINCT_RAD = 0.1
_REST_TOLERANCE = 1e-4
_REST_MARGIN_RAD = 0.02
_TURN_RAD = 2.0 * np.pi


class PoseUnreachableError(UsageError):
    """A hand cannot reach a pose."""


class IKSolution(NamedTuple):
    """Joints q (n,) of one arm and the error."""

    q: Array
    residual_m: float
    residual_rad: float
    reached: bool

    @property
    def off(self) -> str:
        """The error for messages."""
        return f"{self.residual_m * 1e3:.1f} mm and {self.residual_rad:.3f} rad"

    @property
    def residual(self) -> float:
        """Sum of distance [m] and angle [rad]."""
        return self.residual_m + self.residual_rad


class ArmIK:
    """IK of the "left" or "right" tcp in the world frame."""

    def __init__(self, arm: str, robot: Robot = DUAL_PANDA) -> None:
        check_name("arm", arm, robot.sides)
        self.arm = arm
        self.joints = robot.groups[f"{arm}_arm"]
        self._n = robot.dofs[robot.sides.index(arm)]
        kinematics = Kinematics(robot)
        placements, turns = hinges(robot)
        tip = kinematics.model.frames[kinematics.tcp_ids[robot.sides.index(arm)]]
        fixed = *placements[self.joints], turns[tip.parentJoint] * tip.placement
        self._frames = np.array([T.homogeneous for T in fixed])
        self.lower = robot.q_lower[self.joints].copy()
        self.upper = robot.q_upper[self.joints].copy()
        self._limits = np.array([self.lower, self.upper])
        self._rest_limits = np.array(
            [self.lower + _REST_MARGIN_RAD, self.upper - _REST_MARGIN_RAD],
        )
        self._home = robot.home[self.joints].copy()

    @property
    def frames(self) -> Array:
        """Placements (n + 1, 4, 4) of the joints and the tcp, as the compiled parts need them."""
        return self._frames

    @property
    def rest_limits(self) -> Array:
        """Limits (2, n) [rad] of resting postures, lower first."""
        return self._rest_limits

    def tcp_pose(self, q: Array) -> Array:
        """Return T_world_tcp (4, 4) at q (n,)."""
        T = np.empty((4, 4))
        tcp_pose(self._frames, floats(q).reshape(self._n), T)
        return T

    def error_and_jacobian(self, q: Array, T_world_tcp: Array) -> tuple[Array, Array]:
        """Return e = log6(T_tcp_target) (6,) and de/dq (6, n)."""
        target = floats(T_world_tcp).reshape(4, 4)
        error = np.empty(6)
        J = np.empty((6, self._n))
        measure(self._frames, target, floats(q).reshape(self._n), error, J)
        return error, J

    def solve(
        self,
        T_world_tcp: Array,
        q_start: Array,
        iterations: int = _ITERATIONS,
    ) -> IKSolution:
        """Descend from q_start (n,) to a pose (4, 4) within the limits."""
        target = floats(T_world_tcp).reshape(4, 4)
        q = np.clip(floats(q_start).reshape(self._n), self.lower, self.upper)
        error, residual_m, residual_rad = descend(
            self._frames,
            target,
            q,
            self._limits,
            iterations,
            TOLERANCE,
        )
        return IKSolution(q, residual_m, residual_rad, reached=error < TOLERANCE)

    def nearest(self, T_world_tcp: Array, q_near: Array, wish: Array | None = None) -> Array | None:
        """Return joints (n,) at the pose (4, 4) by least-norm steps from q_near (n,), or None.

        Ignores limits, so smooth in pose, q_near and `wish`, a preferred first step (n,) [rad].
        """
        q = np.array(q_near, dtype=float)
        step = np.zeros(self._n) if wish is None else floats(wish)
        reached = project(self._frames, floats(T_world_tcp), q, step)
        return q if reached else None

    def resting(
        self,
        T_world_tcp: Array,
        q_start: Array,
        posture: Array,
        mobility: Array,
    ) -> IKSolution:
        """Minimise sum_i (q_i - posture_i)^2 / mobility_i at the pose (4, 4).

        q_start (n,) only selects the branch.
        """
        q = np.array(q_start, dtype=float)
        target = floats(T_world_tcp).reshape(4, 4)
        rest(self._frames, target, q, floats(posture), floats(mobility), self._rest_limits)
        error, residual_m, residual_rad = descend(
            self._frames,
            target,
            q,
            self._limits,
            0,
            TOLERANCE,
        )
        # At limits the hand may be on target though the posture has not converged, or stay away
        # where descent does not.
        if error < _REST_TOLERANCE:
            return IKSolution(q, residual_m, residual_rad, reached=True)
        return self.solve(T_world_tcp, q_start)

    def unwound(self, q: Array, q_near: Array) -> Array:
        """Return q (n,) with each joint turned by whole turns towards q_near (n,), inside the limits.

        The hand stays where it is. A joint that cannot turn more than once stays as it is.
        """
        turns = np.round((q_near - q) / _TURN_RAD)
        fewest = np.ceil((self.lower - q) / _TURN_RAD)
        most = np.floor((self.upper - q) / _TURN_RAD)
        turns = np.clip(turns, np.minimum(fewest, 0.0), np.maximum(most, 0.0))
        return np.where(turns == 0.0, q, q + turns * _TURN_RAD)

    def solutions(
        self,
        T_world_tcp: Array,
        q_near: Array,
        rng: np.random.Generator,
        tries_n: int,
    ) -> Iterator[Array]:
        """Yield distinct solutions (n,): the nearest to q_near, then from home and random starts.

        Each lies as near to q_near as whole turns of its joints bring it.

        Raises:
            IKUnreachableError: None found.
        """
        distinct: list[Array] = []
        closest: IKSolution | None = None
        nearest = self.resting(T_world_tcp, q_near, q_near, np.ones(self._n))
        first_starts = [nearest.q, self._home]
        for attempt in range(tries_n):
            if attempt < len(first_starts):
                start = first_starts[attempt]
            else:
                start = rng.uniform(self.lower, self.upper)
            solution = self.solve(T_world_tcp, start)
            if solution.reached:
                q = self.unwound(solution.q, q_near)
                if all(np.max(np.abs(q - other)) > _DISTINCT_RAD for other in distinct):
                    distinct.append(q)
                    yield q
            elif closest is None or solution.residual < closest.residual:
                closest = solution
        if not distinct and closest is not None:
            raise IKUnreachableError(
                f"the {self.arm} hand cannot reach {place_text(T_world_tcp)} as asked:"
                f" the best of {tries_n} starts stays {closest.off} away",
                remedy="move the goal nearer to the base or change its orientation",
            )


@functools.cache
def solvers(robot: Robot) -> dict[str, ArmIK]:
    """Return the inverse kinematics of both arms."""
    return {side: ArmIK(side, robot) for side in robot.sides}


def posture_at(
    robot: Robot,
    Ts_world_tcp: Sequence[Array],
    q_start: Array,
    posture: Array | None = None,
    weights: ArrayLike = 1.0,
) -> Array:
    """Return q (n,) at both tcp poses (4, 4).

    It is nearest to a reference posture (n,) [rad], or by descent from the start. `weights` are one
    or (n,): what the squared distance of a joint from the posture costs.

    Raises:
        PoseUnreachableError: A pose is out of reach.
    """
    q = np.array(q_start, dtype=float)
    mobility = np.ones(robot.dof) / np.asarray(weights)
    for (side, arm), T in zip(solvers(robot).items(), Ts_world_tcp, strict=True):
        near = q[arm.joints]
        if posture is None:
            solution = arm.solve(T, near)
        else:
            solution = arm.resting(T, near, posture[arm.joints], mobility[arm.joints])
        if not solution.reached:
            position = np.round(T[:3, 3], 3).tolist()
            raise PoseUnreachableError(
                f"the {side} hand cannot reach position {position} m: {solution.off} remain",
                remedy="keep it within reach: a smaller start range, or a nearer start",
            )
        q[arm.joints] = solution.q
    return q
