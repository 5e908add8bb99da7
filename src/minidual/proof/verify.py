"""The independent proof that a timed trajectory may be driven. A plan counts as success only if this passes.

What is proven is the trajectory as it will be driven, not the path it came from: that it stays inside every limit
(`minidual.proof.limits`) and touches nothing at any time, by both engines (`minidual.proof.certificate`).

The audit is the proof's own test, too slow to be part of every plan: the trajectory is sampled so densely that no
joint moves more than 0.002 rad between two samples, and both engines are asked about each. A proven trajectory that
fails it would show the certificate wrong.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from minidual.collision.coal_engine import CoalEngine
from minidual.collision.mujoco_engine import MujocoEngine
from minidual.proof.certificate import Certificate, Certifier
from minidual.proof.limits import limit_use
from minidual.proof.solids import Solids
from minidual.robot.constants import Array
from minidual.robot.kinematics import Kinematics
from minidual.robot.trajectory import Trajectory

STEP_RAD = 0.002
"""Largest joint step between the samples of an audit."""
CLEARANCE_MAX_M = 0.04
"""Pairs farther apart than this count as this far apart."""


@dataclass(frozen=True)
class Verification:
    """What the proof found.

    ok: Nothing touches at any time, by both engines, and every limit holds.
    reason: Empty if ok, else what failed first, with names and numbers.
    samples_n: States at which a stretch of the proof ends; both engines were asked about each.
    disagreements_n: Of these, the states that one engine sees colliding and the other free.
    unproven_n: 1 if some stretch of the motion could not be proven free.
    velocity_ratio, acceleration_ratio, jerk_ratio, torque_ratio: Largest fraction of the robot's limits used.
    limit_margin_rad: Smallest distance of a joint from its position limit.
    """

    ok: bool
    reason: str
    samples_n: int
    disagreements_n: int
    unproven_n: int
    velocity_ratio: float
    acceleration_ratio: float
    jerk_ratio: float
    torque_ratio: float
    limit_margin_rad: float

    def to_json(self) -> dict[str, Any]:
        """Return the report as plain data."""
        return asdict(self)


@dataclass(frozen=True)
class Audit:
    """What dense sampling found on a trajectory.

    samples_n: States asked of both engines.
    step_max_rad: Largest joint step between two of them.
    collisions_n: States that at least one engine sees colliding.
    disagreements_n: States that only one engine sees colliding.
    clearance_m: Smallest distance at these states, see `Verifier.clearance`.
    """

    samples_n: int
    step_max_rad: float
    collisions_n: int
    disagreements_n: int
    clearance_m: float


class Verifier:
    """Proves trajectories in one scene.

    Args:
        primary: MuJoCo engine of the scene.
        second: coal engine of the same scene.
        solids: Solids of the same scene.
        step_rad: Largest joint step between the samples of an audit, at most 0.002.
    """

    def __init__(self, primary: MujocoEngine, second: CoalEngine, solids: Solids, step_rad: float = STEP_RAD) -> None:
        self._primary = primary
        self._second = second
        self._certifier = Certifier(primary, second, solids)
        self._solids = solids
        self._step_rad = step_rad
        self._kinematics = Kinematics()

    def verify(self, trajectory: Trajectory) -> Verification:
        """Return the report on one trajectory; it never raises for a bad one."""
        use, broken = limit_use(trajectory, self._kinematics)
        proof = self.certify(trajectory)
        reason = proof.reason or broken
        return Verification(
            ok=not reason,
            reason=reason,
            samples_n=proof.samples_n,
            disagreements_n=proof.disagreements_n,
            unproven_n=proof.unproven_n,
            **asdict(use),
        )

    def certify(self, trajectory: Trajectory) -> Certificate:
        """Return the proof that nothing touches, without the limits."""
        return self._certifier.certify(trajectory)

    def clearance(self, trajectory: Trajectory) -> float:
        """Return the smallest distance [m] along a trajectory, where no joint moves more than the step of an audit.

        It is not more than the true one at these states and at most a tenth of a millimetre less; `CLEARANCE_MAX_M` where
        everything is farther apart.
        """
        return self._solids.clearance(collision_samples(trajectory, self._step_rad), CLEARANCE_MAX_M)

    def audit(self, trajectory: Trajectory) -> Audit:
        """Return what dense sampling says; for a proven trajectory it must find nothing."""
        Q = collision_samples(trajectory, self._step_rad)
        first, second = self._primary.collisions(Q), self._second.collisions(Q)
        return Audit(
            samples_n=len(Q),
            step_max_rad=float(np.abs(np.diff(Q, axis=0)).max(initial=0.0)),
            collisions_n=int(np.sum(first | second)),
            disagreements_n=int(np.sum(first != second)),
            clearance_m=self._solids.clearance(Q, CLEARANCE_MAX_M),
        )


def collision_samples(trajectory: Trajectory, step_rad: float = STEP_RAD) -> Array:
    """Return configurations (n, 14) along the trajectory, no joint moving more than step_rad between two.

    The largest speed that any joint can have in each step of the trajectory bounds how far it gets; equal shares of
    the sum of that give the times.
    """
    fastest = trajectory.variation_rates().max(axis=1) * trajectory.dt_s
    gone = np.concatenate([[0.0], np.cumsum(fastest)])
    count = int(np.ceil(gone[-1] / step_rad))
    if count == 0:
        return trajectory.q[[0, -1]]
    times = np.interp(np.linspace(0.0, gone[-1], count + 1), gone, trajectory.times)
    times[[0, -1]] = 0.0, trajectory.duration_s
    return trajectory.positions(times)
