"""Reads simulated worlds as a policy may read them."""

import numpy as np

from minidual.config.control import SensingConfig
from minidual.environments.senses import JointReadings, PoseSensors, Sensed, Senses
from minidual.environments.transport_kernel import Scene
from minidual.environments.worlds import Worlds
from minidual.robot.pair import Array, Indices


class Readings:
    """The sensors of N worlds.

    Attributes:
        latest: What was read last.
    """

    latest: Sensed

    def __init__(self, worlds: Worlds, config: SensingConfig, frames: Array) -> None:
        self._worlds = worlds
        self._poses = PoseSensors(config, worlds.worlds_n, worlds.dt)
        self._senses = Senses(frames, worlds.worlds_n)
        self._all = np.arange(worlds.worlds_n)

    @property
    def offset(self) -> Array:
        """Constant errors (N, 6) [m, rad] of the pose sensors."""
        return self._poses.offset

    def draw(self, world: int, rng: np.random.Generator) -> None:
        """Draw the offset of a world's next trial."""
        self._poses.reset(world, rng)

    def begin(self, worlds: Indices, goals: Array) -> None:
        """Read the first state of new trials, with goals (m, 3)."""
        self._poses.begin(worlds, self._worlds.object_poses())
        poses = self._poses.read(worlds)
        self._senses.reset(worlds, poses[worlds, None], goals)
        self.latest = self._read(poses)

    def note(self, scene: Scene) -> None:
        """Let the sensors take samples of a physics step."""
        self._poses.note(scene.R, scene.p)

    def read(self) -> Sensed:
        """Read all worlds."""
        self.latest = self._read(self._poses.read(self._all))
        return self.latest

    def _read(self, poses: Array) -> Sensed:
        """Return the readings of this moment, with sensed poses (N, 4, 4)."""
        worlds = self._worlds
        arms = JointReadings(
            worlds.time_s,
            worlds.q,
            worlds.tau,
            worlds.gripper,
            worlds.grip_n,
            worlds.loads.hand_wrench.copy(),
        )
        return self._senses.read(arms, poses[:, None])
