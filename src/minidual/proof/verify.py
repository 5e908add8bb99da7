"""The independent proof that a timed trajectory may be driven. A plan counts as success only if this passes.

What is proven is the trajectory as it will be driven: that it stays inside every limit (`minidual.proof.limits`) and
touches nothing at any time (`minidual.proof.certificate`).

The audit tests the proof and is too slow for every plan: it samples the trajectory so densely that no joint moves more
than 0.002 rad between two samples and asks two collision engines about each. A proven trajectory that fails it shows the
certificate wrong.
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
"""Largest joint step between the samples of an audit."""
CLEARANCE_MAX_M = 0.04
"""Pairs farther apart than this count as this far apart."""


@dataclass(frozen=True)
class Verification:
    """What the proof found.

    ok: Nothing touches at any time and every limit holds.
    reason: Empty if ok, else what failed first, with names and numbers.
    samples_n: States at which a stretch of the proof ends.
    velocity_ratio, acceleration_ratio, jerk_ratio, torque_ratio: Largest fraction of the robot's limits used.
    limit_margin_rad: Smallest distance of a joint from its position limit.
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
        scene: The scene.
        solids: Its solids.
        step_rad: Largest joint step between the samples of an audit, at most 0.002.
    """

    def __init__(self, scene: PlanningScene, solids: Solids, step_rad: float = STEP_RAD) -> None:
        self._scene = scene
        self._solids = solids
        self._step_rad = step_rad
        self._kinematics = Kinematics(scene.robot)
        self._engines: dict[str, CollisionEngine] = {}

    def verify(self, trajectory: Trajectory) -> Verification:
        """Return the report on one trajectory; it never raises for a bad one."""
        use, broken = limit_use(trajectory, self._kinematics)
        proof = self.certify(trajectory)
        reason = proof.reason or broken
        return Verification(ok=not reason, reason=reason, samples_n=proof.samples_n, **asdict(use))

    def certify(self, trajectory: Trajectory) -> Certificate:
        """Return the proof that nothing touches, without the limits."""
        return certify(self._solids, trajectory)

    def clearance(self, trajectory: Trajectory) -> float:
        """Return the smallest distance [m] along a trajectory, where no joint moves more than the step of an audit.

        It is not more than the true one at these states and at most a tenth of a millimetre less; `CLEARANCE_MAX_M` where
        everything is farther apart.
        """
        return self._solids.clearance(collision_samples(trajectory, self._step_rad), CLEARANCE_MAX_M)

    def engine(self, name: str) -> Any:
        """Return the collision engine of this name for the scene, built at the first call (about 20 ms)."""
        if name not in self._engines:
            self._engines[name] = ENGINES[name](self._scene)
        return self._engines[name]

    def audit(self, trajectory: Trajectory) -> Audit:
        """Return what dense sampling says; for a proven trajectory it must find nothing."""
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
    """Return configurations (n, dof) along the trajectory, no joint moving more than step_rad between two.

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
    return trajectory.sample_many(times)[0]
