"""Straight tcp motion, until a pose is out of reach, an arm would jump, or something collides."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from minidual.collision.errors import LinearMoveError
from minidual.config.planning import MotionLimits
from minidual.motion.held.path import ROTATION_WEIGHT_M
from minidual.motion.ik import check_joints, check_targets, require_free, solvers
from minidual.motion.timing import DT_S, PathLimits, resting, time_path
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
_STILL_M = 1e-9


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
        self.length_m = float(
            np.hypot(np.linalg.norm(self._shift), ROTATION_WEIGHT_M * np.linalg.norm(self._turn)),
        )
        """Includes rotation, weighted."""

    def at(self, x: float) -> Array:
        """Return T_world_tcp (4, 4) at x in 0..1."""
        return pose(
            self._start[:3, :3] @ pin.exp3(x * self._turn),
            self._start[:3, 3] + x * self._shift,
        )

    def off(self, T: Array, x: float) -> tuple[float, float]:
        """Return the distance from the line [m] and from the orientation at x [rad]."""
        moved = T[:3, 3] - self._start[:3, 3]
        length = float(np.linalg.norm(self._shift))
        along = (
            self._shift * float(moved @ self._shift) / length**2
            if length > _STILL_M
            else np.zeros(3)
        )
        angle = float(np.linalg.norm(pin.log3(self.at(x)[:3, :3].T @ T[:3, :3])))
        return float(np.linalg.norm(moved - along)), angle


class _Curve:
    """Columns over s [m]: joints and s."""

    def __init__(self, marks: Array, Q: Array) -> None:
        self._spline = CubicSpline(marks, Q, bc_type="natural")
        self.length = float(marks[-1])
        self.knots = marks[[0, -1]]

    def at(self, s: Array, order: int = 0) -> Array:
        return np.column_stack(
            [self._spline(s, order), (s, np.ones_like(s), np.zeros_like(s))[order]],
        )


class LinearPlanner:
    """Plans straight tcp moves. One instance per process."""

    def __init__(
        self,
        limits: MotionLimits | None = None,
        kinematics: Kinematics | None = None,
    ) -> None:
        self._kinematics = kinematics or Kinematics()
        self._robot = self._kinematics.robot
        self._ik = solvers(self._robot)
        self._limits = limits or MotionLimits()

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
        """Return the straight move from q_start (n,) to {arm: T_world_tcp (4, 4)}; tcps end together.

        Raises:
            LinearMoveError, TimingError: It covers less than `fraction_min`, deviates, or is not proven.
            UsageError, OutOfLimitsError, StartInCollisionError: Bad query.
        """
        checked = check_targets(group, targets)
        q_start = check_joints(q_start, "start", self._robot)
        require_free(engines, q_start, "start")
        tips = dict(zip(SIDES, self._kinematics.tcp_poses(q_start), strict=True))
        lines = {arm: Line(tips[arm], T) for arm, T in checked.items()}
        length = max(line.length_m for line in lines.values())
        if length < _STILL_M:
            still = resting(q_start, DT_S, group)
            if not (proof := engines.verify(still)).ok:
                raise _cut_short(group, 1.0, f"staying there is not proven: {proof.reason}")
            return LinearMove(still, proof)
        for refinement in range(_REFINEMENTS):
            count = max(8, int(np.ceil(length / (_STEP_M * 0.5**refinement))))
            marks = np.linspace(0.0, length, count + 1, dtype=np.float64)
            Q, reason = self._follow(q_start, lines, engines, marks)
            move, way = self._timed(group, marks, Q, reason, engines, limits or TIP_LIMITS)
            off_m, off_rad = self._deviation(move.trajectory, way / length, lines)
            if off_m < DEVIATION_MAX_M and off_rad < DEVIATION_MAX_RAD:
                if move.fraction < fraction_min:
                    raise _cut_short(group, move.fraction, move.reason)
                return move
        strays = f"between its points the straight move strays {off_m * 1e3:.3f} mm and {off_rad:.5f} rad"
        allowed = f"allowed are {DEVIATION_MAX_M * 1e3} mm and {DEVIATION_MAX_RAD} rad"
        raise LinearMoveError(
            f"{strays}; {allowed}",
            remedy="start from a posture farther from a singularity",
        )

    def _follow(
        self,
        q0: Array,
        lines: Mapping[str, Line],
        engines: SceneEngines,
        marks: Array,
    ) -> tuple[Array, str]:
        Q = [q0]
        for mark in marks[1:]:
            q = Q[-1].copy()
            for arm, line in lines.items():
                ik = self._ik[arm]
                solution = ik.solve(line.at(float(mark / marks[-1])), q[ik.joints])
                jump = float(np.abs(solution.q - q[ik.joints]).max())
                if not solution.reached:
                    return np.array(Q), f"the {arm} hand cannot go on: it stays {solution.off} away"
                if jump > _JUMP_MAX_RAD:
                    why = f"would jump by {jump:.2f} rad within {marks[1] * 1e3:.1f} mm"
                    return np.array(Q), f"the {arm} arm {why} (a joint limit or a singular posture)"
                q[ik.joints] = solution.q
            near = engines.closest(q, 0.001)
            if near and near[0].distance_m <= 0.0:
                return np.array(Q), f"collision: {near[0]}"
            Q.append(q)
        return np.array(Q), ""

    def _timed(
        self,
        group: str,
        marks: Array,
        Q: Array,
        reason: str,
        engines: SceneEngines,
        limits: PathLimits,
    ) -> tuple[LinearMove, Array]:
        for back_off in range(_BACK_OFFS):
            keep = len(Q) - 2**back_off + 1
            if keep < 4:
                break
            trajectory, way = time_path(
                _Curve(marks[:keep], Q[:keep]),
                group,
                self._limits,
                self._kinematics,
                limits,
            )
            if (proof := engines.verify(trajectory)).ok:
                return LinearMove(
                    trajectory,
                    proof,
                    float(marks[keep - 1] / marks[-1]),
                    reason,
                ), way
            reason = reason or f"the proof refuses the rest: {proof.reason}"
        raise _cut_short(group, 0.0, reason or "there is no room to begin")

    def _deviation(
        self,
        trajectory: Trajectory,
        way: Array,
        lines: Mapping[str, Line],
    ) -> tuple[float, float]:
        rows = np.unique(np.append(np.arange(0, len(way), 5), len(way) - 1))
        hands = [(line, self._ik[arm]) for arm, line in lines.items()]
        off = [
            line.off(ik.tcp_pose(trajectory.q[k, ik.joints]), float(way[k]))
            for k in rows
            for line, ik in hands
        ]
        return tuple(np.max(off, axis=0).tolist())


def _cut_short(group: str, fraction: float, reason: str) -> LinearMoveError:
    what = f"the straight move of {group} ends at {fraction:.1%} of the way: {reason}"
    remedy = "ask for a shorter move or a smaller fraction_min, start from another posture, or plan without `linear`"
    return LinearMoveError(what, remedy=remedy)
