"""The one way to move the arms: arbiter, controllers, supervisor and plant in one control loop.

    stack = ControlStack(plant, kinematics)
    stack.request("moveit")
    while stack.source != "moveit":
        stack.step()
    stack.propose("moveit", TrajectoryCommand(trajectory, np.ones(2), plant.time, 1))
    while stack.executing:
        stack.affirm("moveit")
        stack.step()

One `step` is one tick of 1 kHz: the arbiter runs when it is due (at its own rate, and at once when a timed command was
proposed or has ended), the active controllers give torques, the supervisor bounds or stops them, the plant moves. See
docs/control.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from minidual.config.arbiter import ArbiterConfig
from minidual.control.arbiter import CommandArbiter
from minidual.control.commands import HOLD, ArbiterState, Command, JointCommand, Refusal
from minidual.control.controller_manager import ControllerManager, ControllerSwitchError
from minidual.control.controllers import Controller, JointTrajectoryController
from minidual.control.execution import ArbiterOutput
from minidual.control.gripper import JOINT_PINCH_N, Grippers
from minidual.control.object_controller import ObjectImpedanceController, ObjectSensor
from minidual.control.soft_stop import STOP_SHARE, SoftStopController, SwitchedOff
from minidual.control.supervisor import Supervisor
from minidual.errors import MinidualError, UsageError
from minidual.plant.protocol import Plant
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array

DEFAULT_CONTROLLERS: tuple[str, ...] = ("both_arms",)
"""Active until another set is asked for."""
OBJECT_CONTROLLERS: tuple[str, ...] = ("object_impedance",)
"""Active with an object in both hands."""
_STOPPING: tuple[str, ...] = ("soft_stop",)


class PlantError(MinidualError):
    """The plant cannot be driven, or its measurements are too old."""


class ControlStack[P: Plant]:
    """Drives one plant.

    Args:
        plant: The arms.
        kinematics: Dynamics of the controllers.
        config: Bounds and times of the arbiter.
        rate_hz: Rate of the arbiter in `step`.
        controllers: The set to begin with.
        pinch_force_n: Force with which the hands close.
        supervisor: Guards the torques; None guards nothing.
        sensor: Tells controller C of the object; without one it cannot be activated.
        stop_share: Deceleration of a halt, as a share of the joints' limits.
    """

    def __init__(
        self,
        plant: P,
        kinematics: Kinematics,
        config: ArbiterConfig | None = None,
        *,
        rate_hz: float = 50.0,
        controllers: Sequence[str] = DEFAULT_CONTROLLERS,
        pinch_force_n: float = JOINT_PINCH_N,
        supervisor: Supervisor | None = None,
        sensor: ObjectSensor | None = None,
        stop_share: float = STOP_SHARE,
    ) -> None:
        self.plant = plant
        self.supervisor = supervisor
        self._config = ArbiterConfig() if config is None else config
        self._initial = tuple(controllers)
        steps = 1.0 / (rate_hz * plant.dt)
        self._every = round(steps)
        if self._every < 1 or abs(steps - self._every) > 1e-6:
            raise UsageError(
                f"rate_hz {rate_hz} does not divide the control rate of {1.0 / plant.dt:g} Hz",
                remedy="take a divisor of it, such as 50 or 100",
            )
        self._robot = kinematics.robot
        self.grippers = Grippers(plant, pinch_force_n=pinch_force_n)
        table: list[Controller] = [
            JointTrajectoryController(group, kinematics, plant.dt) for group in ("both_arms", "left_arm", "right_arm")
        ]
        self.impedance = ObjectImpedanceController(
            kinematics, plant.dt, sensor, drives=lambda: self.impedance.name in self.manager.active
        )
        stop = SoftStopController(kinematics, plant.dt, deceleration_share=stop_share)
        self.manager = ControllerManager([*table, self.impedance, stop], plant.dt, self._robot)
        self.manager.check(self._initial)
        self._flush_listeners: list[Callable[[str], None]] = []
        self.reset()

    def reset(self) -> None:
        """Start from where the arms are, hands open, nobody driving, nothing held; call it with every reset of the plant.

        Listeners stay.
        """
        plant = self.plant
        self.arbiter = CommandArbiter(
            self._robot, self._config, control_dt_s=plant.dt, admit=lambda command: self.manager.find_fault(command)
        )
        self.arbiter.on_flush = self._flush_listeners
        self.arbiter.on_confirm.append(self._confirmed)
        self.manager = ControllerManager([self.manager[name] for name in self.manager.names], plant.dt, self._robot)
        self.impedance.forget()
        self.grippers.reset()
        q = plant.q
        self.manager.switch(self._initial, q, np.zeros_like(q))
        self._wanted: dict[str, tuple[str, ...]] = {}
        self._countdown = 0
        self._due, self._pending = True, False
        self.output = ArbiterOutput(q, np.ones(2), ArbiterState.HOLDING, None, (), None, ())
        """What the arbiter let through at its last tick."""
        self.refusals: list[Refusal] = []
        """Everything refused since the reset."""
        self.reflex: MinidualError | None = None
        """What the supervisor stopped the arms for, or None."""
        self.applied = np.zeros_like(q)
        """Torques (n,) [Nm] of the last control step, as the supervisor let them through."""
        self._off: SwitchedOff | None = None
        self._reset_supervisor()

    # What sources say ------------------------------------------------------------------------------------

    def propose(self, source: str, command: Command) -> Refusal | None:
        """Offer a command; return why it is refused, or None. What depends on the posture is judged at the next tick.

        Raises:
            UsageError: There is no such source.
        """
        refusal = self.arbiter.propose(source, command)
        if refusal is None and not isinstance(command, JointCommand):
            self._due = self._pending = True
        return refusal

    def affirm(self, source: str) -> None:
        """Say that a source is alive; call it at the arbiter's rate while its timed command runs.

        Raises:
            UsageError: There is no such source.
        """
        self.arbiter.affirm(source)

    def request(self, mode: str, controllers: Sequence[str] | None = None) -> None:
        """Ask for a source to drive, or for "hold".

        Args:
            mode: One of the sources, or "hold".
            controllers: Set to activate when the switch is confirmed; by default `both_arms`, for "hold" those active then.
                If the mode drives already, a named set takes over at once, as by `switch_controllers`.

        Raises:
            UsageError: There is no such mode or controller.
            ControllerSwitchError: The set would not claim every joint exactly once, or is not ready; or the mode
                drives already and a timed command is under way.
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
        if mode == self.source:  # no switch will come that could bring the set
            if named and tuple(controllers) != self.manager.active:
                self.switch_controllers(controllers)
            controllers = self.manager.active
        self.arbiter.request(mode)
        if named or mode != HOLD:
            self._wanted[mode] = tuple(controllers)
        else:  # those that are active when it is confirmed: an own switch may come before
            self._wanted.pop(HOLD, None)
        self._due = True

    def switch_controllers(self, names: Sequence[str]) -> None:
        """Change the active controllers between two control steps, while the mode stays.

        Raises:
            UsageError: There is no such controller.
            ControllerSwitchError: The set is refused, or a timed command is under way. Nothing has changed.
        """
        self.manager.check(names)
        if self.executing:
            raise ControllerSwitchError(
                "under_way", "a timed command is under way", remedy='wait for its end, or request("hold")'
            )
        self.manager.switch(names, self.plant.q, self.plant.v)
        self._due = True

    def halt(self, source: str, gripper: Array | None = None) -> None:
        """Stop the arms in the next step from where they are, whatever is under way; nobody drives afterwards.

        Controller `soft_stop` takes over in that step, until the next mode that is requested brings its own.

        Args:
            source: Who asks.
            gripper: Openings (2,) to take, from the driving source only; by default the hands stay as they are.

        Raises:
            UsageError: There is no such source.
        """
        self.arbiter.halt(source, gripper)
        self._due = True

    def switch_off(self, arms: Sequence[int]) -> None:
        """Command no torque to these arms until the reset, so that dead drives that come back find none.

        The torque falls to zero at the drives' rate. Arms named before stay off only if they are named again.
        """
        self._off = SwitchedOff(arms, self.applied, self.plant.dt, self._robot)

    def on_flush(self, listener: Callable[[str], None]) -> None:
        """Call `listener(mode)` whenever a switch to `mode` begins, so that sources drop queued chunks too."""
        self._flush_listeners.append(listener)

    def recover(self) -> None:
        """Go on after a reflex: the controllers take over where the arms stand, nobody drives."""
        self._reset_supervisor()
        self.reflex = None
        for name in self.manager.active:
            self.manager[name].activate(self.plant.q, self.plant.v)
        self.request(HOLD)

    # What is seen ----------------------------------------------------------------------------------------

    @property
    def source(self) -> str | None:
        """The source that may drive, or None."""
        return self.arbiter.source

    @property
    def state(self) -> ArbiterState:
        """What the arbiter did in its last tick."""
        return self.arbiter.state

    @property
    def executing(self) -> bool:
        """Whether a timed command is under way, or waits to be taken at the next tick."""
        return self._pending or bool([e for e in self.arbiter.executions if not e.finished])

    @property
    def tick_next(self) -> bool:
        """Whether the next `step` begins with a regular tick of the arbiter: propose streamed commands then."""
        return self._countdown == 0

    @property
    def reference(self) -> Array:
        """Joint references (n,) [rad] of the last control step."""
        return self.manager.reference

    @property
    def tau(self) -> Array:
        """Torques (n,) [Nm] that the controllers gave in the last control step."""
        return self.manager.tau

    # What runs -------------------------------------------------------------------------------------------

    def step(self) -> None:
        """Run one tick of 1 kHz, the arbiter's before it when it is due.

        Raises:
            ReflexError: Once, after the tick in which the supervisor stopped the arms; further steps bring them to rest.
        """
        if self._countdown == 0 or self._due:
            self.arbitrate()
        if self._countdown == 0:
            self._countdown = self._every
        self._countdown -= 1
        self.advance()

    def arbitrate(self) -> ArbiterOutput:
        """Run a tick of the arbiter now; sessions that keep time themselves call this and `advance`."""
        plant = self.plant
        output = self.arbiter.tick(plant.time, plant.q, plant.v)
        self.output = output
        if self.supervisor is not None:  # should the arbiter fall silent itself, the supervisor stops the arms
            self.supervisor.heard(plant.time)
        if output.refusals:
            self.refusals.extend(output.refusals)
        self._due = self._pending = False
        if output.halted:
            self._wanted.pop(HOLD, None)  # even a set that a hold has named: the stop holds the arms
            self.manager.switch(_STOPPING, plant.q, plant.v, swiftly=True)
        self.manager.follow(output)
        return output

    def advance(self) -> None:
        """Run one control and physics step on the arbiter's last output.

        Raises:
            ReflexError: Once, after the step; without a supervisor the error of the controller or plant.
        """
        plant, output = self.plant, self.output
        for execution in output.executions:
            execution.step()
            if execution.finished:
                self._due = True
        q, v = plant.q, plant.v
        if self._off is not None:
            self._off.step()
        tau, stopped = self._torque(q, v)
        if self._off is not None:
            tau = self._off.apply(tau)
        self.applied = tau
        plant.command(tau, self.grippers.step(output.gripper))
        plant.step()
        if stopped is not None:
            raise stopped

    def _torque(self, q: Array, v: Array) -> tuple[Array, MinidualError | None]:
        """Return the torques (n,) [Nm] of this tick, and the error that stopped the arms in it, if one did."""
        failed: MinidualError | None = None
        tau = self.applied
        try:
            self._check_plant()
            tau = self.manager.update(q, v)
            if self._off is not None:  # the supervisor need not guard what no motor is told
                tau = self._off.apply(tau)
        except MinidualError as error:
            failed = error
        if self.supervisor is None:
            return (tau, None) if failed is None else (self._fall_back(failed, q, v), failed)
        try:
            if failed is not None:
                return self.supervisor.fail(self.plant.time, q, v, failed.message), None
            return self.supervisor.guard(self.plant.time, q, v, tau, self.manager.acceleration), None
        except MinidualError as error:
            if failed is not None:
                error.__cause__ = failed
            return self._stop(error), error

    def _check_plant(self) -> None:
        """Raise PlantError where the plant cannot be driven or its measurements are too old to control by."""
        plant, limit_s = self.plant, self._config.stale_s
        if plant.health:
            raise PlantError(f"the plant cannot be driven: {plant.health}")
        age_s = plant.time - plant.stamp_s
        if age_s > limit_s:
            raise PlantError(
                f"the measurements are {age_s:.3f} s old; limit {limit_s} s",
                remedy="see that the plant delivers its state; arbiter.stale_s is how old it may be",
            )

    def _stop(self, error: MinidualError) -> Array:
        """Take the arms from everybody; return the torque that the supervisor's error carries for this tick."""
        tau = getattr(error, "tau", None)
        if tau is None:  # no reflex, but misuse
            raise error
        self.reflex = error
        self.request(HOLD)
        return tau

    def _fall_back(self, error: MinidualError, q: Array, v: Array) -> Array:
        """Let the joint controllers hold the arms where they are; return their torque (n,) [Nm] of this tick."""
        if self.manager.active == DEFAULT_CONTROLLERS:  # nothing is left that could hold them
            raise error
        self.manager.switch(DEFAULT_CONTROLLERS, q, v)
        self.request(HOLD)
        return self.manager.update(q, v)

    def _reset_supervisor(self) -> None:
        if self.supervisor is not None:
            self.supervisor.reset()

    def _confirmed(self, mode: str) -> None:
        names = self._wanted.pop(mode, self.manager.active)
        if names != self.manager.active:
            self.manager.switch(names, self.plant.q, self.plant.v)
