"""Geometry and engines of one scene; a plan succeeds only if `verify` passes it.

`verify` needs the certificate (`minidual.proof.certificate`) and the limits
(`minidual.proof.limits`). The audit tests the certificate by dense sampling with all collision
engines, too slow for every plan.
"""

import functools
from collections.abc import Callable, Collection
from typing import Any, NamedTuple

import numpy as np

from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import ENGINES, PairDistance
from minidual.proof.certificate import certify
from minidual.proof.limits import limit_use
from minidual.proof.solids import Solids
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.robot.trajectory import Trajectory

STEP_RAD = 0.002
"""Largest joint step in audits."""
CLEARANCE_MAX_M = 0.04
"""Largest clearance reported."""


class Verification(NamedTuple):
    """Certificate and use of limits.

    Attributes:
        velocity_ratio, acceleration_ratio, jerk_ratio, torque_ratio, torque_rate_ratio: Largest
            fraction of each limit.
        limit_margin_rad: Smallest distance to a position limit.
        reason: What failed first, or "".
        samples_n: Number of stretch ends of the proof.
        reported_only: Limits whose use is reported and not required: "jerk", "torque_rate".
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
    reported_only: tuple[str, ...] = ()


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
        """Return checked pairs nearer than `within_m` at q (dof,), nearest first, from MuJoCo."""
        if self.solids.free(q, within_m):
            return []
        return self.engine("mujoco").closest(q, within_m)

    def verify(self, trajectory: Trajectory, reported_only: Collection[str] = ()) -> Verification:
        """Check limits and prove freedom from contact.

        `reported_only` names limits that the trajectory's timing engine does not keep.

        Raises:
            UsageError: A trajectory of another robot.
        """
        use = limit_use(trajectory, self._kinematics, reported_only)
        certificate = certify(self.solids, trajectory)
        reason = certificate.reason or use.broken
        return Verification(
            velocity_ratio=use.velocity_ratio,
            acceleration_ratio=use.acceleration_ratio,
            jerk_ratio=use.jerk_ratio,
            torque_ratio=use.torque_ratio,
            torque_rate_ratio=use.torque_rate_ratio,
            limit_margin_rad=use.limit_margin_rad,
            ok=not reason,
            reason=reason,
            samples_n=certificate.samples_n,
            reported_only=tuple(reported_only),
        )

    def clearance(self, trajectory: Trajectory) -> float:
        """Return the smallest distance [m] at an audit's states, at most `CLEARANCE_MAX_M`.

        Up to 0.1 mm too small, never too large.
        """
        return self.solids.clearance(collision_samples(trajectory, self._step_rad), CLEARANCE_MAX_M)

    def audit(self, trajectory: Trajectory) -> Audit:
        """Sample densely and ask all engines."""
        Q = collision_samples(trajectory, self._step_rad)
        contacts = np.array([self.engine(name).collisions(Q) for name in ENGINES])
        by_any = contacts.any(axis=0)
        by_all = contacts.all(axis=0)
        return Audit(
            samples_n=len(Q),
            collisions_n=int(by_any.sum()),
            disagreements_n=int((by_any != by_all).sum()),
            clearance_m=self.solids.clearance(Q, CLEARANCE_MAX_M),
        )


def collision_samples(trajectory: Trajectory, step_rad: float = STEP_RAD) -> Array:
    """Return configurations (n, dof) with joint steps of at most `step_rad`.

    Their times divide the integrated speed bound of the fastest joint evenly.
    """
    fastest = trajectory.variation_rates().max(axis=1)
    way = np.concatenate([[0.0], np.cumsum(fastest * trajectory.dt_s)])
    count = max(1, int(np.ceil(way[-1] / step_rad)))
    times = np.interp(np.linspace(0.0, way[-1], count + 1), way, trajectory.times)
    times[0] = 0.0
    times[-1] = trajectory.duration_s
    return trajectory.sample_many(times)[0]
