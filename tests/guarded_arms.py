"""Real arms behind a supervisor, for its tests: whatever the controller asks for, only `guard` reaches the motors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from panda import DOF, HOME

from minidual.control.joint_control import ComputedTorque
from minidual.control.reflexes import ReflexError
from minidual.control.supervisor import Supervisor
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array

OPEN_M = np.full(2, 0.04)
Reference = Callable[[float], tuple[Array, Array, Array]]
Torque = Callable[[float, Array], Array]


class GuardedArms:
    """A world, a controller that follows any reference, and the supervisor between them.

    Attributes:
        applied: Every torque that reached the motors, (14,) each.
        error: The reflex, if one came.
    """

    def __init__(self, world: World, supervisor: Supervisor) -> None:
        self.world, self.supervisor = world, supervisor
        self.controller = ComputedTorque(Kinematics(), natural_frequency_rad_s=30.0)
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
    ) -> ReflexError | None:
        """Follow `reference` (home by default), changed by `torque`, until a reflex or the end; return the reflex."""
        for _ in range(round(seconds / self.world.dt)):
            t, q, v = self.world.time, self.world.q, self.world.v
            before(t)
            q_ref, v_ref, a_ref = hold(HOME)(t) if reference is None else reference(t)
            tau = torque(t, self.controller.torque(q, v, q_ref, v_ref, a_ref))
            try:
                tau = self.supervisor.guard(t, q, v, tau, a_ref if tell_reference else None)
            except ReflexError as error:
                self.error, tau = error, error.tau
            self._apply(tau)
            if self.error is not None:
                break
        return self.error

    def go_on(self, seconds: float, tau: Array | None = None, q: Array | None = None) -> None:
        """Keep calling the supervisor after a reflex, with a mad request and, if given, a mad measurement."""
        mad = np.full(DOF, np.nan) if tau is None else tau
        for _ in range(round(seconds / self.world.dt)):
            seen = self.world.q if q is None else q
            self._apply(self.supervisor.guard(self.world.time, seen, self.world.v, mad))

    def _apply(self, tau: Array) -> None:
        self.applied.append(np.array(tau))
        self.world.command(tau, OPEN_M)
        self.world.step()


def hold(q: Array) -> Reference:
    """Stand still at q."""
    return lambda _t: (q, np.zeros(DOF), np.zeros(DOF))


def accelerate(joint: int, acceleration: float, *, until_s: float = 10.0, q0: Array = HOME) -> Reference:
    """Accelerate one joint from q0 for `until_s`, then go on at the speed reached, for ever."""
    e = np.eye(DOF)[joint]

    def at(t: float) -> tuple[Array, Array, Array]:
        pushed = min(t, until_s)
        v = acceleration * pushed
        way = 0.5 * acceleration * pushed**2 + v * (t - pushed)
        return q0 + way * e, v * e, (acceleration if t < until_s else 0.0) * e

    return at
