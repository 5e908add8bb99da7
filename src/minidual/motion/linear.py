"""Straight tcp motion, until a pose is out of reach, an arm would jump, or something collides."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from minidual.collision.errors import LinearMoveError
from minidual.config.planning import MotionLimits
from minidual.motion.checks import check_joints, check_targets, require_free
from minidual.motion.held.path import ROTATION_WEIGHT_M
from minidual.motion.ik import ArmIK, solvers
from minidual.motion.speed_profile import DT_S
from minidual.motion.timing import PathLimits, TimedPath, resting
from minidual.motion.timing_engines import OWN, TimingEngine
from minidual.proof.scene_engines import SceneEngines, Verification
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array, pose
from minidual.robot.trajectory import Trajectory

DEVIATION_MAX_M = 2e-4
DEVIATION_MAX_RAD = 1e-3
TIP_LIMITS = PathLimits(speed_m_per_s=0.25, acceleration_m_per_s2=0.8)
_STEP_M = 0.005
_JUMP_MAX_RAD = 0.15
_REFINEMENTS = 3
_BACK_OFFS = 6
_POINTS_MIN = 4
_STILL_M = 1e-9
_NEAR_M = 0.001
_CHECKED_EVERY = 5


class LinearMove(NamedTuple):
    """A proven straight move, possibly partial.

    Attributes:
        fraction: Part covered, 0 to 1.
        reason: Why it ends early, or "".
    """

    trajectory: Trajectory
    verification: Verification
    fraction: float = 1.0
    reason: str = ""


class Line:
    """Line between tcp poses (4, 4), turning about one axis."""

    def __init__(self, T_start: Array, T_end: Array) -> None:
        self._start = T_start
        self._shift = T_end[:3, 3] - T_start[:3, 3]
        self._turn = pin.log3(T_start[:3, :3].T @ T_end[:3, :3])
        way = np.linalg.norm(self._shift)
        angle = np.linalg.norm(self._turn)
        self.length_m = float(np.hypot(way, ROTATION_WEIGHT_M * angle))
        """Includes rotation, weighted."""

    def at(self, x: float) -> Array:
        """Return T_world_tcp (4, 4) at x in 0..1."""
        R = self._start[:3, :3] @ pin.exp3(x * self._turn)
        return pose(R, self._start[:3, 3] + x * self._shift)

    def off(self, T: Array, x: float) -> tuple[float, float]:
        """Return the distance from the line [m] and from the orientation at x [rad]."""
        moved = T[:3, 3] - self._start[:3, 3]
        length = float(np.linalg.norm(self._shift))
        along = np.zeros(3)
        if length > _STILL_M:
            along = self._shift * float(moved @ self._shift) / length**2
        angle = float(np.linalg.norm(pin.log3(self.at(x)[:3, :3].T @ T[:3, :3])))
        return float(np.linalg.norm(moved - along)), angle


class _Followed(NamedTuple):
    """Points that the hands reach along their lines.

    Attributes:
        marks: Path parameter of all points (n,) [m].
        Q: Joints at the first of them (m <= n, dof).
        reason: Why the hands cannot follow farther, or "".
    """

    marks: Array
    Q: Array
    reason: str


class _Curve:
    """Columns over s [m]: joints and s."""

    def __init__(self, marks: Array, Q: Array) -> None:
        self._spline = CubicSpline(marks, Q, bc_type="natural")
        self.length = float(marks[-1])
        self.knots = marks[[0, -1]]

    def at(self, s: Array, order: int = 0) -> Array:
        if order == 0:
            way = s
        elif order == 1:
            way = np.ones_like(s)
        else:
            way = np.zeros_like(s)
        return np.column_stack([self._spline(s, order), way])


class LinearPlanner:
    """Plans straight tcp moves. One instance per process."""

    def __init__(
        self,
        limits: MotionLimits | None = None,
        kinematics: Kinematics | None = None,
        timing: TimingEngine = OWN,
    ) -> None:
        self._kinematics = kinematics or Kinematics()
        self._robot = self._kinematics.robot
        self._ik = solvers(self._robot)
        self._limits = limits or MotionLimits()
        self._timing = timing

    def plan(
        self,
        group: str,
        q_start: Array,
        targets: Mapping[str, Array],
        engines: SceneEngines,
        *,
        limits: PathLimits | None = None,
        fraction_min: float = 1.0,
    ) -> LinearMove:
        """Return the straight move from q_start (n,) to tcp poses; the tcps end together.

        Args:
            group: Planning group.
            q_start: All joints (n,).
            targets: {arm: T_world_tcp (4, 4)} of exactly the group's arms.
            engines: The scene.
            limits: Of the tcps.
            fraction_min: Part of the lines that suffices.

        Raises:
            LinearMoveError, TimingError: It covers less than `fraction_min`, deviates, or is not
                proven.
            UsageError, OutOfLimitsError, StartInCollisionError: Bad query.
        """
        checked = check_targets(group, targets)
        q_start = check_joints(q_start, "start", self._robot)
        require_free(engines, q_start, "start")
        tips = dict(zip(SIDES, self._kinematics.tcp_poses(q_start), strict=True))
        lines = {arm: Line(tips[arm], T) for arm, T in checked.items()}
        length = max(line.length_m for line in lines.values())
        if length < _STILL_M:
            return _staying(group, q_start, engines)
        off_m = off_rad = np.inf
        for refinement in range(_REFINEMENTS):
            count = max(8, int(np.ceil(length / (_STEP_M * 0.5**refinement))))
            marks = np.linspace(0.0, length, count + 1, dtype=np.float64)
            followed = self._follow(q_start, lines, engines, marks)
            move, s = self._timed(group, followed, engines, limits or TIP_LIMITS)
            off_m, off_rad = self._deviation(move.trajectory, s / length, lines)
            if off_m < DEVIATION_MAX_M and off_rad < DEVIATION_MAX_RAD:
                if move.fraction < fraction_min:
                    raise _cut_short(group, move.fraction, move.reason)
                return move
        raise LinearMoveError(
            f"between its points the straight move strays {off_m * 1e3:.3f} mm and"
            f" {off_rad:.5f} rad; allowed are {DEVIATION_MAX_M * 1e3} mm and"
            f" {DEVIATION_MAX_RAD} rad",
            remedy="start from a posture farther from a singularity",
        )

    def _follow(
        self,
        q_start: Array,
        lines: Mapping[str, Line],
        engines: SceneEngines,
        marks: Array,
    ) -> _Followed:
        """Solve the points of the lines one after the other, as far as they go."""
        Q = [q_start]
        for mark in marks[1:]:
            q = Q[-1].copy()
            for arm, line in lines.items():
                ik = self._ik[arm]
                T = line.at(float(mark / marks[-1]))
                reason = _follow_point(ik, T, q, float(marks[1]))
                if reason:
                    return _Followed(marks, np.array(Q), reason)
            near = engines.closest(q, _NEAR_M)
            if near and near[0].distance_m <= 0.0:
                return _Followed(marks, np.array(Q), f"collision: {near[0]}")
            Q.append(q)
        return _Followed(marks, np.array(Q), "")

    def _timed(
        self,
        group: str,
        followed: _Followed,
        engines: SceneEngines,
        limits: PathLimits,
    ) -> tuple[LinearMove, Array]:
        """Return the longest move that is proven, and s at its samples (m,) [m]."""
        marks = followed.marks
        reason = followed.reason
        for back_off in range(_BACK_OFFS):
            keep = len(followed.Q) - 2**back_off + 1
            if keep < _POINTS_MIN:
                break
            timed = self._time(group, marks[:keep], followed.Q[:keep], limits)
            proof = engines.verify(timed.trajectory, self._timing.unlimited)
            if proof.ok:
                fraction = float(marks[keep - 1] / marks[-1])
                return LinearMove(timed.trajectory, proof, fraction, reason), timed.s
            reason = reason or f"the proof refuses the rest: {proof.reason}"
        raise _cut_short(group, 0.0, reason or "there is no room to begin")

    def _time(self, group: str, marks: Array, Q: Array, limits: PathLimits) -> TimedPath:
        curve = _Curve(marks, Q)
        return self._timing.time_path(curve, group, self._limits, self._kinematics, limits)

    def _deviation(
        self,
        trajectory: Trajectory,
        fractions: Array,
        lines: Mapping[str, Line],
    ) -> tuple[float, float]:
        """Return the largest distance [m] and angle [rad] of the tcps from their lines."""
        last = len(fractions) - 1
        rows = np.unique(np.append(np.arange(0, len(fractions), _CHECKED_EVERY), last))
        off: list[tuple[float, float]] = []
        for k in rows:
            for arm, line in lines.items():
                ik = self._ik[arm]
                T = ik.tcp_pose(trajectory.q[k, ik.joints])
                off.append(line.off(T, float(fractions[k])))
        off_m, off_rad = np.max(off, axis=0).tolist()
        return off_m, off_rad


def _follow_point(ik: ArmIK, T_world_tcp: Array, q: Array, step_m: float) -> str:
    """Move the arm in q (n,) to the pose (4, 4); return why it cannot, or "". `step_m`: of the tcp."""
    solution = ik.solve(T_world_tcp, q[ik.joints])
    if not solution.reached:
        return f"the {ik.arm} hand cannot go on: it stays {solution.off} away"
    jump = float(np.abs(solution.q - q[ik.joints]).max())
    if jump > _JUMP_MAX_RAD:
        return (
            f"the {ik.arm} arm would jump by {jump:.2f} rad within {step_m * 1e3:.1f} mm"
            " (a joint limit or a singular posture)"
        )
    q[ik.joints] = solution.q
    return ""


def _staying(group: str, q: Array, engines: SceneEngines) -> LinearMove:
    """Return the move that stays at q (n,)."""
    still = resting(q, DT_S, group)
    proof = engines.verify(still)
    if not proof.ok:
        raise _cut_short(group, 1.0, f"staying there is not proven: {proof.reason}")
    return LinearMove(still, proof)


def _cut_short(group: str, fraction: float, reason: str) -> LinearMoveError:
    return LinearMoveError(
        f"the straight move of {group} ends at {fraction:.1%} of the way: {reason}",
        remedy="ask for a shorter move or a smaller fraction_min, start from another posture, or"
        " plan without `linear`",
    )
