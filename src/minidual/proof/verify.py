"""Verification of timed trajectories; a plan succeeds only if it passes.

The audit tests the certificate by dense sampling with two collision engines, too slow for every plan. A verified
trajectory that fails an audit shows an error in the certificate.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from minidual.collision.engine import ENGINES, CollisionEngine
from minidual.collision.scene import PlanningScene
from minidual.proof.certificate import Certificate, certify
from minidual.proof.limits import limit_use
from minidual.proof.solids import Solids
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.robot.trajectory import Trajectory

STEP_RAD = 0.002
"""Largest joint step in audits."""
CLEARANCE_MAX_M = 0.04
"""Larger distances count as this."""


@dataclass(frozen=True)
class Verification:
    """Result of verification.

    Attributes:
        reason: The first failure, if any.
        velocity_ratio, acceleration_ratio, jerk_ratio, torque_ratio: Largest fractions of limits.
        limit_margin_rad: Smallest distance from position limits.
    """

    ok: bool
    reason: str
    samples_n: int
    velocity_ratio: float
    acceleration_ratio: float
    jerk_ratio: float
    torque_ratio: float
    limit_margin_rad: float

    def to_json(self) -> dict[str, Any]:
        """Return plain data."""
        return asdict(self)


@dataclass(frozen=True)
class Audit:
    """Result of dense sampling.

    Attributes:
        collisions_n: States in contact for any engine.
        disagreements_n: States with disagreement.
        clearance_m: See `Verifier.clearance`.
    """

    samples_n: int
    step_max_rad: float
    collisions_n: int
    disagreements_n: int
    clearance_m: float


class Verifier:
    """Proves trajectories in one scene; `step_rad` is an audit's largest joint step."""

    def __init__(self, scene: PlanningScene, solids: Solids, step_rad: float = STEP_RAD) -> None:
        self._scene = scene
        self._solids = solids
        self._step_rad = step_rad
        self._kinematics = Kinematics(scene.robot)
        self._engines: dict[str, CollisionEngine] = {}

    def verify(self, trajectory: Trajectory) -> Verification:
        """Return the report; bad trajectories raise nothing."""
        use, broken = limit_use(trajectory, self._kinematics)
        proof = self.certify(trajectory)
        reason = proof.reason or broken
        return Verification(ok=not reason, reason=reason, samples_n=proof.samples_n, **asdict(use))

    def certify(self, trajectory: Trajectory) -> Certificate:
        """Prove freedom from contact only."""
        return certify(self._solids, trajectory)

    def clearance(self, trajectory: Trajectory) -> float:
        """Return the smallest distance [m] at an audit's states, at most `CLEARANCE_MAX_M`.

        At most 0.1 mm too small, never too large.
        """
        return self._solids.clearance(collision_samples(trajectory, self._step_rad), CLEARANCE_MAX_M)

    def engine(self, name: str) -> Any:
        """Return an engine, built on first use (20 ms)."""
        if name not in self._engines:
            self._engines[name] = ENGINES[name](self._scene)
        return self._engines[name]

    def audit(self, trajectory: Trajectory) -> Audit:
        """Sample densely; a proven trajectory must give no collisions."""
        Q = collision_samples(trajectory, self._step_rad)
        seen = np.array([self.engine(name).collisions(Q) for name in ENGINES])
        return Audit(
            samples_n=len(Q),
            step_max_rad=float(np.abs(np.diff(Q, axis=0)).max(initial=0.0)),
            collisions_n=int(np.sum(seen.any(axis=0))),
            disagreements_n=int(np.sum(seen.any(axis=0) != seen.all(axis=0))),
            clearance_m=self._solids.clearance(Q, CLEARANCE_MAX_M),
        )


def collision_samples(trajectory: Trajectory, step_rad: float = STEP_RAD) -> Array:
    """Return configurations (n, dof) with joint steps of at most `step_rad`.

    Times divide the integrated bound on the fastest joint evenly.
    """
    fastest = trajectory.variation_rates().max(axis=1) * trajectory.dt_s
    gone = np.concatenate([[0.0], np.cumsum(fastest)])
    count = int(np.ceil(gone[-1] / step_rad))
    if count == 0:
        return trajectory.q[[0, -1]]
    times = np.interp(np.linspace(0.0, gone[-1], count + 1), gone, trajectory.times)
    times[[0, -1]] = 0.0, trajectory.duration_s
    return trajectory.sample_many(times)[0]
