"""Geometry and engines of one scene; a plan succeeds only if `verify` passes it.

The audit tests the certificate by dense sampling with all collision engines, too slow for every plan: a collision on a
verified trajectory is an error of the certificate.
"""

import functools
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from minidual.collision.engine import ENGINES, PairDistance
from minidual.collision.scene import PlanningScene
from minidual.proof.certificate import Certificate, certify
from minidual.proof.limits import LimitUse, limit_use
from minidual.proof.solids import Solids
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.robot.trajectory import Trajectory

STEP_RAD = 0.002
"""Largest joint step in audits."""
CLEARANCE_MAX_M = 0.04
"""Largest clearance reported."""


@dataclass(frozen=True)
class Verification(LimitUse, Certificate):
    """Certificate and use of limits; `reason` tells what failed first, or ""."""


@dataclass(frozen=True)
class Audit:
    """Result of dense sampling.

    Attributes:
        collisions_n: States in contact for any engine.
        disagreements_n: States on which engines disagree.
        clearance_m: See `SceneEngines.clearance`.
    """

    samples_n: int
    step_max_rad: float
    collisions_n: int
    disagreements_n: int
    clearance_m: float


class SceneEngines:
    """Geometry of one scene, built in a few ms; `step_rad`: largest joint step in audits.

    `kinematics` may be shared: making one costs 0.3 ms.
    """

    def __init__(self, scene: PlanningScene, step_rad: float = STEP_RAD, kinematics: Kinematics | None = None) -> None:
        self.scene = scene
        self.solids = Solids(scene)
        self._step_rad = step_rad
        self._kinematics = kinematics or Kinematics(scene.robot)
        self.engine: Callable[[str], Any] = functools.cache(lambda name: ENGINES[name](scene))
        """Return an engine by name, built on first use (20 ms)."""

    def in_collision(self, q: Array) -> bool:
        """Return whether parts touch or cannot be proven apart."""
        return not self.solids.free(q)

    def closest(self, q: Array, within_m: float) -> list[PairDistance]:
        """Return checked pairs nearer than `within_m`, nearest first, from MuJoCo."""
        return [] if self.solids.free(q, within_m) else self.engine("mujoco").closest(q, within_m)

    def verify(self, trajectory: Trajectory) -> Verification:
        """Check limits and prove freedom from contact; never raises."""
        use, broken = limit_use(trajectory, self._kinematics)
        proof = certify(self.solids, trajectory)
        reason = proof.reason or broken
        return Verification(not reason, reason, proof.samples_n, **asdict(use))

    def clearance(self, trajectory: Trajectory) -> float:
        """Return the smallest distance [m] at an audit's states, at most `CLEARANCE_MAX_M`.

        Up to 0.1 mm too small, never too large.
        """
        return self.solids.clearance(collision_samples(trajectory, self._step_rad), CLEARANCE_MAX_M)

    def audit(self, trajectory: Trajectory) -> Audit:
        """Sample densely and ask all engines."""
        Q = collision_samples(trajectory, self._step_rad)
        seen = np.array([self.engine(name).collisions(Q) for name in ENGINES])
        return Audit(
            samples_n=len(Q),
            step_max_rad=float(np.abs(np.diff(Q, axis=0)).max(initial=0.0)),
            collisions_n=int(np.sum(seen.any(axis=0))),
            disagreements_n=int(np.sum(seen.any(axis=0) != seen.all(axis=0))),
            clearance_m=self.solids.clearance(Q, CLEARANCE_MAX_M),
        )


def collision_samples(trajectory: Trajectory, step_rad: float = STEP_RAD) -> Array:
    """Return configurations (n, dof) with joint steps of at most `step_rad`.

    Their times divide the integrated speed bound of the fastest joint evenly.
    """
    fastest = trajectory.variation_rates().max(axis=1) * trajectory.dt_s
    gone = np.concatenate([[0.0], np.cumsum(fastest)])
    count = int(np.ceil(gone[-1] / step_rad))
    if count == 0:
        return trajectory.q[[0, -1]]
    times = np.interp(np.linspace(0.0, gone[-1], count + 1), gone, trajectory.times)
    times[[0, -1]] = 0.0, trajectory.duration_s
    return trajectory.sample_many(times)[0]
