"""The independent proof that a timed trajectory may be driven. A plan counts as success only if this passes.

The trajectory is re-sampled as it will be driven (not the path it came from), at most `step_rad` of any joint apart,
and every sample is asked of both engines. Between two samples the MuJoCo distances at both ends, compared with a
bound on how far the parts can have moved, prove the gap free; an interval that this cannot settle is halved.
Position, velocity, acceleration and torque are checked at every millisecond and half-way between.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from minidual.planning.coal_engine import CoalEngine
from minidual.planning.motion_bound import MotionBound
from minidual.planning.mujoco_engine import MujocoEngine, PairDistance
from minidual.planning.trajectory import Trajectory
from minidual.robot.constants import A_MAX, JOINT_NAMES, Q_LOWER, Q_UPPER, TAU_MAX, V_MAX, Array
from minidual.robot.kinematics import Kinematics

STEP_RAD = 0.002
"""Largest joint step between collision checks."""
_MARGIN_M = 0.006
_HALVINGS_MAX = 12
_TORQUE_EVERY = 2
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Verification:
    """What the proof found.

    ok: Nothing touches, both engines agree, the gaps between samples are proven, every limit holds.
    reason: Empty if ok, else what failed first, with names and numbers.
    samples_n: Collision samples asked of both engines.
    step_max_rad: Largest joint step between two of them.
    disagreements_n: Samples on which the engines differ.
    unproven_n: Intervals that bisection could not prove free.
    clearance_m: Smallest distance seen, at most `_MARGIN_M` (pairs farther apart are not measured).
    velocity_ratio, acceleration_ratio, torque_ratio: Largest fraction of the robot's limits used.
    limit_margin_rad: Smallest distance of a joint from its position limit.
    """

    ok: bool
    reason: str
    samples_n: int
    step_max_rad: float
    disagreements_n: int
    unproven_n: int
    clearance_m: float
    velocity_ratio: float
    acceleration_ratio: float
    torque_ratio: float
    limit_margin_rad: float

    def to_json(self) -> dict[str, Any]:
        """Return the report as plain data."""
        return asdict(self)


class Verifier:
    """Proves trajectories in one scene.

    Args:
        primary: MuJoCo engine of the scene.
        second: coal engine of the same scene.
        bound: Motion bound of the same scene.
        kinematics: For inverse dynamics.
        step_rad: Largest joint step between collision checks, at most 0.002.
    """

    def __init__(
        self,
        primary: MujocoEngine,
        second: CoalEngine,
        bound: MotionBound,
        kinematics: Kinematics,
        step_rad: float = STEP_RAD,
    ) -> None:
        self._primary = primary
        self._second = second
        self._bound = bound
        self._kinematics = kinematics
        self._step_rad = step_rad

    def verify(self, trajectory: Trajectory) -> Verification:
        """Return the report on one trajectory; it never raises for a bad one."""
        ratios, limit_reason = self._limits(trajectory)
        Q = collision_samples(trajectory, self._step_rad)
        step_max = float(np.abs(np.diff(Q, axis=0)).max(initial=0.0))
        nearest = [self._near(q) for q in Q]
        first = np.array([bool(n) and n[0].distance_m <= 0.0 for n in nearest])
        second = self._second.collisions(Q)
        clearance = min((n[0].distance_m for n in nearest if n), default=_MARGIN_M)
        unproven = self._unproven(Q, nearest) if not (first.any() or second.any()) else 0
        reason = limit_reason
        if second.any() and not first.any():
            reason = (
                f"coal sees a collision at sample {int(np.argmax(second))} of {len(Q)} where MuJoCo sees none"
            )
        if first.any():
            k = int(np.argmax(first))
            reason = f"collision at sample {k} of {len(Q)}: {nearest[k][0]}"
        if not reason and unproven:
            reason = f"{unproven} of {len(Q) - 1} intervals between samples could not be proven free"
        if not reason and step_max > STEP_RAD * (1.0 + 1e-6):
            reason = f"samples are {step_max:.5f} rad apart; the proof needs <= {STEP_RAD} rad"
        return Verification(
            ok=not reason,
            reason=reason,
            samples_n=len(Q),
            step_max_rad=step_max,
            disagreements_n=int(np.sum(first != second)),
            unproven_n=unproven,
            clearance_m=clearance,
            **ratios,
        )

    def _near(self, q: Array) -> list[PairDistance]:
        self._primary.set_margin(_MARGIN_M)
        return self._primary.contacts() if self._primary.contact_count(q) else []

    def _unproven(self, Q: Array, nearest: list[list[PairDistance]]) -> int:
        """Return how many intervals between neighbouring samples stay unproven."""
        approach = self._bound.largest(np.diff(Q, axis=0))
        count = 0
        for k, largest in enumerate(approach):
            if not nearest[k] and not nearest[k + 1] and largest < 2.0 * _MARGIN_M:
                continue
            count += not self._proven(Q[k], Q[k + 1], nearest[k], nearest[k + 1], _HALVINGS_MAX)
        return count

    def _proven(
        self, a: Array, b: Array, near_a: list[PairDistance], near_b: list[PairDistance], halvings: int
    ) -> bool:
        """Return whether the straight line from a to b is free, by distances at both ends and the motion bound.

        A pair that is d_a apart at a and d_b at b stays apart if it can approach by less than d_a + d_b in all.
        """
        step = b - a
        d_a = {(p.first, p.second): p.distance_m for p in near_a}
        d_b = {(p.first, p.second): p.distance_m for p in near_b}
        pairs = d_a.keys() | d_b.keys()
        if any(min(d_a.get(p, _MARGIN_M), d_b.get(p, _MARGIN_M)) <= 0.0 for p in pairs):
            return False
        settled = self._bound.largest(step[None, :])[0] < 2.0 * _MARGIN_M and all(
            self._bound.of_pair(p, step) < d_a.get(p, _MARGIN_M) + d_b.get(p, _MARGIN_M) for p in pairs
        )
        if settled:
            return True
        if halvings == 0:
            return False
        middle = 0.5 * (a + b)
        near = self._near(middle)
        return self._proven(a, middle, near_a, near, halvings - 1) and self._proven(
            middle, b, near, near_b, halvings - 1
        )

    def _limits(self, trajectory: Trajectory) -> tuple[dict[str, float], str]:
        """Return the ratios and the first broken limit ("" if none)."""
        half = 0.5 * trajectory.dt_s
        times = np.arange(2 * len(trajectory.times) - 1) * half
        q, v, a = trajectory.sample_many(times)
        # The torque changes slowly against the sampling; every second of the half-millisecond samples is 1 kHz.
        tau = np.array([
            self._kinematics.rnea(q[k], v[k], a[k]) for k in range(0, len(times), _TORQUE_EVERY)
        ])  # fmt: skip
        margin = np.minimum(q - Q_LOWER, Q_UPPER - q)
        ratios = {
            "velocity_ratio": float(np.max(np.abs(v) / V_MAX)),
            "acceleration_ratio": float(np.max(np.abs(a) / A_MAX)),
            "torque_ratio": float(np.max(np.abs(tau) / TAU_MAX)),
            "limit_margin_rad": float(margin.min()),
        }
        at_ends = float(max(np.abs(v[0]).max(), np.abs(v[-1]).max()))
        if margin.min() < -_ROUNDING:
            joint = int(np.argmin(margin.min(axis=0)))
            return ratios, f"{JOINT_NAMES[joint]} leaves its position limit by {-margin.min():.4f} rad"
        for what, values, limit in (
            ("velocity", v, V_MAX),
            ("acceleration", a, A_MAX),
            ("torque", tau, TAU_MAX),
        ):
            worst = (np.abs(values) / limit).max(axis=0)
            joint = int(np.argmax(worst))
            if worst[joint] > 1.0 + _ROUNDING:
                return ratios, f"{JOINT_NAMES[joint]} needs {worst[joint]:.3f} of its {what} limit"
        if at_ends > 1e-6:
            return ratios, f"the arms still move at {at_ends:.4f} rad/s at an end"
        jump = float(np.abs(np.diff(trajectory.q, axis=0)).max()) / trajectory.dt_s
        if jump > float(V_MAX.max()) * (1.0 + 1e-6):
            return ratios, f"positions jump: {jump:.2f} rad/s between two samples"
        return ratios, ""


def collision_samples(trajectory: Trajectory, step_rad: float = STEP_RAD) -> Array:
    """Return configurations (n, 14) along the trajectory, no joint moving more than step_rad between two.

    The largest joint step is summed over half milliseconds; equal shares of that sum give the times.
    """
    times = np.arange(2 * len(trajectory.times) - 1) * (0.5 * trajectory.dt_s)
    q, _, _ = trajectory.sample_many(times)
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q, axis=0)).max(axis=1))])
    # Within half a millisecond the speed is taken as constant: the reserve covers what acceleration changes.
    count = int(np.ceil(travelled[-1] / (0.97 * step_rad)))
    if count == 0:
        return q[[0, -1]]
    picks = np.interp(np.linspace(0.0, travelled[-1], count + 1), travelled, times)
    Q, _, _ = trajectory.sample_many(picks)
    return Q
