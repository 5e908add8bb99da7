"""Geometry and engines of one scene; a plan succeeds only if `verify` passes it.

The certificate proves from few samples that a trajectory touches nothing. On each stretch every moving pair needs a
separating plane (`minidual.proof.planes`). Unproven stretches are halved.
The audit tests the certificate by dense sampling with all collision engines, too slow for every plan.

Limits are checked between samples too, torques every 4 ms.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba.core import types

from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import ENGINES, PairDistance
from minidual.errors import UsageError
from minidual.proof import planes
from minidual.proof.solids import Solids
from minidual.robot import vectors
from minidual.robot.compiled import ROWS, floats, inlined, kernel
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array, Robot
from minidual.robot.trajectory import Trajectory

_ROUNDING = 1e-9
_REST_RAD_S = 1e-6
_TORQUE_S = 0.004
_MISFIT = 0.05  # share of the acceleration limit; plans of 300 stored queries reach 0.016


def _of(robot: Robot, trajectory: Trajectory) -> Robot:
    if trajectory.q.shape[1] != robot.dof:
        raise UsageError(
            f"the trajectory has {trajectory.q.shape[1]} joints, two {robot.arm.name} have {robot.dof}",
        )
    return robot


def limit_use(trajectory: Trajectory, kinematics: Kinematics) -> tuple[dict[str, float], str]:
    """Return the numbers of `Verification` but `samples_n`, and the first broken limit ("" if none)."""
    robot = _of(kinematics.robot, trajectory)
    h = trajectory.dt_s
    found = np.empty((8, robot.dof))
    _extremes(*(floats(x) for x in (trajectory.q, trajectory.v, trajectory.a)), h, found)
    below, above, speed, acceleration, change, jump, off_velocity, off_acceleration = found
    change = np.maximum(
        change,
        np.abs(trajectory.a[[0, -1]]).max(axis=0),
    )  # the arms rest before and after
    torques = kinematics.torque_use(
        trajectory.q,
        trajectory.v,
        trajectory.a,
        h,
        max(1, round(_TORQUE_S / h)),
    )
    shares = speed / robot.v_max, acceleration / robot.a_max, change / h / robot.jerk_max, *torques
    worst = dict(
        zip(("velocity", "acceleration", "jerk", "torque", "torque_rate"), shares, strict=True),
    )
    margin = np.minimum(-below - robot.q_lower, robot.q_upper - above)
    use = {f"{what}_ratio": float(of.max()) for what, of in worst.items()} | {
        "limit_margin_rad": float(margin.min()),
    }
    names = robot.joint_names
    if not margin.min() >= -_ROUNDING:
        joint = int(np.argmin(margin))
        return use, f"{names[joint]} leaves its position limit by {-margin.min():.4f} rad"
    for what, ratios in worst.items():
        joint = int(np.argmax(ratios))
        if not ratios[joint] <= 1.0 + _ROUNDING:
            return (
                use,
                f"{names[joint]} needs {ratios[joint]:.3f} of its {what.replace('_', ' ')} limit",
            )
    at_ends = float(np.abs(trajectory.v[[0, -1]]).max())
    if not at_ends <= _REST_RAD_S:
        return use, f"the arms still move at {at_ends:.4f} rad/s at an end"
    if not jump.max() / h <= float(robot.v_max.max()) * (1.0 + 1e-6):
        return use, f"positions jump: {jump.max() / h:.2f} rad/s between two samples"
    for what, of, off in (
        ("velocity", "positions", off_velocity),
        ("acceleration", "velocity", off_acceleration),
    ):
        joint = int(np.argmax(off / robot.a_max))
        if not off[joint] <= _MISFIT * robot.a_max[joint]:
            return (
                use,
                f"the {what} of {names[joint]} is not that of its {of}: {off[joint]:.2f} rad/s^2 off",
            )
    return use, ""


_larger = inlined(vectors.larger)


@kernel(types.void(ROWS, ROWS, ROWS, types.float64, ROWS))
def _extremes(q: Array, v: Array, a: Array, h: float, most: Array) -> None:
    """Fill (8, dof): maxima of -q, q, |v|, |a|, change of a, step of q, mismatch of v, mismatch of a [rad/s^2].

    Of the samples and of the cubics between them, whose control points contain the positions.
    """
    # The change of a (for a itself, half of it) is subtracted from the mismatch: a may jump within the step. NaN propagates.
    most[:] = -np.inf
    for i in range(len(q)):
        for j in range(q.shape[1]):
            most[0, j], most[1, j] = _larger(-q[i, j], most[0, j]), _larger(q[i, j], most[1, j])
            most[2, j], most[3, j] = (
                _larger(abs(v[i, j]), most[2, j]),
                _larger(abs(a[i, j]), most[3, j]),
            )
        for j in range(q.shape[1] if i else 0):
            rise = q[i, j] - q[i - 1, j]
            change = abs(a[i, j] - a[i - 1, j])
            mean_v = 0.5 * (v[i, j] + v[i - 1, j])
            mean_a = 0.5 * (a[i, j] + a[i - 1, j])
            gain = (v[i, j] - v[i - 1, j]) / h
            bend = abs(
                6.0 * (rise / h - mean_v) / h,
            )  # q'' is gain - bend at one end, gain + bend at the other
            for near in (q[i - 1, j] + h * v[i - 1, j] / 3.0, q[i, j] - h * v[i, j] / 3.0):
                most[0, j], most[1, j] = _larger(-near, most[0, j]), _larger(near, most[1, j])
            turn = v[i - 1, j] - (3.0 * rise / h - 2.0 * mean_v)
            at = turn / (
                2.0 * turn + h * gain
            )  # the speed is a parabola; its vertex may lie within the step
            if 0.0 < at < 1.0:
                most[2, j] = _larger(abs(v[i - 1, j] - at * turn), most[2, j])
            most[3, j], most[5, j] = (
                _larger(abs(gain) + bend, most[3, j]),
                _larger(abs(rise), most[5, j]),
            )
            most[4, j], most[6, j] = _larger(change, most[4, j]), _larger(bend - change, most[6, j])
            most[-1, j] = _larger(abs(gain - mean_a) - 0.5 * change, most[-1, j])


_SLACK_M = 2e-5  # for rounding; the engines' vertices differ by 1e-7 m
_FIRST_RAD = 0.5
"""Length of the first stretches, summed over joints."""
_STRETCHES_MAX = 256
_EVERY = 8  # samples; the length is only to divide the motion


def certify(solids: Solids, trajectory: Trajectory) -> tuple[str, int]:
    """Return the unproven pair and time, or "", and the number of stretch ends.

    Raises:
        UsageError: A trajectory of another robot.
    """
    q = floats(trajectory.q)
    v = floats(trajectory.v)
    _of(solids.robot, trajectory)
    # Joints whose samples all agree may still move between them.
    moved = ((q != q[0]) | (v != 0.0)).any(axis=0)
    moving = solids.of_arms(
        [side for side in SIDES if moved[solids.robot.groups[f"{side}_arm"]].any()],
    )
    work = solids.workspace(len(q))
    # Fixed pairs are checked once, at the start; only moving pairs afterwards.
    everything = np.arange(len(solids.pairs))
    if planes.survey(solids.geometry, q[:1], everything, solids.keep(_SLACK_M), work) == 0:
        return _refusal(solids, trajectory, [0], int(everything[0]))
    stretches = first_stretches(q, _FIRST_RAD)
    asked, failed, pair = planes.prove(
        solids.geometry,
        q,
        v,
        trajectory.dt_s,
        stretches,
        moving,
        _SLACK_M,
        work,
    )
    return (
        _refusal(solids, trajectory, [failed, failed + 1], pair)
        if failed >= 0
        else ("", int(asked.sum()))
    )


def first_stretches(q: Array, length_rad: float) -> np.ndarray:
    """Return first and last samples (s, 2) of stretches of about this length, summed over joints."""
    gone = float(np.abs(np.diff(q[::_EVERY], axis=0)).clip(max=1e6).sum())
    count = max(1, min(_STRETCHES_MAX, len(q) - 1, math.ceil(gone / length_rad)))
    ends = np.arange(count + 1) * (len(q) - 1) // count
    return np.column_stack([ends[:-1], ends[1:]])


def _refusal(
    solids: Solids,
    trajectory: Trajectory,
    samples: list[int],
    pair: int,
) -> tuple[str, int]:
    a, b = sorted(solids.pairs[pair])
    for k in samples:
        if not solids.clearance(trajectory.q[[k]], 1.0, np.array([pair])) > 0.0:
            return f"collision at {trajectory.times[k]:.3f} s: {a} and {b} touch", len(samples)
    return f"{a} and {b} could not be proven apart after {trajectory.times[samples[0]]:.3f} s", len(
        samples,
    )


STEP_RAD = 0.002
"""Largest joint step in audits."""
CLEARANCE_MAX_M = 0.04
"""Largest clearance reported."""


class Verification(NamedTuple):
    """Certificate and use of limits.

    Attributes:
        velocity_ratio, acceleration_ratio, jerk_ratio, torque_ratio, torque_rate_ratio: Largest fraction of each limit.
        limit_margin_rad: Smallest distance to a position limit.
        reason: What failed first, or "".
        samples_n: Number of stretch ends of the proof.
    """

    velocity_ratio: float
    acceleration_ratio: float
    jerk_ratio: float
    torque_ratio: float
    torque_rate_ratio: float
    limit_margin_rad: float
    ok: bool
    reason: str
    samples_n: int


class Audit(NamedTuple):
    """Result of dense sampling.

    Attributes:
        collisions_n: States in contact for any engine.
        disagreements_n: States on which engines disagree.
        clearance_m: See `SceneEngines.clearance`.
    """

    samples_n: int
    collisions_n: int
    disagreements_n: int
    clearance_m: float


class SceneEngines:
    """Geometry of one scene, built in a few ms; `step_rad`: largest joint step in audits.

    `kinematics` may be shared: making one costs 0.3 ms.
    """

    def __init__(
        self,
        scene: PlanningScene,
        step_rad: float = STEP_RAD,
        kinematics: Kinematics | None = None,
    ) -> None:
        self.scene = scene
        self.solids = Solids(scene)
        self._step_rad = step_rad
        self._kinematics = kinematics or Kinematics(scene.robot)
        self.engine: Callable[[str], Any] = functools.cache(lambda name: ENGINES[name](scene))
        """Return an engine by name, built on first use (20 ms)."""

    def closest(self, q: Array, within_m: float) -> list[PairDistance]:
        """Return checked pairs nearer than `within_m`, nearest first, from MuJoCo."""
        return [] if self.solids.free(q, within_m) else self.engine("mujoco").closest(q, within_m)

    def verify(self, trajectory: Trajectory) -> Verification:
        """Check limits and prove freedom from contact; raises what `certify` raises."""
        use, broken = limit_use(trajectory, self._kinematics)
        reason, samples_n = certify(self.solids, trajectory)
        reason = reason or broken
        return Verification(**use, ok=not reason, reason=reason, samples_n=samples_n)

    def clearance(self, trajectory: Trajectory) -> float:
        """Return the smallest distance [m] at an audit's states, at most `CLEARANCE_MAX_M`.

        Up to 0.1 mm too small, never too large.
        """
        return self.solids.clearance(collision_samples(trajectory, self._step_rad), CLEARANCE_MAX_M)

    def audit(self, trajectory: Trajectory) -> Audit:
        """Sample densely and ask all engines."""
        Q = collision_samples(trajectory, self._step_rad)
        seen = np.array([self.engine(name).collisions(Q) for name in ENGINES])
        by_any = seen.any(axis=0)
        by_all = seen.all(axis=0)
        clearance_m = self.solids.clearance(Q, CLEARANCE_MAX_M)
        return Audit(len(Q), int(by_any.sum()), int((by_any != by_all).sum()), clearance_m)


def collision_samples(trajectory: Trajectory, step_rad: float = STEP_RAD) -> Array:
    """Return configurations (n, dof) with joint steps of at most `step_rad`.

    Their times divide the integrated speed bound of the fastest joint evenly.
    """
    gone = np.concatenate(
        [[0.0], np.cumsum(trajectory.variation_rates().max(axis=1) * trajectory.dt_s)],
    )
    count = max(1, int(np.ceil(gone[-1] / step_rad)))
    times = np.interp(np.linspace(0.0, gone[-1], count + 1), gone, trajectory.times)
    times[[0, -1]] = 0.0, trajectory.duration_s
    return trajectory.sample_many(times)[0]
