"""Real arms behind a supervisor, for its tests: whatever the controller asks for, only `guard` reaches the motors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from minidual.control.joint_control import ComputedTorque
from minidual.control.measurement import Measurement, Reader
from minidual.control.reflexes import ReflexError
from minidual.control.supervisor import Supervisor
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from tests.support.panda import DOF, HOME

OPEN_M = np.full(2, 0.04)
Reference = Callable[[float], tuple[Array, Array, Array]]
Torque = Callable[[float, Array], Array]
Senses = Callable[[float, Array, Array], tuple[Array, Array]]


class SensedPlant:
    """A world whose joint readings pass through `senses(time, q, v)`."""

    def __init__(self, world: World) -> None:
        self._world = world
        self.robot = world.robot
        self.dt = world.dt
        self.health = ""
        self.senses: Senses = lambda _t, q, v: (q, v)

    @property
    def time(self) -> float:
        return self._world.time

    @property
    def stamp_s(self) -> float:
        return self._world.time

    @property
    def q(self) -> Array:
        return self.senses(self.time, self._world.q, self._world.v)[0]

    @property
    def v(self) -> Array:
        return self.senses(self.time, self._world.q, self._world.v)[1]

    @property
    def fingers(self) -> Array:
        return self._world.fingers

    @property
    def grip(self) -> Array:
        return self._world.grip


class GuardedArms:
    """A world, a controller that follows any reference, and the supervisor between them.

    Attributes:
        applied: Every torque that reached the motors, (14,) each.
        error: The reflex, if one came.
    """

    def __init__(self, world: World, supervisor: Supervisor) -> None:
        self.world = world
        self.supervisor = supervisor
        self.controller = ComputedTorque(Kinematics(), natural_frequency_rad_s=30.0)
        self.plant = SensedPlant(world)
        self._reader = Reader(self.plant, supervisor.config)
        self._measured = self._reader.reset()
        self._last = np.array(Kinematics().gravity(world.q))
        self.applied: list[Array] = []
        self.error: ReflexError | None = None

    def run(
        self,
        seconds: float,
        reference: Reference | None = None,
        *,
        torque: Torque = lambda _t, tau: tau,
        before: Callable[[float], None] = lambda _t: None,
        tell_reference: bool = False,
        senses: Senses = lambda _t, q, v: (q, v),
    ) -> ReflexError | None:
        """Follow `reference` (home by default), changed by `torque`, until a reflex or the end; return the reflex.

        `senses` changes the measurements (q, v).
        """
        for _ in range(round(seconds / self.world.dt)):
            t = self.world.time
            before(t)
            measurement = self._read(senses)
            q = measurement.q
            v = measurement.v
            q_ref, v_ref, a_ref = hold(HOME)(t) if reference is None else reference(t)
            tau = torque(t, self.controller.torque(q, v, q_ref, v_ref, a_ref))
            try:
                a_told = a_ref if tell_reference else None
                tau = self.supervisor.guard(measurement, tau, self._last, a_told)
            except ReflexError as error:
                self.error = error
                tau = error.tau
            self._apply(tau)
            if self.error is not None:
                self.supervisor.tell(self.error)
                break
        return self.error

    def go_on(
        self,
        seconds: float,
        tau: Array | None = None,
        senses: Senses = lambda _t, q, v: (q, v),
    ) -> tuple[Array, Array]:
        """Keep calling the supervisor after a reflex, with a mad request; return each arm's peak speed and way (2,)."""
        mad = np.full(DOF, np.nan) if tau is None else tau
        began = self.world.q
        speeds = []
        ways = []
        for _ in range(round(seconds / self.world.dt)):
            self._apply(self.supervisor.guard(self._read(senses), mad, self._last))
            speeds.append(np.abs(self.world.v).reshape(2, -1).max(axis=1))
            ways.append(np.abs(self.world.q - began).reshape(2, -1).max(axis=1))
        return np.max(speeds, axis=0), np.max(ways, axis=0)

    def _read(self, senses: Senses) -> Measurement:
        self.plant.senses = senses
        self._measured = self._reader.read(self._last, self.supervisor.observer.needed)
        return self._measured

    def _apply(self, tau: Array) -> None:
        self._last = np.array(tau)
        self.applied.append(self._last)
        if self.error is not None and self._reader.braking_due:
            self.world.brake(self._measured.blind_arms)
        self.world.command(tau, OPEN_M)
        self.world.step()


def hold(q: Array) -> Reference:
    """Stand still at q."""
    return lambda _t: (q, np.zeros(DOF), np.zeros(DOF))


def swing(t: float) -> tuple[Array, Array, Array]:
    """Swing all joints, at 0.9 rad/s at t = 0, for 0.2 s."""
    w = 3.0
    ones = np.ones(DOF)
    return (
        HOME - 0.3 * (1.0 + np.sin(w * t)) * ones,
        -0.9 * np.cos(w * t) * ones,
        2.7 * np.sin(w * t) * ones,
    )


def begin_swing(world: World) -> None:
    """Put the arms into the swing."""
    world.reset(swing(0.0)[0])
    world.data.qvel[world.joints.qvel] = swing(0.0)[1]


def accelerate(
    joint: int,
    acceleration: float,
    *,
    until_s: float = 10.0,
    q0: Array = HOME,
) -> Reference:
    """Accelerate one joint from q0 for `until_s`, then go on at the speed reached, for ever."""
    e = np.eye(DOF)[joint]

    def at(t: float) -> tuple[Array, Array, Array]:
        pushed = min(t, until_s)
        v = acceleration * pushed
        way = 0.5 * acceleration * pushed**2 + v * (t - pushed)
        return q0 + way * e, v * e, (acceleration if t < until_s else 0.0) * e

    return at
