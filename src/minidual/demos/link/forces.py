"""Forces that a link carries: of leaders with joints, and of leaders with hand poses."""

from dataclasses import replace
from typing import Protocol

import numpy as np

from minidual.demos.leader import Feedback, LeaderSample
from minidual.demos.link.ports import Bounds, power
from minidual.demos.link.spaces import Coordinates, HandPoses, Space
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot

_LEAST_NM = 2.0
_LEAST_N = 3.0
"""Torques of an arm, and forces of a hand, that are noise of the observer of contacts."""
_DAMPED = 1e-3
"""Damping of the hands' Jacobians, for torques near a singularity."""


class Forces(Protocol):
    """Places of a leader, and the forces that go with their motion.

    Attributes:
        space: Of the places.
        bounds: Of the link's controllers.
    """

    space: Space
    bounds: Bounds

    def place_at(self, q: Array) -> Array:
        """Return the place (1, P) of arms at joints (n,) [rad]."""
        ...

    def place_of(self, sample: LeaderSample) -> Array:
        """Return the place (1, P) of a leader."""
        ...

    def sample_at(self, place: Array, sample: LeaderSample) -> LeaderSample:
        """Return a reading as if the leader were at a place (1, P)."""
        ...

    def towards_reference(self, feedback: Feedback) -> Array:
        """Return the contact force (1, G, n) of the arms on their surroundings."""
        ...

    def torques(self, forces: Array, q: Array) -> Array:
        """Return the torques (n,) [Nm] of forces (1, G, n) on arms at joints (n,) [rad]."""
        ...


def _beyond(force: Array, least: Array | float) -> Array:
    """Return forces (..., n) without the part that may be noise of their estimate."""
    size = np.sqrt(power(force, force))
    share = np.maximum(size - least, 0.0) / np.maximum(size, 1e-12)
    return share[..., None] * force


class JointForces:
    """Joints, with an energy for each arm."""

    bounds = Bounds(
        inertia=1.0,
        damping=10.0,
        speed=0.3,
        yielding=0.05,
        drift_speed=0.5,
        slack_j=0.02,
    )

    def __init__(self, robot: Robot) -> None:
        self.space: Space = Coordinates(
            tuple(f"{side} arm" for side in robot.sides), robot.dof_per_arm
        )
        self._shape = (1, len(robot.sides), robot.dof_per_arm)

    def place_at(self, q: Array) -> Array:
        """See `Forces`."""
        return np.array(q, dtype=float)[None]

    def place_of(self, sample: LeaderSample) -> Array:
        """See `Forces`."""
        return np.asarray(sample.q, dtype=float)[None]

    def sample_at(self, place: Array, sample: LeaderSample) -> LeaderSample:
        """See `Forces`."""
        return replace(sample, q=place[0].copy())

    def towards_reference(self, feedback: Feedback) -> Array:
        """See `Forces`."""
        return _beyond(-feedback.met_nm.reshape(self._shape), _LEAST_NM)

    def torques(self, forces: Array, q: Array) -> Array:
        """See `Forces`."""
        return forces.reshape(-1)


class HandForces:
    """Poses of the hands, with an energy for each hand's translation and rotation."""

    bounds = Bounds(
        inertia=np.array([2.0, 0.05, 2.0, 0.05]),
        damping=np.array([40.0, 1.0, 40.0, 1.0]),
        speed=np.array([0.1, 0.3, 0.1, 0.3]),
        yielding=np.array([0.01, 0.1, 0.01, 0.1]),
        drift_speed=np.array([0.2, 0.5, 0.2, 0.5]),
        slack_j=0.02,
    )

    def __init__(self, robot: Robot) -> None:
        self.space: Space = HandPoses()
        self._robot = robot
        self._kinematics = Kinematics(robot)

    def place_at(self, q: Array) -> Array:
        """See `Forces`."""
        return np.array(self._kinematics.tcp_poses(q)).reshape(1, -1)

    def place_of(self, sample: LeaderSample) -> Array:
        """See `Forces`."""
        if sample.Ts_world_tcp is None:
            return np.full((1, 32), np.nan)
        return np.array(sample.Ts_world_tcp, dtype=float).reshape(1, -1)

    def sample_at(self, place: Array, sample: LeaderSample) -> LeaderSample:
        """See `Forces`."""
        left, right = place.reshape(2, 4, 4).copy()
        return replace(sample, Ts_world_tcp=(left, right))

    def towards_reference(self, feedback: Feedback) -> Array:
        """See `Forces`."""
        wrenches = np.zeros((2, 6))
        for arm, J in enumerate(self._jacobians(feedback.q)):
            torque = feedback.met_nm[self._robot.joints_of(arm)]
            wrenches[arm] = -np.linalg.solve(J @ J.T + _DAMPED * np.eye(6), J @ torque)
        least = np.array([_LEAST_N, _LEAST_NM, _LEAST_N, _LEAST_NM])
        return _beyond(wrenches.reshape(1, 4, 3), least)

    def torques(self, forces: Array, q: Array) -> Array:
        """See `Forces`."""
        wrenches = forces.reshape(2, 6)
        torques = [J.T @ wrenches[arm] for arm, J in enumerate(self._jacobians(q))]
        return np.concatenate(torques)

    def _jacobians(self, q: Array) -> list[Array]:
        jacobians = self._kinematics.tcp_jacobians(q)
        return [J[:, self._robot.joints_of(arm)] for arm, J in enumerate(jacobians)]
