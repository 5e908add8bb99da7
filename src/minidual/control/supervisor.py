"""The supervisor checks measurements and torques, and stops the arms when a bound does not hold.

A reflex raises `ReflexError` once; then `guard` returns soft-stop torques until `reset`. See docs/supervisor.md.
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn, Protocol

import numpy as np

from minidual import emergency
from minidual.config.control import SupervisorConfig
from minidual.control import reflexes
from minidual.control.kernels import hand_look
from minidual.control.reflexes import Reflex, ReflexError, excess
from minidual.control.senses import EVERY, STILL_RAD_S, ContactSense, Expected, JointSense
from minidual.control.soft_stop import SupervisedStop
from minidual.plant.recorder import Recorder
from minidual.robot.kinematics import Hands, Kinematics
from minidual.robot.pair import SIDES, Array

Distance = Callable[[Array], tuple[str, float]]
"""Maps q (n,) [rad] to the nearest collidable pair ("a with b") and its distance [m]."""


class Clearance(Protocol):
    """Distances between all that may collide."""

    def __call__(self, q: Array) -> tuple[str, float, float]:
        """Return the pair nearest to its bound at q (n,), its distance and bound [m]."""
        ...

    def hold(self, arm: int | None, T_tcp_shape: Array | None = None) -> None:
        """Attach the object's shape to a hand at a pose (4, 4), besides what the other holds; None empties both."""
        ...


OnReflex = Callable[[Reflex], Path | None]
"""Called once per reflex, after its first torque; may return the dump file it wrote."""


def dumping(recorder: Recorder) -> OnReflex:
    """Return a callback that dumps the recorder's last second."""
    return lambda reflex: recorder.dump(reflex.name, reflex.text, details=reflex.details)


SEEN = ("measured_position_rad", "measured_velocity_rad_per_s", "asked_torque_nm")
"""Per-joint values recorded by a reflex; non-finite ones become text."""


class Supervisor:
    """Guards both arms.

    Args:
        kinematics: Not the controllers'; created by default.
        self_distance: Distance between the arms, checked where they are.
        clearance: Checked where a stop would end.
    """

    def __init__(
        self,
        config: SupervisorConfig | None = None,
        *,
        dt_s: float = 1e-3,
        kinematics: Kinematics | None = None,
        self_distance: Distance | None = None,
        clearance: Clearance | None = None,
        on_reflex: OnReflex | None = None,
    ) -> None:
        self.config = SupervisorConfig() if config is None else config
        self.dt_s = dt_s
        self._kinematics = Kinematics() if kinematics is None else kinematics
        self._robot = self._kinematics.robot
        self.bounds = reflexes.TickBounds(self.config, dt_s, self._robot)
        self._reach = reflexes.Reach(self._kinematics)
        self._sense = JointSense(self._kinematics, self.config, dt_s)
        self._contact = ContactSense(self._kinematics, self.config, dt_s)
        self._hands = Hands(self._kinematics)
        self._looked = np.zeros((2, 5))
        self._expected = Expected()
        self.expected: Callable[[], Expected] = Expected
        """What controllers expect of this tick."""
        self._stop = SupervisedStop(self._kinematics, self.config, dt_s)
        self._self_distance = self_distance
        self._clearance = clearance
        self._on_reflex = on_reflex
        self._slow_every = max(1, round(self.config.slow_period_s / dt_s))
        self._feel_every = max(1, round(1e-3 * EVERY / dt_s))
        self._rows = np.zeros((len(reflexes.QUANTITIES), self._robot.dof))
        self._q, self._v, self._tau = self._rows[
            :3
        ]  # views, kept: making one costs as much as a sum
        self._within = self.bounds.centre, self.bounds.scale, self._rows
        self.reflex: Reflex | None = None
        """Latched."""
        self._estop = ""
        self.reset()

    # Interface -----------------------------------------------------------------------------------------------

    def reset(self, tau: Array | None = None) -> None:
        """Clear the latched reflex and the clock; the next torques follow tau (n,) [Nm], by default gravity's.

        An emergency stop that was not the latched reflex stays pending.

        Raises:
            EmergencyStop: The one of the process was pressed (see minidual.emergency).
        """
        emergency.check()
        self.reflex = None
        if tau is None:
            self.hold(None)
            self._stop.bears_n = 0.0, 0.0
        self._deadline_s = math.inf
        self._time_s = -math.inf
        self._tick = self._next_slow = self._next_ahead = 0
        self._next_near = math.inf if self._self_distance is None else 0
        self._next_feel = self._feel_every
        self._applied = None if tau is None else tau.copy()
        self._rows[:] = 0.0
        self._referred = False
        self._looked_tick = -2
        self._saturated, self._jumps, self._asked, self._nothing = np.zeros((4, self._robot.dof))
        self._stamp_s: float | None = None
        self._usable = True
        self._sense.reset()
        self._contact.reset()

    def estop(self, reason: str = "pressed") -> None:
        """Stop the arms in the next tick; thread-safe."""
        self._estop = reason or "pressed"  # one assignment is atomic: no lock

    def fail(
        self,
        time_s: float,
        q: Array,
        v: Array,
        why: str,
        stamp_s: float | None = None,
    ) -> Array:
        """Stop the arms; call instead of `guard` when controllers give no torque.

        Raises:
            ReflexError: See `guard`.
        """
        if self.reflex is None:
            time_s += self.dt_s * (
                time_s == self._time_s
            )  # a plant that failed to step has not kept the time
            self._note(time_s, q, v, self._tau, stamp_s, None)
            self._trip("controller_failed", why, 1.0, None)
        return self._stopping(q, v, stamp_s)

    def brake_anew(self, tau: Array, *, arrested: bool = False) -> None:
        """Let a latched stop begin again where the arms are, from applied torques tau (n,) [Nm].

        `arrested`: only while they are 0.05 rad/s slower than the stop, as by brakes of their own.
        """
        v = self._sense.v_slower
        if self.reflex is not None and not (
            arrested and np.abs(self._stop.v).max() < np.abs(v).max() + 0.05
        ):
            self._stop.begin(self._sense.q, v, tau, True)

    def resume(self, tau: Array) -> None:
        """Go on from torques tau (n,) [Nm]: the last ones did not reach the motors."""
        self._applied = tau.copy()
        if self.reflex is not None:
            self._stop.resume(tau)

    def hold(self, arm: int | None, T_tcp_shape: Array | None = None) -> None:
        """See `Clearance`; a `reset` without torques forgets it."""
        if self._clearance is not None:
            self._clearance.hold(arm, T_tcp_shape)

    def heard(self, time_s: float) -> None:
        """Report an arbiter tick; silence over `stale_s` is a reflex."""
        self._deadline_s = time_s + self.config.stale_s

    def guard(
        self,
        time_s: float,
        q: Array,
        v: Array,
        tau: Array,
        a_ref: Array | None = None,
        stamp_s: float | None = None,
    ) -> Array:
        """Return the torques (n,) [Nm] to apply; finite and within limits.

        `tau` must already be clipped; `a_ref` (n,) is the commanded reference acceleration; `stamp_s` the time at which
        q and v were measured, by default now.

        Raises:
            ReflexError: Once; apply its `tau`, then `tell`.
        """
        if self.reflex is not None:
            return self._stopping(q, v, stamp_s)
        self._tick += 1
        stop = self._estop or emergency.pressed()
        most = self._note(time_s, q, v, tau, stamp_s, a_ref)
        heard = time_s <= self._deadline_s and self._stood_s <= self.config.stale_s  # not NaN
        calm = most <= 1.0 and self._usable and not stop and heard
        applied = self._tau.copy() if calm else self._look_closer(stop)
        if self._tick >= self._next_feel and self._sense.age_s == 0.0:
            self._next_feel = self._tick + self._feel_every
            self._feel(time_s if stamp_s is None else stamp_s)
        if self._tick >= self._next_slow:
            self._look_slowly()
        self._applied = applied  # only now: what trips begins at the torque of the tick before
        return applied.copy()

    def tell(self, error: ReflexError) -> None:
        """Call `on_reflex`; the error names the file, or why there is none."""
        try:
            error.dump = None if self._on_reflex is None else self._on_reflex(error.reflex)
            error.remedy += (
                ""
                if error.dump is None
                else f"; minidual replay {error.dump} shows the last second"
            )
        except Exception as failure:
            error.remedy += (
                f"; the last second was not written: {type(failure).__name__}: {failure}"
            )
            error.__cause__ = error.__cause__ or failure

    @property
    def steady(self) -> Array:
        """External torque (n,) [Nm], mean of the last 0.1 s."""
        return self._contact.steady

    @property
    def touch(self) -> Array:
        """External torque (n,) [Nm] beyond its mean of the last 0.1 s, which dry joints explain."""
        return self._contact.torque - self._contact.steady

    # Checks --------------------------------------------------------------------------------------------------

    def _note(
        self,
        time_s: float,
        q: Array,
        v: Array,
        tau: Array,
        stamp_s: float | None,
        a_ref: Array | None,
    ) -> float:
        """Take what is measured and asked; return the largest excess."""
        if self._applied is None:
            self._applied = self._before_control(q)
        follows = self._referred
        self._referred = a_ref is not None
        more = (
            self._applied,
            self._nothing if a_ref is None else a_ref,
            follows and self._referred,
            *self._within,
        )
        try:
            most: float = excess(q, v, tau, *more)
        except TypeError:  # no arrays of floats
            self._q[:] = q
            self._v[:] = v
            self._tau[:] = tau
            most = excess(self._q, self._v, self._tau, *more)
        before_s = self._time_s
        self._time_s = time_s
        self._stood_s = time_s - before_s - self.dt_s if self._tick > 1 else 0.0
        self._usable = self._sense.update(self._q, self._v, self._applied, self._newer_s(stamp_s))
        if not time_s > before_s:
            self._time_s = before_s
            self._trip("clock", f"{time_s} s after {before_s} s", 1.0, None)
        return most

    def _newer_s(self, stamp_s: float | None) -> float:
        """Return how much newer [s] the measurement is than the last; one period where stamps tell nothing."""
        before_s = self._stamp_s
        self._stamp_s = stamp_s
        if stamp_s is None or before_s is None:
            return self.dt_s
        newer_s = stamp_s - before_s
        if newer_s < 0.0 and self._overtaken(newer_s):
            self._stamp_s = before_s
        return newer_s

    def _overtaken(self, newer_s: float) -> bool:
        """Return whether a later measurement has overtaken this one; where none has come for long, the clock jumped."""
        return (
            -(most_s := self.config.measurement_age_max_s) < newer_s < 0.0
            and self._sense.age_s < 0.5 * most_s
        )

    def _stopping(self, q: Array, v: Array, stamp_s: float | None) -> Array:
        newer_s = self._newer_s(stamp_s)
        if not self._overtaken(newer_s):
            if not newer_s > 0.0 and not (
                np.array_equal(q, self._q) and np.array_equal(v, self._v)
            ):
                newer_s = self.dt_s  # the clock has failed, not the sensors
            self._q[:] = q
            self._v[:] = v
        self._sense.needed = np.full(
            self._robot.dof,
            math.nan,
        )  # a joint at rest may stand under any torque of a stop
        self._sense.update(self._q, self._v, self._stop.tau, newer_s)
        if (
            back := self._sense.returned
        ).any():  # where the arms are now, which the model alone did not know
            v = np.where(back, self._sense.v_slower, self._stop.v)
            self._stop.begin(self._sense.q, v, self._stop.tau, back)
        return self._stop.torque(self._sense.q, self._sense.v)

    def _before_control(self, q: Array) -> Array:
        return np.array(self._kinematics.gravity(q if np.isfinite(q).all() else self._robot.home))

    def _look_closer(self, stop: str) -> Array:
        q, v, tau, step, a_ref, a_step = self._rows
        bounds = self.bounds
        for what, values in (
            ("measured position", q),
            ("measured velocity", v),
            ("torque", tau),
            ("reference", a_ref),
        ):
            finite = np.isfinite(values)
            if not finite.all():
                joint = int(np.argmin(finite))
                self._trip(
                    "not_finite",
                    f"{what} of {self._robot.joint_names[joint]}",
                    float(values[joint]),
                    None,
                )
        if stop:
            self._estop = ""  # a later one acts after `reset`
            self._trip("emergency_stop", stop, 1.0, None)
        if self._stood_s > self.config.stale_s:
            self._trip("stale_command", "no control step", self._stood_s, self.config.stale_s)
        if self._time_s > self._deadline_s:
            silent = self._time_s - self._deadline_s + self.config.stale_s
            self._trip("stale_command", "no command", silent, self.config.stale_s)
        if not self._usable:
            age_s = self._sense.age_s
            age_max_s = self.config.measurement_age_max_s
            if age_s > age_max_s:
                self._trip("stale_measurement", "joint positions and velocities", age_s, age_max_s)
            self._trip("implausible_measurement", self._sense.why, 1.0, None)
        if (np.abs(q - bounds.centre[0]) * bounds.scale[0]).max() > 1.0:
            self._trip_position(q)
        self._trip_ratio("joint_velocity", v, bounds.v_max)
        self._trip_ratio("torque_range", tau, bounds.tau_max, tolerance=reflexes.TORQUE_TOLERANCE)
        self._trip_ratio("reference_acceleration", a_ref, bounds.a_max, tolerance=1e-9)
        if self.config.jerk_reflex:
            self._trip_ratio(
                "reference_jerk",
                a_step / self.dt_s,
                bounds.a_step / self.dt_s,
                tolerance=1e-9,
            )
        return self._bound_torque(tau, step)

    def _bound_torque(self, tau: Array, step: Array) -> Array:
        bounds = self.bounds
        in_order = self._tick - 1 - self._looked_tick
        if (
            in_order
        ):  # ticks within bounds since the last check: their requested torque was applied unchanged
            self._saturated[:] = 0
            np.maximum(self._jumps - in_order, 0, out=self._jumps)
            jump = step
        else:
            jump = tau - self._asked
        self._looked_tick = self._tick
        self._asked = tau.copy()
        self._saturated = np.where(
            np.abs(tau) >= reflexes.SATURATED * bounds.tau_max,
            self._saturated + 1,
            0,
        )
        self._trip_lasting(
            "torque_saturation",
            self._saturated,
            self.config.saturation_s,
            tau,
            bounds.tau_max,
        )
        # A target that jumps makes the torque jump in a few ticks, which the limiter absorbs; chatter jumps in
        # every tick. A jump counts up, any other tick down.
        jumps = np.abs(jump) > self.config.torque_rate_excess * bounds.tau_step
        self._jumps = np.where(jumps, self._jumps + 1, np.maximum(self._jumps - 1, 0))
        rate = jump / self.dt_s
        rate_max = np.full(len(jump), bounds.tau_step / self.dt_s)
        self._trip_lasting(
            "torque_rate",
            self._jumps,
            self.config.torque_rate_patience_s,
            rate,
            rate_max,
        )
        if not (np.abs(step) > bounds.tau_step).any():
            return tau.copy()
        return tau - step + np.clip(step, -bounds.tau_step, bounds.tau_step)

    def _feel(self, stamp_s: float) -> None:
        contact = self._contact
        robot = self._robot
        self._expected = expected = self._monitored(self.expected)
        self._stop.bears_n = expected.bears_n
        if expected.hand_fault:
            self._trip("gripper_opened", expected.hand_fault, 1.0, None)
        sense = self._sense
        age = (self._time_s - stamp_s + self.config.torque_delay_s) / self.dt_s
        age = (
            max(0, round(age)) if abs(age) < len(sense.applied) else 0
        )  # the stack refuses such stamps
        if sense.ticks <= age + self._feel_every:
            return  # torques before the start are not known
        torque, late = contact.update(
            stamp_s,
            self._q,
            self._v,
            sense.applied,
            sense.ticks - 1 - age,
            expected,
        )
        sense.needed = (
            contact.needed if expected.torque is None else contact.needed - expected.torque
        )
        if torque <= 1.0 and late <= 1.0:
            return
        *bounds, away_max, _, _ = contact.limits.tolist()
        if not torque <= 1.0:
            ratio = np.abs(contact.torque) / bounds
            stuck = (np.abs(self._v) < STILL_RAD_S) & (ratio > 1.0)
            joint = int(np.argmax(np.where(stuck, ratio, 0.0) if stuck.any() else ratio))
            name = "joint_stuck" if stuck.any() else "joint_contact"
            value = contact.torque[joint]
            bound = bounds[joint]
        else:
            joint = int(np.argmax(contact.late_s))
            name = "tracking_error"
            value = contact.away[joint]
            bound = away_max
        self._trip(name, f"{robot.joint_names[joint]}, {expected.mode}", float(value), bound)

    def _look_slowly(self) -> None:
        self._next_slow = self._tick + self._slow_every
        q = self._rows[0]
        v = self._rows[1]
        rest = q + v * np.abs(v) / (2.0 * self._robot.a_max)  # under full braking
        if not np.abs((rest - self.bounds.centre[0]) * self.bounds.scale[0]).max() <= 1.0:
            self._trip_position(rest)
        self._hands.update(q)
        # Two periods ahead: one until the next check, one for the speed gained meanwhile.
        later = 2.0 * self._slow_every * self.dt_s
        force_max = float(self._contact.bounds[self._expected.mode][-1])
        hand_look(self._hands.views, v, self._contact.torque, later, self._looked)
        (x0, x1), (y0, y1), (z0, z1) = self.config.workspace_m
        for arm, (force, speed, x, y, z) in enumerate(self._looked.tolist()):
            if not (force <= force_max or arm in self._expected.off):
                self._trip(
                    "cartesian_contact",
                    f"the {SIDES[arm]} hand, {self._expected.mode}",
                    force,
                    force_max,
                )
            if not speed <= self.config.tcp_speed_max_m_per_s:
                self._trip(
                    "tcp_speed",
                    self._robot.tcp_names[arm],
                    speed,
                    self.config.tcp_speed_max_m_per_s,
                )
            if not (x0 <= x <= x1 and y0 <= y <= y1 and z0 <= z <= z1):
                axes = [f"{axis} of the {SIDES[arm]} hand" for axis in "xyz"]
                self._trip_outside(
                    "workspace",
                    axes,
                    np.array([x, y, z]),
                    *np.transpose(self.config.workspace_m),
                )
        if self._clearance is not None and self._tick >= self._next_ahead:
            self._next_ahead = self._next_slow
            a_ref = self._rows[4]
            # Two periods ahead, as for the hands. From one look to the next it moves by less than a link is wide.
            rest = self._stop.rest(q + later * (v + 0.5 * later * a_ref), v + later * a_ref)
            pair, distance, bound = self._monitored(self._clearance, rest)
            if not distance >= bound:
                self._trip("stopping_distance", pair, distance, bound)
        if self._self_distance is not None and self._tick >= self._next_near:
            pair, distance = self._monitored(self._self_distance, q)
            if not distance >= self.config.self_collision_min_m:
                self._trip("self_collision", pair, distance, self.config.self_collision_min_m)
            # Check again before the gap can close to the bound at full acceleration.
            safe_s = self._reach.safe_time_s(v, distance - self.config.self_collision_min_m)
            self._next_near = self._tick + min(
                3 * self._slow_every,
                max(1, int(min(safe_s, 1.0) / self.dt_s)),
            )
        self._next_slow = min(self._next_slow, self._next_near)

    def _monitored[T](self, monitor: Callable[..., T], *values: Array) -> T:
        try:
            return monitor(*values)
        except Exception as error:
            self._trip(
                "controller_failed",
                f"a monitor: {type(error).__name__}: {error}",
                1.0,
                None,
            )

    # Reflexes ------------------------------------------------------------------------------------------------

    def _trip_ratio(
        self,
        name: str,
        values: Array,
        bounds: Array,
        *,
        tolerance: float = 0.0,
    ) -> None:
        ratio = np.abs(values) / bounds
        joint = int(np.argmax(ratio))
        if ratio[joint] > 1.0 + tolerance:
            self._trip(
                name,
                self._robot.joint_names[joint],
                float(values[joint]),
                float(bounds[joint]),
            )

    def _trip_lasting(
        self,
        name: str,
        ticks: Array,
        patience_s: float,
        values: Array,
        bounds: Array,
    ) -> None:
        longest = int(np.argmax(ticks))
        if ticks[longest] * self.dt_s > patience_s + 1e-9:
            where = f"{self._robot.joint_names[longest]} for {1e3 * patience_s:.0f} ms"
            self._trip(name, where, float(values[longest]), float(bounds[longest]))

    def _trip_position(self, q: Array) -> None:
        self._trip_outside(
            "joint_position",
            self._robot.joint_names,
            q,
            self.bounds.q_lower,
            self.bounds.q_upper,
        )

    def _trip_outside(
        self,
        name: str,
        where: Sequence[str],
        values: Array,
        lower: Array,
        upper: Array,
    ) -> None:
        worst = int(np.argmax(np.maximum(lower - values, values - upper)))
        bound = lower if values[worst] < lower[worst] else upper
        self._trip(name, where[worst], float(values[worst]), float(bound[worst]))

    def _trip(self, name: str, where: str, value: float, bound: float | None) -> NoReturn:
        details = {
            key: [x if math.isfinite(x) else str(x) for x in values.tolist()]  # JSON has no NaN
            for key, values in zip(SEEN, self._rows[:3], strict=True)
            if not (
                name == "controller_failed" and key == "asked_torque_nm"
            )  # no torque was requested
        }
        reflex = Reflex(name, self._time_s, where, value, bound, details)
        sense = self._sense
        applied = self._applied
        self._stop.begin(
            sense.q,
            sense.v_slower,
            self._before_control(sense.q) if applied is None else applied,
        )
        self.reflex = reflex
        raise ReflexError(reflex, self._stop.torque(sense.q, sense.v))
