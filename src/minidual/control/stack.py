"""Control loop: arbiter, controllers, supervisor, plant.

The arbiter runs at its own rate, and at once for requests, halts and timed commands. Example: docs/control.md.
"""

import math
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from minidual import emergency
from minidual.config.control import SPEED_OVERRIDE_MIN, ArbiterConfig
from minidual.control.arbiter import ArbiterOutput, CommandArbiter
from minidual.control.commands import HOLD, ArbiterState, Command, JointCommand, Refusal
from minidual.control.controller_manager import ControllerManager, ControllerSwitchError
from minidual.control.controllers import Controller, JointTrajectoryController, Payload
from minidual.control.execution import START_RAD_PER_S
from minidual.control.gripper import JOINT_PINCH_N, Grippers
from minidual.control.impedance import InHand
from minidual.control.impedance_controllers import (
    HandImpedanceController,
    ObjectImpedanceController,
    ObjectSensor,
)
from minidual.control.reflexes import ReflexError
from minidual.control.senses import Expected, slower
from minidual.control.soft_stop import SoftStopController, SwitchedOff
from minidual.control.supervisor import Supervisor
from minidual.errors import MinidualError, UsageError
from minidual.plant.protocol import Plant, PlantEndedError
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array

DEFAULT_CONTROLLERS: tuple[str, ...] = ("both_arms",)
"""Set after a reset."""
OBJECT_CONTROLLERS: tuple[str, ...] = ("object_impedance",)
"""Set for an object in both hands."""
_STOPPING: tuple[str, ...] = ("soft_stop",)
_STOP_MAX_S = 2.0
_REFUSALS_KEPT = 1000
_BACK_S = 0.1
"""An arm whose power returns is watched for contacts after this time: its torque rises, its own brakes open."""
_BEARING = "emergency_stop", "stale_command", "controller_failed"
"""Reflexes in which an external torque is a load: the arms are sound and touch nothing else."""
_SAG_MIN_RAD = 2e-4
_SAG_MAX_RAD = 0.1
"""Distance from their reference at which arms sag under a load, and beyond which something else has moved them."""


def _row(x: Any, n: int) -> Array:
    x = np.asarray(x, dtype=float)
    return x if x.shape == (n,) else x.reshape(n)


class PlantError(MinidualError):
    """The plant failed, or its measurements are stale."""


class ControlStack[P: Plant]:
    """Drives one plant.

    Args:
        rate_hz: Of the arbiter in `step`.
        supervisor: None disables guarding.
        sensor: Required to activate controller C.
    """

    def __init__(
        self,
        plant: P,
        kinematics: Kinematics,
        config: ArbiterConfig | None = None,
        *,
        rate_hz: float = 50.0,
        pinch_force_n: float = JOINT_PINCH_N,
        supervisor: Supervisor | None = None,
        sensor: ObjectSensor | None = None,
    ) -> None:
        self.plant = plant
        self.supervisor = supervisor
        self._config = ArbiterConfig() if config is None else config
        self._speed = self._config.speed_override
        self._age_max_s = self._config.stale_s
        steps = 1.0 / (rate_hz * plant.dt)
        self.every = round(steps)
        """Control steps from one regular arbiter tick to the next."""
        if self.every < 1 or abs(steps - self.every) > 1e-6:
            uneven = f"rate_hz {rate_hz} does not divide the control rate of {1.0 / plant.dt:g} Hz"
            raise UsageError(uneven, remedy="take a divisor of it, such as 50 or 100")
        self.kinematics = kinematics
        self._robot = kinematics.robot
        if supervisor is not None and abs(supervisor.dt_s - plant.dt) > 1e-9:
            periods = f"the supervisor's period is {supervisor.dt_s} s, the plant's {plant.dt} s"
            raise UsageError(periods, remedy="make the supervisor with dt_s=plant.dt")
        self.grippers = Grippers(
            plant,
            pinch_force_n=pinch_force_n,
            speed_m_per_s=self._config.finger_speed_m_per_s,
        )
        self.impedance = ObjectImpedanceController(kinematics, plant.dt, sensor)
        self.payload = Payload(kinematics, plant.dt)
        self.hands = [
            HandImpedanceController(arm, kinematics, plant.dt, self.payload)
            for arm in range(len(SIDES))
        ]
        self._controllers: list[Controller] = [
            *(
                JointTrajectoryController(group, kinematics, plant.dt, self.payload)
                for group in self._robot.groups
            ),
            *(self.impedance, *self.hands),
            SoftStopController(kinematics, plant.dt, self.payload),
        ]
        self._flush_listeners: list[Callable[[str], None]] = []
        self._before = deque([(plant.time, plant.q)], maxlen=2)
        """Time [s] and joints of the last arbiter's ticks."""
        if supervisor is not None:
            self._age_max_s = min(
                self._age_max_s,
                max(supervisor.config.measurement_age_max_s, 2.0 * plant.dt),
            )
            supervisor.expected = self._expected
        self.reset()

    def reset(self) -> None:
        """Start at the measured posture, hands as they are; call at every plant reset.

        Flush listeners stay.

        Raises:
            UsageError: The arms move.
        """
        plant = self.plant
        q = self.plant.q
        fastest = self._fastest()
        if not fastest < self._config.still_speed_rad_s:
            raise UsageError(
                f"the arms move at {fastest:.3f} rad/s; control starts at rest",
                remedy="stop them first",
            )
        if self.supervisor is not None:
            emergency.check()  # before the hands are told anything
        self.grippers.reset()
        if self.supervisor is not None:
            self.supervisor.reset()
            if self.grippers.closed.any() and plant.tau.any() and np.isfinite(plant.tau).all():
                self.supervisor.reset(plant.tau)  # what holds an object goes on
        self._failed: Exception | None = None
        """What the next step stops for, whatever resumes until then."""
        self._before.extend([(plant.time, q)] * 2)
        self._ticked_s = plant.time
        self._v = plant.v
        self._stand()
        self.manager = ControllerManager(self._controllers, plant.dt, self._robot)
        self.impedance.forget()
        self.payload.reset()
        for hand in self.hands:
            hand.law.held = InHand()
            hand.law.other = None
        self.manager.switch(DEFAULT_CONTROLLERS, q, np.zeros_like(q))
        self.refusals = list[Refusal]()
        self.refused_n = 0
        """The last of the refused_n since the reset: a source may be refused at its rate, for days."""
        self.applied = np.array(self.kinematics.gravity(q))
        """Last torques (n,) [Nm], after the supervisor."""
        self._off: SwitchedOff | None = None
        self._back: tuple[int, ...] = ()
        self._back_until_s = -math.inf

    def _fastest(self) -> float:
        """Return the largest speed [rad/s], also by positions: velocities may be what has failed."""
        (then_s, q_then) = self._before[0]
        plant = self.plant
        if not plant.time > then_s:  # the plant was reset
            q_then = plant.q
        moved = (plant.q - q_then) / max(plant.time - then_s, plant.dt)
        return float(
            np.max(np.abs([plant.v, 0.25 * moved])),
        )  # arms that have just come to rest were faster

    def _stand(self) -> None:
        gripper = self.grippers.openings
        self.arbiter = CommandArbiter(
            self._robot,
            self._config,
            gripper=gripper,
            control_dt_s=self.plant.dt,
            admit=lambda command: self.manager.refuses(command),
        )
        self.arbiter.speed = self._speed
        self.arbiter.on_flush = self._flush_listeners
        self.arbiter.on_confirm = self._confirmed
        self._wanted: dict[str, tuple[str, ...]] = {}
        self._countdown = 0
        self._due = True
        self._pending = False
        self.output = ArbiterOutput(self.plant.q, gripper, ArbiterState.HOLDING, None, None, ())
        self._openings = gripper.copy()  # who reads the output may change its arrays
        self.reflex: MinidualError | None = None
        """Of the latched reflex."""
        self._stop_ticks = 0

    # Commands --------------------------------------------------------------------------------------------

    def affirm(self, source: str) -> None:
        """Report a source as alive; call at the arbiter's rate."""
        self.arbiter.affirm(source)

    def propose(self, source: str, command: Command) -> Refusal | None:
        """Offer a command; return its refusal, or None."""
        refusal = self.arbiter.propose(source, command)
        if refusal is None and not isinstance(command, JointCommand):
            self._due = True
            self._pending = self._pending or source == self.source
        return refusal

    def request(self, mode: str, controllers: Sequence[str] | None = None) -> None:
        """Request a source, or "hold".

        Confirmation activates `controllers`: by default `both_arms`, for "hold" the active set. If the mode already
        drives, a named set takes over at once.

        Raises:
            UsageError: Unknown name, or a source requested during a reflex.
            ControllerSwitchError: The set is refused, or a timed command is running.
        """
        named = controllers is not None
        if controllers is None:
            controllers = self.manager.active if mode == HOLD else DEFAULT_CONTROLLERS
        self.manager.check(controllers)
        if self.reflex is not None and mode != HOLD:
            stopped = (
                f"'{mode}' may not drive: the supervisor stopped the arms ({self.reflex.message})"
            )
            raise UsageError(stopped, remedy="find the cause, then recover()")
        if mode == self.source:  # no switch follows that could activate the set
            if named and tuple(controllers) != self.manager.active:
                self.switch_controllers(controllers)
            controllers = self.manager.active
        self.arbiter.request(mode)
        if named or mode != HOLD:
            self._wanted[mode] = tuple(controllers)
        else:  # the set active at confirmation: switch_controllers may come first
            self._wanted.pop(HOLD, None)
        self._due = True

    def switch_controllers(self, names: Sequence[str]) -> None:
        """Change the controllers at once, keeping the mode.

        Raises:
            ControllerSwitchError: Refused set, or a running timed command.
        """
        self.manager.check(names)
        if self.executing:
            remedy = 'wait for its end, or request("hold")'
            raise ControllerSwitchError("under_way", "a timed command is under way", remedy=remedy)
        if not np.isfinite(self.plant.q).all():
            raise ControllerSwitchError("not_ready", f"the arms are not measured: {self.plant.q}")
        if self.stopping:  # others would bring them back to where they were at the switch
            raise ControllerSwitchError(
                "under_way",
                "the arms are being stopped",
                remedy="switch once they rest",
            )
        active = self.manager.active
        if active in (OBJECT_CONTROLLERS, _STOPPING) or any(
            hand.name in active for hand in self.hands
        ):
            kept = [
                any(arm in self.manager[name].arms for name in set(names) & set(active))
                for arm in (0, 1)
            ]
            keeps = np.repeat(kept, self._robot.dof_per_arm)
            v = slower(self.plant.v, self._v)
            self.arbiter.stand(
                np.where(keeps, self.output.q_target, self.plant.q),
                np.where(keeps, 0.0, v),
            )
        self.manager.switch(names, self.plant.q, slower(self.plant.v, self._v))
        self._due = True

    @property
    def speed_override(self) -> float:
        """Share of full speed, 0.1 to 1, also in motion.

        Raises:
            UsageError: When set outside its range.
        """
        return self._speed

    @speed_override.setter
    def speed_override(self, share: float) -> None:
        if not SPEED_OVERRIDE_MIN <= share <= 1.0:
            raise UsageError(
                f"a speed override of {share} is refused; it may be {SPEED_OVERRIDE_MIN} to 1.0",
            )
        self._speed = self.arbiter.speed = float(share)
        self._due = True

    def halt(self, source: str, gripper: Array | None = None) -> None:
        """Stop the arms in the next step; no source drives afterwards.

        `soft_stop` drives until the next mode. `gripper`: see `CommandArbiter.halt`.
        """
        self.arbiter.halt(source, gripper)
        self._due = True
        self._stop_ticks = round(_STOP_MAX_S / self.plant.dt)

    def switch_off(self, arms: Sequence[int]) -> None:
        """Ramp these arms' torque to zero until reset; replaces an earlier call. Where drives return, nobody drives."""
        if self._off is None:
            self._off = SwitchedOff(arms, self.applied, self.plant.dt, self._robot)
        returned = sorted(set(self._off.arms) - set(arms))
        self._off.arms = tuple(arms)
        if returned:
            self._back = tuple(returned)
            self._back_until_s = self.plant.time + _BACK_S
        if returned and self.supervisor is not None and self.reflex is not None:
            self.supervisor.brake_anew(self.applied)
        elif returned and np.isfinite(self.plant.q + self.plant.v).all():  # where the arms are now
            self._interrupt()
            q = self.plant.q
            v = slower(self.plant.v, self._v)
            back = np.repeat([arm in returned for arm in (0, 1)], self._robot.dof_per_arm)
            self.arbiter.stand(q, np.where(back, 0.0, v))
            for name in self.manager.active:
                self.manager[name].regain(returned, q, v)

    def on_flush(self, listener: Callable[[str], None]) -> None:
        """Call `listener(mode)` at every switch or halt; sources must drop queued chunks."""
        self._flush_listeners.append(lambda mode: self._attempt(lambda: listener(mode), None))

    def recover(self) -> None:
        """Resume after a reflex at the measured posture, from the torques applied last; no source drives.

        Raises:
            UsageError: The arms move, or are not measured.
        """
        q = self.plant.q
        v = self.plant.v
        still = self._config.still_speed_rad_s
        stamp_s = self.plant.stamp_s
        speed = self._fastest()
        age_s = math.nan if stamp_s is None else self.plant.time - stamp_s
        if not (speed < still and np.isfinite(q).all() and abs(age_s) <= self._age_max_s):
            measured = f"{speed:.3f} rad/s; at rest is below {still} rad/s; measured {1e3 * age_s:.0f} ms ago"
            remedy = f"go on with step() until they rest and are measured (within {1e3 * self._age_max_s:.0f} ms)"
            raise UsageError(
                f"the arms may not recover while they move ({measured})",
                remedy=remedy,
            )
        self.manager.switch(
            DEFAULT_CONTROLLERS if self.grippers.fault else self.manager.active,
            q,
            v,
        )
        for name in self.manager.active:  # first: what fails leaves the stop latched
            self.manager[name].activate(q, v)
        self.manager.fade_left = 0  # from torques that were never applied
        if isinstance(self.reflex, ReflexError) and self.reflex.reflex.name == "gripper_opened":
            self.grippers.forget_grip(excused=True)  # what is lost in the stop is yet to be named
        if self.supervisor is not None:
            self.supervisor.reset(self.applied)
        self._stand()
        self.request(HOLD)

    # State -----------------------------------------------------------------------------------------------

    def refused_since(self, n: int) -> list[Refusal]:
        """Return what was refused after the first n since the reset."""
        return self.refusals[max(0, n - self.refused_n + len(self.refusals)) :]

    @property
    def source(self) -> str | None:
        """Source that may drive, or None."""
        return self.arbiter.source

    @property
    def state(self) -> ArbiterState:
        """State of the arbiter."""
        return self.arbiter.state

    @property
    def stopping(self) -> bool:
        """Whether a reflex or a halt is bringing the arms to rest, for 2 s at most."""
        return self._stop_ticks > 0 and not self._fastest() < self._config.still_speed_rad_s

    @property
    def calm(self) -> bool:
        """Whether no joint moves too fast for a trajectory to start, with a margin."""
        return float(np.max(np.abs(self.plant.v))) < 0.8 * START_RAD_PER_S

    @property
    def executing(self) -> bool:
        """Whether a timed command runs or waits."""
        return self._pending or bool(
            [e for e in self.arbiter.underway.executions if not e.finished],
        )

    @property
    def tick_next(self) -> bool:
        """Whether the next `step` has a regular arbiter tick."""
        return self._countdown == 0

    # Control loop ----------------------------------------------------------------------------------------

    def step(self) -> None:
        """Run one control tick, after the arbiter's if due.

        Raises:
            ReflexError: Once, after the tick that triggered it.
        """
        if self._countdown == 0 or self._due:
            self.arbitrate()
        self._countdown = (self._countdown - 1) % self.every
        self.advance()

    def fail(self, error: Exception) -> None:
        """Stop the arms in the next tick: something that the loop calls has failed.

        Raises:
            Exception: `error`, without a supervisor.
        """
        if self.supervisor is None:
            raise error
        self._failed = self._failed or error

    def _attempt[T](self, part: Callable[[], T], otherwise: T) -> T:
        try:
            return part()
        except Exception as error:
            self._failed = self._failed or error
            return otherwise

    def arbitrate(self) -> ArbiterOutput:
        """Run an arbiter tick now, for callers with their own timing.

        Raises:
            EmergencyStop: It was pressed, and no supervisor answers it.
        """
        return self._attempt(self._arbitrate, self.output)

    def _arbitrate(self) -> ArbiterOutput:
        plant = self.plant
        if self.supervisor is None:  # nothing could brake the arms
            emergency.check()
        q = plant.q
        v = plant.v
        self._due = False
        output = self.arbiter.tick(
            plant.time,
            q,
            v,
            self._unsagged(q, v) if self.arbiter.switching else None,
        )
        self.output = output
        if self.reflex is None:
            self._openings = output.gripper.copy()
        self.payload.idle = (
            (0, 1) if self.reflex is not None else () if self._off is None else self._off.arms
        )
        if self.supervisor is not None:  # so that a silent arbiter triggers stale_command
            self.supervisor.heard(plant.time)
        if output.refusals:
            self.refused_n += len(output.refusals)
            self.refusals = [*self.refusals, *output.refusals][-_REFUSALS_KEPT:]
        self._pending = False
        if plant.time > min(
            self._before[-1][0],
            self._ticked_s,
        ):  # where the clock goes on, also one that began anew
            self._before.append((plant.time, q))
        self._ticked_s = plant.time
        self._attempt(lambda: self._hand_down(output.halted), None)
        if output.halted:
            self._wanted.pop(HOLD, None)  # overrides even a set named with "hold"
            self.manager.switch(_STOPPING, plant.q, slower(plant.v, self._v), swiftly=True)
        self._attempt(lambda: self.manager.follow(output), None)
        hands = self.grippers
        self.payload.follow(
            output.gripper,
            [hands.lost(0), hands.lost(1)],
            [hands.holds(0), hands.holds(1)],
        )
        return output

    def _hand_down(self, stops: bool) -> None:
        if self.manager.active == OBJECT_CONTROLLERS:
            self.payload.take_over(self.impedance.bears_n)
        elif stops and self.supervisor is not None:  # nobody may have told what the hands lift
            holding = [arm for arm in (0, 1) if self.grippers.holds(arm)]
            self.payload.feel(self.plant.q, self.supervisor.steady, holding)

    def _unsagged(self, q: Array, v: Array) -> Array | None:
        """Return the posture (n,) without the sag of resting arms under a load, or None; at q they would sag again."""
        reference = self.manager.reference
        sag = np.abs(reference - q).max()
        still = np.abs(v).max() < self._config.still_speed_rad_s
        if self.manager.active == _STOPPING or not (still and _SAG_MIN_RAD <= sag <= _SAG_MAX_RAD):
            return None
        held = q.copy()
        wanted = [T[2, 3] for T in self.kinematics.tcp_poses(reference)]
        for arm, T in enumerate(self.kinematics.tcp_poses(q)):
            if T[2, 3] < wanted[arm]:  # something else has moved a hand that is not lower
                joints = self._robot.joints_of(arm)
                held[joints] = reference[joints]
        return held

    def advance(self) -> None:
        """Run one control and physics step on the arbiter's last output.

        Raises:
            ReflexError: Once, after the step; without a supervisor the controller's or plant's error.
        """
        plant = self.plant
        self._stop_ticks -= 1
        try:  # a closure for `_attempt` would cost more than the call
            for execution in self.output.executions:
                execution.step()
                self._due = self._due or execution.finished
        except Exception as error:
            self._failed = self._failed or error
        tau, stopped = self._torque(*(measured := self._measured()))
        self._v = measured[3]
        if self._off is not None:
            tau = self._off.limit(tau)
        given = self.applied
        self.applied = tau
        try:
            fingers_m = self.grippers.step(self._openings)
        except Exception as error:
            self._failed = self._failed or error
            fingers_m = self.grippers.targets_m
        try:
            try:
                plant.command(tau, fingers_m)
                given = tau
            finally:  # the arms go on moving, told or not
                if self.supervisor is not None and isinstance(stopped, ReflexError):
                    self.supervisor.tell(stopped)
                plant.step()
        except Exception as error:
            if self.supervisor is None or isinstance(error, PlantEndedError):
                raise
            self._failed = self._failed or error
            self.applied = given
            self.supervisor.resume(given)
        if stopped is not None:
            raise stopped

    def _measured(self) -> tuple[float, float | None, Array, Array]:
        plant = self.plant
        try:
            q = _row(plant.q, len(self.applied))
            v = _row(plant.v, len(self.applied))
            return (
                float(plant.time),
                None if (stamp_s := plant.stamp_s) is None else float(stamp_s),
                q,
                v,
            )
        except Exception as error:
            self._failed = self._failed or error
        nothing = np.full(self._robot.dof, np.nan)
        time_s, stamp_s = (
            self._attempt(lambda x=x: float(getattr(plant, x)), np.nan) for x in ("time", "stamp_s")
        )
        q, v = (
            self._attempt(lambda x=x: _row(getattr(plant, x), len(nothing)), nothing) for x in "qv"
        )
        return time_s, stamp_s, q, v

    def _torque(
        self,
        time_s: float,
        stamp_s: float | None,
        q: Array,
        v: Array,
    ) -> tuple[Array, Exception | None]:
        tau = self.applied
        acceleration = None
        if self._failed is None:
            try:
                tau, acceleration = self._asked(time_s, stamp_s, q, v)
                if self.supervisor is None and not np.isfinite(tau).all():
                    raise PlantError(
                        f"torques {tau} Nm are not finite",
                        remedy="see what measures joints and object",
                    )
            except Exception as error:
                self._failed = self._failed or error
        failed = self._failed
        self._failed = None
        if self.supervisor is None:
            return (tau, None) if failed is None else (self._fall_back(q, v), failed)
        try:
            if failed is None:
                return self.supervisor.guard(time_s, q, v, tau, acceleration, stamp_s), None
            why = (
                failed.message
                if isinstance(failed, MinidualError)
                else f"{type(failed).__name__}: {failed}"
            )
            return self.supervisor.fail(time_s, q, v, why, stamp_s), None
        except ReflexError as error:
            error.__cause__ = failed or error.__cause__
            self.reflex = error
            self._stop_ticks = round(_STOP_MAX_S / self.plant.dt)
            self.payload.idle = (0, 1)
            self._openings = self._attempt(self.grippers.stop, self._openings)
            self._attempt(partial(self._hand_down, error.reflex.name in _BEARING), None)
            self._attempt(lambda: self.request(HOLD), None)
            return error.tau, error
        except Exception as error:  # the supervisor's own: the next tick stops for it
            self._failed = error
            return self.applied, None

    def _asked(
        self,
        time_s: float,
        stamp_s: float | None,
        q: Array,
        v: Array,
    ) -> tuple[Array, Array | None]:
        if self.plant.health:
            if self.supervisor is not None:
                self.supervisor.brake_anew(self.applied, arrested=True)
            raise PlantError(f"the plant cannot be driven: {self.plant.health}")
        age_s = math.nan if stamp_s is None else time_s - stamp_s
        limit_s = self._age_max_s
        if not abs(age_s) <= limit_s + 1e-9:
            remedy = "see that the plant delivers its state; supervisor.measurement_age_max_s is how old it may be"
            raise PlantError(
                f"the measurements are {age_s:.3f} s old; limit {limit_s} s",
                remedy=remedy,
            )
        tau = self.manager.update(q, v)
        # Only torques that reach motors are guarded.
        return (tau if self._off is None else self._off.nearest(tau)), self.manager.acceleration

    def _expected(self) -> Expected:
        manager = self.manager
        grippers = self.grippers
        off = () if self._off is None else self._off.arms
        bears_n = self.payload.force_n
        if (
            0.0 < self._back_until_s - self.plant.time <= _BACK_S
        ):  # false where the clock began anew
            off = (*off, *self._back)
        if manager.active == OBJECT_CONTROLLERS:
            return Expected(
                "held object",
                self.impedance.load,
                manager.reference,
                grippers.fault,
                off,
                bears_n,
            )
        soft = any(
            hand.name in manager.active for hand in self.hands
        )  # dry joints hold a spring off
        if grippers.wide and not soft:  # until then fingers that open still touch what they held
            return Expected("free motion", None, manager.reference, "", off, bears_n)
        return Expected("closed hands", None, manager.reference, grippers.fault, off, bears_n)

    def _interrupt(self) -> bool:
        self.arbiter.underway.executions, interrupted = (), self.arbiter.underway.executions
        if self.source is not None or self.arbiter.switching:
            self.request(HOLD)
        return bool(interrupted)

    def _fall_back(self, q: Array, v: Array) -> Array:
        interrupted = self._interrupt()
        if not np.isfinite(q + v).all():
            return self.applied
        if interrupted or self.manager.active != DEFAULT_CONTROLLERS:
            self.arbiter.stand(q, slower(v, self._v))
            self.manager[DEFAULT_CONTROLLERS[0]].activate(
                q,
                v,
            )  # an active one would go on with what was interrupted
            self.manager.switch(DEFAULT_CONTROLLERS, q, v)
        return self.manager.update(
            q,
            v,
        )  # raises if these have failed: no others could hold the arms

    def _confirmed(self, mode: str) -> None:
        self._stop_ticks = 0
        names = self._wanted.pop(mode, self.manager.active)
        if names != self.manager.active:
            self.manager.switch(names, self.plant.q, self.plant.v)
