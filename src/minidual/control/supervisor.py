"""Guard: the supervisor checks every tick, and stops the arms when a bound does not hold.

A reflex raises `ReflexError` once; then `guard` returns the torques of the stop until `reset`. See docs/supervisor.md.
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

import numpy as np

from minidual import emergency
from minidual.config.control import SupervisorConfig
from minidual.control.joint_check import slower
from minidual.control.measurement import Measurement
from minidual.control.observer import STILL_RAD_S, ContactObserver, Expected
from minidual.control.reflexes import Reflex, ReflexError
from minidual.control.soft_stop import SupervisedStop
from minidual.control.space_check import Clearance, Distance, SpaceCheck
from minidual.control.tick_check import TickCheck, Violation
from minidual.plant.recorder import Recorder
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array

OnReflex = Callable[[Reflex], Path | None]
"""Called once per reflex, after the tick that triggered it; may return the dump file it wrote."""


def dumping(recorder: Recorder) -> OnReflex:
    """Return a callback that dumps the recorder's last second."""
    return lambda reflex: recorder.dump(reflex.label, reflex.text, details=reflex.details)


class Supervisor:
    """Guards both arms.

    Args:
        kinematics: Not the controllers'; created by default.
        self_distance: Distance between the arms, checked where they are.
        clearance: Checked where a stop would end.
        bounded: False compares nothing with bounds. Failures, measurements and torques that are not finite, and the
            emergency stop still stop the arms.
    """

    # All are options.
    def __init__(
        self,
        config: SupervisorConfig | None = None,
        *,
        dt_s: float = 1e-3,
        kinematics: Kinematics | None = None,
        self_distance: Distance | None = None,
        clearance: Clearance | None = None,
        on_reflex: OnReflex | None = None,
        bounded: bool = True,
    ) -> None:
        self.config = SupervisorConfig() if config is None else config
        self.dt_s = dt_s
        kinematics = Kinematics() if kinematics is None else kinematics
        self._robot = kinematics.robot
        self._bounded = bounded
        self._tick_check = TickCheck(self.config, dt_s, self._robot)
        self.bounds = self._tick_check.bounds
        self._stop = SupervisedStop(kinematics, self.config, dt_s)
        self.observer = ContactObserver(kinematics, self.config, dt_s)
        self._space_check = SpaceCheck(
            self.config,
            kinematics,
            self.bounds,
            self._stop,
            dt_s,
            self_distance,
            clearance,
        )
        self._on_reflex = on_reflex
        self._no_reference = np.zeros(self._robot.dof)
        self.expected: Callable[[], Expected] = Expected
        """What the controllers expect of this tick."""
        self.reflex: Reflex | None = None
        """Latched until `reset`."""
        self._estop = ""
        self._reported: Violation | None = None
        self.reset()

    # Interface -----------------------------------------------------------------------------------------------

    def reset(self, *, holding: bool = False) -> None:
        """Clear the latched reflex and all memory; an emergency stop that was not the latched reflex stays pending.

        Args:
            holding: The hands keep what `hold` attached to them.

        Raises:
            EmergencyStop: The one of the process was pressed (see minidual.emergency).
        """
        emergency.check()
        self.reflex = None
        self._reported = None
        if not holding:
            self.hold(None)
        self._deadline_s = math.inf
        self._v_last = np.zeros(self._robot.dof)
        self._contact = Expected()
        self._tick_check.reset()
        self._space_check.reset()
        self.observer.reset()

    def estop(self, reason: str = "pressed") -> None:
        """Stop the arms in the next tick; thread-safe."""
        self._estop = reason or "pressed"  # one assignment is atomic: no lock

    def report(self, violation: Violation) -> None:
        """Stop the arms in the next tick for what something outside the loop has found."""
        self._reported = violation

    def hold(self, arm: int | None, T_tcp_shape: Array | None = None) -> None:
        """See `Clearance`."""
        if self._space_check.clearance is not None:
            self._space_check.clearance.hold(arm, T_tcp_shape)

    def lower(self) -> None:
        """See `Clearance`."""
        if self._space_check.clearance is not None:
            self._space_check.clearance.lower()

    def bear(self, weights_n: Sequence[float]) -> None:
        """Let stops bear these weights [N], one for each hand; the sequence is read in each tick."""
        self._stop.weights_n = weights_n

    def heard(self, time_s: float) -> None:
        """Report an arbiter tick; silence over `stale_s` is a reflex."""
        self._deadline_s = time_s + self.config.stale_s

    def guard(
        self,
        measurement: Measurement,
        tau: Array,
        applied: Array,
        a_ref: Array | None = None,
    ) -> Array:
        """Return the torques (n,) [Nm] to apply; finite, within limits and the torque rate.

        Args:
            tau: Requested torques (n,) [Nm], clipped by the controller.
            applied: Torques (n,) [Nm] of the last tick.
            a_ref: Commanded reference acceleration (n,) [rad/s^2].

        Raises:
            ReflexError: Once; apply its `tau`, then `tell`.
        """
        self.observer.note(applied)
        if self.reflex is not None:
            return self._stop.torque(measurement, applied)
        within_bounds = self._tick_check.note(measurement, tau, applied, a_ref)
        violation = self._of_loop(measurement)
        if violation is None and not within_bounds:
            violation = self._tick_check.look()
            if not self._bounded and violation is not None and violation.bound is not None:
                violation = None
        if violation is None and self._bounded:
            violation = self._felt(measurement) or self._near(measurement, a_ref)
        if violation is not None:
            self._trip(violation, measurement, applied)
        self._v_last = measurement.v
        return tau.copy() if within_bounds else self._tick_check.bounded(tau, applied)

    def fail(self, measurement: Measurement, applied: Array, reason: str) -> Array:
        """Stop the arms; call instead of `guard` when controllers give no torque.

        Raises:
            ReflexError: See `guard`.
        """
        self.observer.note(applied)
        if self.reflex is None:
            self._trip(Violation("controller_failed", "", reason), measurement, applied)
        return self._stop.torque(measurement, applied)

    def tell(self, error: ReflexError) -> None:
        """Call `on_reflex`; the error names the file, or why there is none."""
        if self._on_reflex is None:
            return
        try:
            error.dump = self._on_reflex(error.reflex)
        except Exception as failure:
            error.remedy += (
                f"; the last second was not written: {type(failure).__name__}: {failure}"
            )
            error.__cause__ = error.__cause__ or failure
            return
        if error.dump is not None:
            error.remedy += f"; minidual replay {error.dump} shows the last second"

    @property
    def stop_reference(self) -> Array:
        """Joint targets (n,) [rad] of the stop after a reflex, for plants that take no torques."""
        return self._stop.reference

    @property
    def observes(self) -> bool:
        """Whether contacts are observed; without bounds `touch` stays 0."""
        return self._bounded

    @property
    def touch(self) -> Array:
        """External torque (n,) [Nm] beyond its mean of the last 0.1 s, which dry joints explain."""
        return self.observer.external - self.observer.steady

    # Checks --------------------------------------------------------------------------------------------------

    def _of_loop(self, measurement: Measurement) -> Violation | None:
        """Check measurement, emergency stop and silence, in this order."""
        fault = measurement.fault
        if fault is not None:
            return Violation(fault.reflex, fault.detail, fault.text, fault.value, fault.bound)
        pressed = self._estop or emergency.pressed()
        if pressed:
            self._estop = ""  # a later one acts after `reset`
            return Violation("emergency_stop", "", pressed)
        if self._reported is not None:
            return self._reported
        stale_s = self.config.stale_s
        late_s = measurement.period_s - self.dt_s
        if late_s > stale_s:
            return Violation("stale_command", "", "no control step", late_s, stale_s)
        if measurement.time_s > self._deadline_s:
            silent_s = measurement.time_s - self._deadline_s + stale_s
            return Violation("stale_command", "", "no command", silent_s, stale_s)
        return None

    def _felt(self, measurement: Measurement) -> Violation | None:
        """Compare what the observer finds with what the controllers expect."""
        if not self.observer.due or measurement.fresh_s == 0.0:
            return None
        try:
            expected = self._contact = self.expected()
        except Exception as error:
            return _failed(error)
        if expected.hand_fault:
            return Violation("gripper_opened", "", expected.hand_fault)
        observer = self.observer
        if not observer.update(measurement, expected):
            return None
        bounds = observer.bounds
        names = self._robot.joint_names
        ratio = np.abs(observer.external) / bounds.torques
        if not ratio.max() <= 1.0:
            stuck = (np.abs(measurement.v) < STILL_RAD_S) & (ratio > 1.0)
            joint = int(np.argmax(np.where(stuck, ratio, 0.0) if stuck.any() else ratio))
            return Violation(
                "contact",
                "stuck" if stuck.any() else "joint",
                f"{names[joint]}, {expected.mode}",
                float(observer.external[joint]),
                float(bounds.torques[joint]),
            )
        joint = int(np.argmax(observer.late_s))
        where = f"{names[joint]}, {expected.mode}"
        return Violation(
            "tracking_error",
            "",
            where,
            float(observer.away[joint]),
            bounds.deviation_rad,
        )

    def _near(self, measurement: Measurement, a_ref: Array | None) -> Violation | None:
        force_max_n = self.observer.modes[self._contact.mode].force_n
        try:
            return self._space_check.update(
                measurement,
                self._no_reference if a_ref is None else a_ref,
                self.observer.external,
                force_max_n,
            )
        except Exception as error:
            return _failed(error)

    def _trip(self, violation: Violation, measurement: Measurement, applied: Array) -> NoReturn:
        details = {
            name: [value if math.isfinite(value) else str(value) for value in values]
            for name, values in self._tick_check.details.items()
        }
        reflex = Reflex(*violation[:2], measurement.time_s, *violation[2:], details)
        v = slower(measurement.v, self._v_last)  # one sample may be wrong
        self._stop.begin(measurement.q, np.where(measurement.blind, measurement.v, v))
        self.observer.forget_needed()
        self.reflex = reflex
        raise ReflexError(reflex, self._stop.torque(measurement, applied))


def _failed(error: Exception) -> Violation:
    return Violation("controller_failed", "", f"a monitor: {type(error).__name__}: {error}")
