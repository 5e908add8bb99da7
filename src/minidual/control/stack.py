"""The control stack: sources propose, the arbiter decides, the loop drives the plant.

Example: docs/control.md. The parts of a tick are in loop.py; arbitration comes between its reading and its law.
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from minidual import emergency
from minidual.config.control import ArbiterConfig
from minidual.control.arbiter import ArbiterOutput, CommandArbiter
from minidual.control.commands import HOLD, ArbiterState, Command, JointCommand, Refusal
from minidual.control.controller_manager import ControllerSwitchError
from minidual.control.gripper import JOINT_PINCH_N, Grippers
from minidual.control.impedance_controllers import ObjectSensor
from minidual.control.loop import DEFAULT_CONTROLLERS, OBJECT_CONTROLLERS, ControlLoop
from minidual.control.measurement import Measurement
from minidual.control.stack_state import StackState
from minidual.control.supervisor import Supervisor
from minidual.errors import UsageError
from minidual.plant.lifecycle import braking_share
from minidual.plant.protocol import Plant
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array

__all__ = ["DEFAULT_CONTROLLERS", "OBJECT_CONTROLLERS", "ControlStack"]
_STOP_MAX_S = 2.0
_REFUSALS_KEPT = 1000


class ControlStack[P: Plant](StackState):
    """Drives one plant.

    Args:
        rate_hz: Of the arbiter in `step`; divides the control rate.
        supervisor: By default one that compares nothing with bounds.
        sensor: Required to activate controller C.

    Attributes:
        every: Control steps from one regular arbiter tick to the next.
        output: Last output of the arbiter.
    """

    # A plant and its kinematics; the others are options.
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
        self.plant: Final = plant
        self.kinematics = kinematics
        self._robot = kinematics.robot
        config = ArbiterConfig() if config is None else config
        settle_s = config.settle_timeout_s / braking_share(plant)
        self._config = config.model_copy(update={"settle_timeout_s": settle_s})
        self._speed = self._config.speed_override
        self.every = _steps_per_tick(rate_hz, plant.dt)
        if supervisor is None:
            own = Kinematics(self._robot)
            supervisor = Supervisor(dt_s=plant.dt, kinematics=own, bounded=False)
        if abs(supervisor.dt_s - plant.dt) > 1e-9:
            periods = f"the supervisor's period is {supervisor.dt_s} s, the plant's {plant.dt} s"
            raise UsageError(periods, remedy="make the supervisor with dt_s=plant.dt")
        self.supervisor = supervisor
        self.grippers = Grippers(
            plant,
            pinch_force_n=pinch_force_n,
            speed_m_per_s=self._config.finger_speed_m_per_s,
        )
        still = self._config.still_speed_rad_s
        emergency.check()
        self._loop = ControlLoop(plant, kinematics, self.grippers, supervisor, sensor, still)
        self._loop.on_reflex = self._stop
        self.payload = self._loop.payload
        self.impedance = self._loop.impedance
        self.hands = self._loop.hands
        self._flush_listeners: list[Callable[[str], None]] = []
        self._begin()

    def reset(self) -> None:
        """Start at the measured posture, hands as they are; call at every plant reset.

        Flush listeners stay.

        Raises:
            UsageError: The arms move, or are not measured.
            EmergencyStop: It was pressed.
        """
        emergency.check()  # before the hands are told anything
        self._loop.reset()
        self._begin()

    def _begin(self) -> None:
        self.refusals = list[Refusal]()
        self.refused_n = 0
        self._stand()

    def _stand(self) -> None:
        """Begin with a new arbiter that holds the measured posture."""
        openings = self.grippers.openings
        self.arbiter = CommandArbiter(
            self._robot,
            self._config,
            gripper=openings,
            control_dt_s=self.plant.dt,
            admit=lambda command: self.manager.refuses(command),
        )
        self.arbiter.speed = self._speed
        self.arbiter.on_flush = self._flush_listeners
        self.arbiter.on_confirm = self._confirmed
        self._requested_controllers: dict[str, tuple[str, ...]] = {}
        self._countdown = 0
        self._due = True
        self._pending = False
        q = self.measurement.q
        self.output = ArbiterOutput(q, openings, ArbiterState.HOLDING, None, None, ())
        self._stop_ticks = 0

    # Commands ------------------------------------------------------------------------------------------------

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
            raise UsageError(
                f"'{mode}' may not drive: the supervisor stopped the arms ({self.reflex.message})",
                remedy="find the cause, then recover()",
            )
        if mode == self.source:  # no switch follows that could activate the set
            if named and tuple(controllers) != self.manager.active:
                self.switch_controllers(controllers)
            controllers = self.manager.active
        self.arbiter.request(mode)
        if named or mode != HOLD:
            self._requested_controllers[mode] = tuple(controllers)
        else:  # the set active at confirmation: switch_controllers may come first
            self._requested_controllers.pop(HOLD, None)
        self._due = True

    def switch_controllers(self, names: Sequence[str]) -> None:
        """Change the controllers at once, keeping the mode.

        Raises:
            ControllerSwitchError: Refused set, a running timed command, or arms that are being stopped.
        """
        self.manager.check(names)
        if self.executing:
            remedy = 'wait for its end, or request("hold")'
            raise ControllerSwitchError("under_way", "a timed command is under way", remedy=remedy)
        if self.stopping:  # others would bring them back to where they were at the switch
            remedy = "switch once they rest"
            raise ControllerSwitchError("under_way", "the arms are being stopped", remedy=remedy)
        q = self.measurement.q
        v = self._loop.v_slower
        active = self.manager.active
        if (
            self.manager.compliant
        ):  # its hands need not be at their target: others start where they are
            kept = set(names) & set(active)
            keeps_arm = [
                any(arm in self.manager[name].arms for name in kept) for arm in range(len(SIDES))
            ]
            keeps = self._robot.per_joint(keeps_arm)
            self.arbiter.stand(np.where(keeps, self.output.q_target, q), np.where(keeps, 0.0, v))
        self.manager.switch(names, q, v)
        self._due = True

    def halt(self, source: str, gripper: Array | None = None) -> None:
        """Stop the arms in the next step; no source drives afterwards.

        `soft_stop` drives until the next mode. `gripper`: see `CommandArbiter.halt`.
        """
        self.arbiter.halt(source, gripper)
        self._due = True
        self._stop_ticks = round(_STOP_MAX_S / self.plant.dt)

    def on_flush(self, listener: Callable[[str], None]) -> None:
        """Call `listener(mode)` at every switch or halt; sources must drop queued chunks."""

        def guarded(mode: str) -> None:
            try:
                listener(mode)
            except Exception as error:
                self.fail(error)

        self._flush_listeners.append(guarded)

    def fail(self, error: Exception) -> None:
        """Stop the arms in the next tick: something that the loop calls has failed."""
        self._loop.fail(error)

    def recover(self) -> None:
        """Resume after a reflex at the measured posture, from the torques applied last; no source drives.

        Raises:
            UsageError: The arms move or are not measured, or the plant reports a fault.
        """
        self._loop.recover()
        self._stand()
        self.request(HOLD)

    # Control loop --------------------------------------------------------------------------------------------

    def step(self) -> None:
        """Run one control tick, after the arbiter's if due.

        Raises:
            ReflexError: Once, after the tick that triggered it.
        """
        if self._countdown == 0 or self._due:
            self.arbitrate()
        self._countdown = (self._countdown - 1) % self.every
        self.advance()

    def arbitrate(self) -> ArbiterOutput:
        """Run an arbiter tick now, for callers with their own timing."""
        try:
            self._arbitrate(self.measurement)
        except Exception as error:
            self.fail(error)
        return self.output

    def advance(self) -> None:
        """Run one control and physics step on the arbiter's last output.

        Raises:
            ReflexError: Once, after the step that triggered it.
            PlantEndedError: There is nothing left to drive.
        """
        self._stop_ticks -= 1
        executions = self.output.executions
        reflex = self._loop.advance(executions)
        self._due = self._due or any(execution.finished for execution in executions)
        if reflex is not None:
            self.supervisor.tell(reflex)
            raise reflex

    def _arbitrate(self, measurement: Measurement) -> None:
        self._due = False
        output = self.arbiter.tick(measurement.time_s, measurement.q, measurement.v)
        self.output = output
        self._pending = False
        self.refused_n += len(output.refusals)
        self.refusals = [*self.refusals, *output.refusals][-_REFUSALS_KEPT:]
        if output.halted:
            self._requested_controllers.pop(HOLD, None)  # overrides even a set named with "hold"
        self._loop.follow(output)

    def _stop(self) -> None:
        """Answer a reflex: nobody drives."""
        self._stop_ticks = round(_STOP_MAX_S / self.plant.dt)
        self.request(HOLD)

    def _confirmed(self, mode: str) -> None:
        self._stop_ticks = 0
        names = self._requested_controllers.pop(mode, self.manager.active)
        if names != self.manager.active:
            self.manager.switch(names, self.measurement.q, self.measurement.v)


def _steps_per_tick(rate_hz: float, dt_s: float) -> int:
    """Return the control steps of one arbiter period.

    Raises:
        UsageError: The arbiter's rate does not divide the control rate.
    """
    steps = 1.0 / (rate_hz * dt_s)
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-6:
        raise UsageError(
            f"rate_hz {rate_hz} does not divide the control rate of {1.0 / dt_s:g} Hz",
            remedy="take a divisor of it, such as 50 or 100",
        )
    return round(steps)
