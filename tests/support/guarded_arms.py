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
Clock = Callable[[float], float]


class SensedPlant:
    """A world whose joint readings pass through `senses(time, q, v)`, and whose clocks can be changed.

    Attributes:
        clock: Maps the world's time to the control time.
        stamp: Maps the world's time to the stamp of the readings.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self.robot = world.robot
        self.dt = world.dt
        self.health = ""
        self.senses: Senses = lambda _t, q, v: (q, v)
        self.clock: Clock = lambda t: t
        self.stamp: Clock = lambda t: t

    @property
    def time(self) -> float:
        return self.clock(self._world.time)

    @property
    def stamp_s(self) -> float:
        return self.stamp(self._world.time)

    @property
    def q(self) -> Array:
        return self.senses(self._world.time, self._world.q, self._world.v)[0]

    @property
    def v(self) -> Array:
        return self.senses(self._world.time, self._world.q, self._world.v)[1]

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
        self._measured: Measurement | None = None
        self._last = np.zeros(DOF)
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

    def fail(self, reason: str) -> None:
        """Run a tick in which the controllers give no torque."""
        measurement = self._read(self.plant.senses)
        try:
            tau = self.supervisor.fail(measurement, self._last, reason)
        except ReflexError as error:
            self.error = error
            tau = error.tau
        self._apply(tau)

    def begin_anew(self) -> None:
        """Start from the measurement of the next tick; the world has been reset."""
        self._measured = None

    def _read(self, senses: Senses) -> Measurement:
        self.plant.senses = senses
        if self._measured is None:
            self._last = np.array(Kinematics().gravity(self.world.q))
            self._measured = self._reader.reset()
        else:
            self._measured = self._reader.read(self._last, self.supervisor.observer.needed)
        return self._measured

    def _apply(self, tau: Array) -> None:
        self._last = np.array(tau)
        self.applied.append(self._last)
        if self.error is not None and self._reader.braking_due:
            assert self._measured is not None
            self.world.brake(self._measured.blind_arms)
        self.world.command(tau, OPEN_M)
        self.world.step()


def guard_commands(
    world: World,
    supervisor: Supervisor,
    acceleration: Callable[[], Array | None] = lambda: None,
) -> tuple[list[Array], list[Array]]:
    """Let every command of a world pass the supervisor; return the requested and the applied torques."""
    reader = Reader(world, supervisor.config)
    command = world.command
    requested: list[Array] = []
    applied: list[Array] = []

    def guarded(tau: Array, fingers_m: Array) -> None:
        if applied:
            last = applied[-1]
            measurement = reader.read(last, supervisor.observer.needed)
        else:
            last = np.array(Kinematics().gravity(world.q))
            measurement = reader.reset()
        requested.append(tau.copy())
        applied.append(supervisor.guard(measurement, tau, last, acceleration()))
        command(applied[-1], fingers_m)

    world.command = guarded  # type: ignore[method-assign]
    return requested, applied


def measurement_at(time_s: float, q: Array, v: Array, stamp_s: float | None = None) -> Measurement:
    """Return a measurement without faults, 1 ms after the last one."""
    stamp_s = time_s if stamp_s is None else stamp_s
    hands = np.full(2, 0.04), np.zeros(2)
    blind = np.zeros(DOF, dtype=bool)
    fresh_s = 1e-3 if stamp_s == time_s else 0.0
    return Measurement(time_s, 1e-3, stamp_s, fresh_s, q.copy(), v.copy(), *hands, blind, None)


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
