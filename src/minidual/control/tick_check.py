"""Guard, each tick: measurements, requested torques and references against the bounds of every joint."""

from typing import NamedTuple

import numpy as np

from minidual.config.control import SupervisorConfig
from minidual.control.bounds import QUANTITIES, SATURATED, TORQUE_TOLERANCE, TickBounds, excess
from minidual.control.measurement import Measurement
from minidual.robot.pair import Array, Robot


class Violation(NamedTuple):
    """A bound that does not hold; see `Reflex`."""

    name: str
    detail: str
    where: str
    value: float = 1.0
    bound: float | None = None


def beyond(
    name: str,
    detail: str,
    places: tuple[str, ...],
    values: Array,
    lower: Array,
    upper: Array,
) -> Violation:
    """Return the violation of the value that is farthest outside lower and upper (k,)."""
    worst = int(np.argmax(np.maximum(lower - values, values - upper)))
    bound = lower if values[worst] < lower[worst] else upper
    return Violation(name, detail, places[worst], float(values[worst]), float(bound[worst]))


class TickCheck:
    """Compares the quantities of one tick with their bounds; a bound that lasts has a patience."""

    def __init__(self, config: SupervisorConfig, dt_s: float, robot: Robot) -> None:
        self._config = config
        self._robot = robot
        self._dt = dt_s
        self.bounds = TickBounds(config, dt_s, robot)
        self._rows = np.zeros((len(QUANTITIES), robot.dof))
        self._no_reference = np.zeros(robot.dof)
        self.reset()

    def reset(self) -> None:
        """Forget earlier ticks."""
        self._rows[:] = 0.0
        self._referred = False
        self._tick = 0
        self._looked_tick = -2
        self._saturated = np.zeros(self._robot.dof)
        self._jumps = np.zeros(self._robot.dof)
        self._requested = np.zeros(self._robot.dof)

    @property
    def details(self) -> dict[str, list[float]]:
        """Positions, velocities and requested torques of the last tick, for a report."""
        names = ("measured_position_rad", "measured_velocity_rad_per_s", "asked_torque_nm")
        return {name: row.tolist() for name, row in zip(names, self._rows, strict=False)}

    def note(
        self,
        measurement: Measurement,
        tau: Array,
        applied: Array,
        a_ref: Array | None,
    ) -> bool:
        """Take a tick; return whether all quantities are within bounds.

        Args:
            tau: Requested torques (n,) [Nm], clipped by the controller.
            applied: Torques (n,) [Nm] of the last tick.
            a_ref: Commanded reference acceleration (n,), or None.
        """
        self._tick += 1
        follows = self._referred and a_ref is not None
        self._referred = a_ref is not None
        largest = excess(
            measurement.q,
            measurement.v,
            tau,
            applied,
            self._no_reference if a_ref is None else a_ref,
            follows,
            self.bounds.centre,
            self.bounds.scale,
            self._rows,
        )
        return bool(largest <= 1.0)  # false for NaN

    def look(self) -> Violation | None:
        """Return the first violation of the tick taken last, which was not within bounds."""
        q, v, tau, _, a_ref, a_step = self._rows
        bounds = self.bounds
        names = self._robot.joint_names
        for quantity, values in (("torque", tau), ("reference", a_ref)):
            finite = np.isfinite(values)
            if not finite.all():
                joint = int(np.argmin(finite))
                where = f"the {quantity} of {names[joint]} is {values[joint]}"
                return Violation("controller_failed", "", where)
        if (np.abs(q - bounds.centre[0]) * bounds.scale[0]).max() > 1.0:
            return beyond("joint_position", "", names, q, bounds.q_lower, bounds.q_upper)
        violation = (
            self._ratio("speed", "joint", v, bounds.v_max)
            or self._ratio("torque", "range", tau, bounds.tau_max, TORQUE_TOLERANCE)
            or self._ratio("reference", "acceleration", a_ref, bounds.a_max, 1e-9)
        )
        if violation is None and self._config.jerk_reflex:
            jerk = a_step / self._dt
            violation = self._ratio("reference", "jerk", jerk, bounds.a_step / self._dt, 1e-9)
        return violation or self._lasting(tau)

    def bounded(self, tau: Array, applied: Array) -> Array:
        """Return the torques (n,) [Nm] nearest to tau within the torque rate."""
        step = tau - applied
        if not (np.abs(step) > self.bounds.tau_step).any():
            return tau.copy()
        return tau - step + np.clip(step, -self.bounds.tau_step, self.bounds.tau_step)

    def _ratio(
        self,
        name: str,
        detail: str,
        values: Array,
        bounds: Array,
        tolerance: float = 0.0,
    ) -> Violation | None:
        ratio = np.abs(values) / bounds
        joint = int(np.argmax(ratio))
        if not ratio[joint] > 1.0 + tolerance:
            return None
        where = self._robot.joint_names[joint]
        return Violation(name, detail, where, float(values[joint]), float(bounds[joint]))

    def _lasting(self, tau: Array) -> Violation | None:
        """Check how long a motor has been saturated, and how long torques have kept jumping.

        A target that jumps makes the torque jump in a few ticks, which the rate limit absorbs; chatter jumps
        in every tick. A jump counts up, any other tick down.
        """
        bounds = self.bounds
        calm_ticks = self._tick - 1 - self._looked_tick
        if calm_ticks:  # their requested torque was applied unchanged
            self._saturated[:] = 0.0
            self._jumps = np.maximum(self._jumps - calm_ticks, 0.0)
            jump = self._rows[3].copy()
        else:
            jump = tau - self._requested
        self._looked_tick = self._tick
        self._requested = tau.copy()
        saturated = np.abs(tau) >= SATURATED * bounds.tau_max
        self._saturated = np.where(saturated, self._saturated + 1.0, 0.0)
        jumps = np.abs(jump) > self._config.torque_rate_excess * bounds.tau_step
        self._jumps = np.where(jumps, self._jumps + 1.0, np.maximum(self._jumps - 1.0, 0.0))
        rate_max = np.full(len(jump), bounds.tau_step / self._dt)
        return self._patience(
            "saturation",
            self._saturated,
            self._config.saturation_s,
            tau,
            bounds.tau_max,
        ) or self._patience(
            "rate",
            self._jumps,
            self._config.torque_rate_patience_s,
            jump / self._dt,
            rate_max,
        )

    def _patience(
        self,
        detail: str,
        ticks: Array,
        patience_s: float,
        values: Array,
        bounds: Array,
    ) -> Violation | None:
        joint = int(np.argmax(ticks))
        if not ticks[joint] * self._dt > patience_s + 1e-9:
            return None
        where = f"{self._robot.joint_names[joint]} for {1e3 * patience_s:.0f} ms"
        return Violation("torque", detail, where, float(values[joint]), float(bounds[joint]))
