"""Inverse kinematics; checks of poses, configurations and goals."""

import functools
import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from minidual.collision.errors import (
    GoalInCollisionError,
    IKUnreachableError,
    OutOfLimitsError,
    StartInCollisionError,
)
from minidual.errors import UsageError, check_name
from minidual.motion.ik_descent import descend, measure, project, rest, tcp_pose
from minidual.proof.scene_engines import SceneEngines
from minidual.robot.compiled import floats
from minidual.robot.kinematics import Kinematics, hinges
from minidual.robot.limits import clipped, joint_text, outside_limits
from minidual.robot.pair import DUAL_PANDA, GROUP_ARMS, Array, Robot

TOLERANCE = 1e-7
"""Error norm (m and rad combined) that counts as reached."""
_ITERATIONS = 80
_DISTINCT_RAD = 0.1
_SMALL = 1e-4
_NEAR_ITERATIONS = 8
_NEAR_STEP_MAX_RAD = 1.0
_REST_MARGIN_RAD = 0.02


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


def check_pose(T: Array, what: str) -> Array:
    """Return T (4, 4).

    Raises:
        UsageError: Not a finite rigid pose.
    """
    T = np.asarray(T, dtype=float)
    if T.shape != (4, 4):
        raise UsageError(f"{what} has shape {T.shape}; a pose is (4, 4)")
    if not np.isfinite(T).all():
        raise UsageError(f"{what} holds a value that is not finite: {T.ravel().tolist()}")
    R = T[:3, :3]
    off = np.abs(R @ R.T - np.eye(3)).max()
    det = np.linalg.det(R)
    if off > 1e-6 or det < 0.0 or np.abs(T[3] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-9:
        raise UsageError(
            f"{what} is no rigid pose: R R^T is {off:.2g} from the identity, det {det:.3f}",
        )
    return T


class ArmIK:
    """IK of the "left" or "right" tcp in the world frame."""

    def __init__(self, arm: str, robot: Robot = DUAL_PANDA) -> None:
        check_name("arm", arm, robot.sides)
        self.arm = arm
        self.joints = robot.groups[f"{arm}_arm"]
        self._n = robot.dof_per_arm
        kinematics = Kinematics(robot)
        (placements, turns) = hinges(robot)
        tip = kinematics.model.frames[kinematics.tcp_ids[robot.sides.index(arm)]]
        fixed = *placements[self.joints], turns[tip.parentJoint] * tip.placement
        self._frames = np.array([T.homogeneous for T in fixed])
        self.lower = robot.q_lower[self.joints].copy()
        self.upper = robot.q_upper[self.joints].copy()
        self._home = robot.home[self.joints].copy()

    def tcp_pose(self, q: Array) -> Array:
        """Return T_world_tcp (4, 4) at q (n,)."""
        T = np.empty((4, 4))
        tcp_pose(self._frames, floats(q).reshape(self._n), T)
        return T

    def error_and_jacobian(self, q: Array, T_world_tcp: Array) -> tuple[Array, Array]:
        """Return e = log6(T_tcp_target) (6,) and de/dq (6, n)."""
        error = np.empty(6)
        J = np.empty((6, self._n))
        measure(
            self._frames,
            floats(T_world_tcp).reshape(4, 4),
            floats(q).reshape(self._n),
            error,
            J,
        )
        return error, J

    def solve(
        self,
        T_world_tcp: Array,
        q_start: Array,
        iterations: int = _ITERATIONS,
    ) -> IKSolution:
        """Descend from q_start within the limits."""
        q = np.clip(floats(q_start).reshape(self._n), self.lower, self.upper)
        target = floats(T_world_tcp).reshape(4, 4)
        off, residual_m, residual_rad = descend(
            self._frames,
            target,
            q,
            self.lower,
            self.upper,
            iterations,
            TOLERANCE,
        )
        return IKSolution(q, residual_m, residual_rad, off < TOLERANCE)

    def nearest(self, T_world_tcp: Array, q_near: Array, wish: Array | None = None) -> Array | None:
        """Return joints (n,) at the pose (4, 4) by least-norm steps from q_near (n,), or None.

        Ignores limits, so smooth in pose, q_near and `wish`, a preferred first step (n,) [rad].
        """
        q = np.array(q_near, dtype=float)
        wish = np.zeros(self._n) if wish is None else floats(wish)
        target = floats(T_world_tcp)
        return (
            q
            if project(self._frames, target, q, wish, _NEAR_ITERATIONS, _SMALL, _NEAR_STEP_MAX_RAD)
            else None
        )

    def resting(
        self,
        T_world_tcp: Array,
        q_start: Array,
        posture: Array,
        mobility: Array,
    ) -> IKSolution:
        """Minimise sum_i (q_i - posture_i)^2 / mobility_i at the pose; q_start only selects the branch."""
        q = np.array(q_start, dtype=float)
        target = floats(T_world_tcp).reshape(4, 4)
        limits = np.array([self.lower + _REST_MARGIN_RAD, self.upper - _REST_MARGIN_RAD])
        rest(self._frames, target, q, floats(posture), floats(mobility), limits)
        off, residual_m, residual_rad = descend(
            self._frames,
            target,
            q,
            self.lower,
            self.upper,
            0,
            TOLERANCE,
        )
        # At limits the hand may be on target though the posture has not converged, or stay away where descent does not.
        return (
            IKSolution(q, residual_m, residual_rad, True)
            if off < _SMALL
            else self.solve(T_world_tcp, q_start)
        )

    def solutions(
        self,
        T_world_tcp: Array,
        q_near: Array,
        rng: np.random.Generator,
        tries_n: int,
    ) -> Iterator[Array]:
        """Yield distinct solutions (n,): the nearest to q_near, then from home and random starts.

        Raises:
            IKUnreachableError: None found.
        """
        found: list[Array] = []
        best: IKSolution | None = None
        first = self.resting(T_world_tcp, q_near, q_near, np.ones(self._n)).q, self._home
        for attempt in range(tries_n):
            solution = self.solve(
                T_world_tcp,
                first[attempt] if attempt < 2 else rng.uniform(self.lower, self.upper),
            )
            if solution.reached:
                if all(np.max(np.abs(solution.q - q)) > _DISTINCT_RAD for q in found):
                    found.append(solution.q)
                    yield solution.q
            elif (
                best is None
                or solution.residual_m + solution.residual_rad < best.residual_m + best.residual_rad
            ):
                best = solution
        if not found and best is not None:
            what = f"the {self.arm} hand cannot reach {place_text(T_world_tcp)} as asked"
            remedy = "move the goal nearer to the base or change its orientation"
            raise IKUnreachableError(
                f"{what}: the best of {tries_n} starts stays {best.off} away",
                remedy=remedy,
            )


def place_text(T: Array) -> str:
    """Return the position of a pose (4, 4) for messages."""
    return "({:.3f}, {:.3f}, {:.3f}) m".format(*T[:3, 3])


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
    """Return q (n,) at both tcp poses (4, 4), nearest to a reference posture (n,) [rad], or by descent from the start.

    Raises:
        PoseUnreachableError: A pose is out of reach.
    """
    q = np.array(q_start, dtype=float)
    mobility = np.ones(robot.dof_per_arm) / np.asarray(weights)
    for (side, arm), T in zip(solvers(robot).items(), Ts_world_tcp, strict=True):
        near = q[arm.joints]
        found = (
            arm.solve(T, near)
            if posture is None
            else arm.resting(T, near, posture[arm.joints], mobility)
        )
        if not found.reached:
            what = f"the {side} hand cannot reach position {np.round(T[:3, 3], 3).tolist()} m: {found.off} remain"
            raise PoseUnreachableError(
                what,
                remedy="keep it within reach: a smaller start range, or a nearer start",
            )
        q[arm.joints] = found.q
    return q


def check_joints(q: Array, what: str, robot: Robot) -> Array:
    """Return q (n,), on its limit where it is beyond by no more than rounding.

    Raises:
        OutOfLimitsError: Wrong shape, not finite, or outside limits.
    """
    q = np.array(q, dtype=float)
    if q.shape != (robot.dof,):
        raise OutOfLimitsError(
            f"the {what} has shape {q.shape}; all {robot.dof} joints are needed, left arm first",
        )
    if not np.isfinite(q).all():
        bad = int(np.argmin(np.isfinite(q)))
        raise OutOfLimitsError(
            f"the {what} has {robot.joint_names[bad]} = {q[bad]}; it must be a finite number",
        )
    if outside_limits(q, robot).any():
        worst = int(np.argmax(np.maximum(robot.q_lower - q, q - robot.q_upper)))
        value = joint_text(q[worst])
        lower = joint_text(robot.q_lower[worst])
        upper = joint_text(robot.q_upper[worst])
        raise OutOfLimitsError(
            f"the {what} has {robot.joint_names[worst]} = {value} rad; "
            f"its limits are {lower} to {upper} rad",
        )
    return clipped(q, robot)


def goal_joints(
    group: str,
    q_start: Array,
    q_goal: Array,
    robot: Robot,
    what: str = "goal",
) -> Array:
    """Return the goal (n,), completed from the start if of the group's size.

    Raises:
        OutOfLimitsError: See `check_joints`.
        UsageError: The goal moves another arm.
    """
    joints = robot.groups[group]
    q_goal = np.asarray(q_goal, dtype=float)
    full = np.array(q_start)
    if q_goal.shape == full[joints].shape:
        full[joints] = q_goal
        return check_joints(full, what, robot)
    full[joints] = check_joints(q_goal, what, robot)[joints]
    if np.abs(full - q_goal).max() > 1e-6:
        remedy = "plan with the group both_arms, or give only the group's own joints"
        raise UsageError(
            f"the goal moves joints outside {group}, which holds the other arm",
            remedy=remedy,
        )
    return full


def require_free(engine: SceneEngines, q: Array, what: str) -> None:
    """Check that q (n,) is free.

    Raises:
        StartInCollisionError, GoalInCollisionError: It is not.
    """
    near = engine.closest(q, 0.001)
    if near and near[0].distance_m <= 0.0:
        kind = StartInCollisionError if what == "start" else GoalInCollisionError
        kept = engine.scene.min_distance_m
        # Obstacles are grown by this distance, so being near one counts as contact.
        grown = f" (the scene keeps {kept * 1e3:g} mm from obstacles)" if kept > 0.0 else ""
        remedy = "move it, remove the obstacle, or allow the pair in the scene"
        raise kind(f"the {what} is in collision: {near[0]}{grown}", remedy=remedy)


def check_targets(group: str, targets: Mapping[str, Array]) -> dict[str, Array]:
    """Return checked {arm: T_world_tcp (4, 4)}.

    Raises:
        UsageError: Wrong arms or an invalid pose.
    """
    arms = GROUP_ARMS[group]
    if set(targets) != set(arms):
        raise UsageError(
            f"the targets name {', '.join(sorted(targets)) or 'no arm'}; {group} needs {', '.join(arms)}",
        )
    return {arm: check_pose(targets[arm], f"the target of the {arm} hand") for arm in arms}


def pose_goals(
    group: str,
    q_start: Array,
    targets: Mapping[str, Array],
    engine: SceneEngines,
    rng: np.random.Generator,
    restarts_n: int,
    goals_n: int = 1,
) -> list[Array]:
    """Return free configurations (n,) at tcp poses, nearest to the start first.

    Raises:
        IKUnreachableError, GoalInCollisionError: None exists.
        UsageError: Wrong arms or invalid pose.
    """
    arms = solvers(engine.scene.robot)
    solutions = {
        side: arms[side].solutions(T, q_start[arms[side].joints], rng, restarts_n)
        for side, T in check_targets(group, targets).items()
    }
    found: dict[str, list[Array]] = {side: [] for side in solutions}
    while True:
        new = {side: list(itertools.islice(more, goals_n)) for side, more in solutions.items()}
        found = {side: found[side] + new[side] for side in found}
        combined = []
        for parts in itertools.product(*found.values()):
            q = np.array(q_start)
            for side, part in zip(found, parts, strict=True):
                q[arms[side].joints] = part
            combined.append(q)
        combined.sort(key=lambda q: float(np.linalg.norm(q - q_start)))
        if free := list(itertools.islice(filter(engine.solids.free, combined), goals_n)):
            return free
        if not any(new.values()):
            require_free(engine, combined[0], "goal")
            why = "the goal is too close to contact: no plane separates all pairs at any of its solutions"
            raise GoalInCollisionError(
                why,
                remedy="move it a little, or allow the pair in the scene",
            )
