"""Simulated plants: the world driven by torques, and the same world driven by joint targets."""

import numpy as np

from minidual.plant.connect import PlantRequest
from minidual.plant.lifecycle import CommandKind, Sent
from minidual.plant.servo import GRIP_N, HandServo, JointServo
from minidual.plant.twin import OwnWorld
from minidual.plant.world import World
from minidual.robot.pair import SIDES, Array


class TorqueWorld(World):
    """The simulator as a plant that one connects to."""

    place = "simulator"
    kinds = (CommandKind.TORQUE,)

    def twin(self) -> OwnWorld:
        """Return itself."""
        return OwnWorld(self)


class PositionWorld:
    """A simulated plant that takes joint targets, as industrial controllers do.

    Its own servo runs at 1 kHz and moves each target on by its velocity.
    """

    place = "simulator"
    kinds = (CommandKind.POSITION,)
    kind = CommandKind.POSITION

    def __init__(self, world: World, rate_hz: float) -> None:
        self.world = world
        self.robot = world.robot
        self.dt = 1.0 / rate_hz
        self.grip_max_n = GRIP_N  # its drives close the hands with this force, no other
        self._ticks = round(self.dt / world.dt)
        self._joints = JointServo(world.robot)
        self._hands = [HandServo(arm, world) for arm in range(len(SIDES))]
        self._braked: tuple[int, ...] = ()
        self.reset()

    def reset(self, q: Array | None = None) -> None:
        """See `World`."""
        self.world.reset(q)
        self._q = self.world.q
        self._v = np.zeros(self.robot.dof)
        self.sent = Sent(CommandKind.POSITION, self.time, q=self._q, v=self._v)
        for hand in self._hands:
            hand.reset()

    def twin(self) -> OwnWorld:
        """Return the world behind the drives."""
        return OwnWorld(self.world)

    @property
    def health(self) -> str:
        """See `Plant`."""
        return self.world.health

    @property
    def time(self) -> float:
        """See `Plant`."""
        return self.world.time

    stamp_s = time

    @property
    def q(self) -> Array:
        """See `Plant`."""
        return self.world.q

    @property
    def v(self) -> Array:
        """See `Plant`."""
        return self.world.v

    @property
    def tau(self) -> Array:
        """See `Plant`."""
        return self.world.tau

    @property
    def fingers(self) -> Array:
        """See `Plant`."""
        return self.world.fingers

    @property
    def grip(self) -> Array:
        """See `Plant`."""
        return self.world.grip

    def follow(self, q: Array, v: Array, openings: Array) -> None:
        """See `PositionPlant`."""
        self._q = q.copy()
        self._v = v.copy()
        self.sent = Sent(CommandKind.POSITION, self.time, q=self._q, v=self._v)
        for hand, opening in zip(self._hands, openings, strict=True):
            hand.open_to(float(opening))

    def brake(self, arms: tuple[int, ...]) -> None:
        """See `Plant`."""
        self.world.brake(arms)

    def step(self) -> None:
        """See `Plant`."""
        world = self.world
        for k in range(self._ticks):
            target = self._q + (k + 1) * world.dt * self._v
            tau = self._joints.torque(world.q, world.v, target, self._v)
            fingers = np.array([hand.target() for hand in self._hands])
            world.command(tau, fingers)
            world.step()


def simulator(request: PlantRequest) -> TorqueWorld:
    """Return the row `sim` of `PLANTS`."""
    return TorqueWorld(request.scene, request.robot)


def position_simulator(request: PlantRequest) -> PositionWorld:
    """Return the row `sim-position` of `PLANTS`."""
    return PositionWorld(World(request.scene, request.robot), request.config.rate_hz)
