"""The parts of the control loop that run in every tick: read, estimate, law, guard, write.

read       measurement.Reader       one validated measurement a tick
estimate   observer, payload        external torques, and what the hands carry
law        controller_manager       torques of the active controllers
guard      supervisor.Supervisor    bounds; a reflex that stops the arms
write      writer.PlantWriter       torques and finger targets to the plant

A plant that takes joint targets gets the controllers' reference, and the reference of the stop after a reflex. Its
controller makes the torques; the guard compares those that it measures.
"""

from collections.abc import Callable, Sequence

import numpy as np

from minidual.control.arbiter import ArbiterOutput
from minidual.control.controller_manager import ControllerManager
from minidual.control.controllers import Controller, JointTrajectoryController
from minidual.control.execution import Execution
from minidual.control.gripper import Grippers
from minidual.control.hand_impedance import InHand
from minidual.control.impedance_controllers import (
    HandImpedanceController,
    ObjectImpedanceController,
    ObjectSensor,
)
from minidual.control.joint_check import slower
from minidual.control.measurement import Measurement, Reader
from minidual.control.observer import Expected
from minidual.control.payload import Payload
from minidual.control.reflexes import ReflexError
from minidual.control.soft_stop import SoftStopController
from minidual.control.supervisor import Supervisor
from minidual.control.writer import PlantWriter, Reference
from minidual.errors import MinidualError, UsageError
from minidual.plant.lifecycle import catch_up
from minidual.plant.protocol import Plant
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array

DEFAULT_CONTROLLERS: tuple[str, ...] = ("both_arms",)
"""Active after a reset."""
OBJECT_CONTROLLERS: tuple[str, ...] = ("object_impedance",)
"""For an object in both hands."""
_STOPPING: tuple[str, ...] = ("soft_stop",)
_ARMS = tuple(range(len(SIDES)))
_NEEDS_TORQUE = "this plant takes joint targets, and an impedance law needs motor torques at 1 kHz"


class ControlLoop:
    """One plant's measurements, controllers, supervisor and hands.

    Attributes:
        writer: Sends what the loop decides to the plant.
        openings: Commanded hand openings (2,); NaN for fingers that stay where they are.
        reflex: Error of the latched reflex, or None.
        on_reflex: Called in the tick of a reflex, before its torques are written.
    """

    def __init__(
        self,
        plant: Plant,
        kinematics: Kinematics,
        grippers: Grippers,
        supervisor: Supervisor,
        sensor: ObjectSensor | None,
        still_rad_s: float,
    ) -> None:
        self._plant = plant
        self._kinematics = kinematics
        self._still_rad_s = still_rad_s
        self.grippers = grippers
        self.supervisor = supervisor
        self.reader = Reader(plant, supervisor.config)
        dt_s = plant.dt
        self.payload = Payload(kinematics, dt_s)
        self.impedance = ObjectImpedanceController(kinematics, dt_s, sensor)
        self.hands = [HandImpedanceController(arm, kinematics, dt_s, self.payload) for arm in _ARMS]
        self._controllers: list[Controller] = [
            *(
                JointTrajectoryController(group, kinematics, dt_s, self.payload)
                for group in kinematics.robot.groups
            ),
            self.impedance,
            *self.hands,
            SoftStopController(kinematics, dt_s, self.payload),
        ]
        v_max = kinematics.robot.v_max
        self.writer = PlantWriter(plant, grippers, v_max, self._reference, self.fail)
        if self.writer.by_position:
            supervisor.observer.leave_contacts_to_plant()
        supervisor.expected = self._expected
        supervisor.bear(self.payload.force_n)
        self.on_reflex: Callable[[], None] = lambda: None
        self.reset()

    def reset(self) -> None:
        """Start at the measured posture, hands as they are.

        Raises:
            UsageError: The arms move, or are not measured.
        """
        catch_up(self._plant)
        measurement = self.reader.first()
        self._check_rest(measurement, "control starts at rest", remedy="stop them first")
        self.reader.begin(measurement)
        self._measurement: Measurement | None = measurement
        self._v_last = measurement.v
        self.grippers.reset(measurement.fingers_m, measurement.grip_n)
        self.openings = self.grippers.openings
        self.supervisor.reset()
        self.reflex: ReflexError | None = None
        self._failed: Exception | None = None
        """Stops the arms in the next tick."""
        robot = self._kinematics.robot
        self.manager = ControllerManager(self._controllers, self._plant.dt, robot)
        if self.writer.by_position:
            compliant = (self.impedance, *self.hands)
            self.manager.forbidden = {law.name: _NEEDS_TORQUE for law in compliant}
        self.writer.begin(measurement.q)
        self.impedance.forget()
        self.payload.reset()
        for hand in self.hands:
            hand.law.held = InHand()
            hand.law.other = None
        self.manager.switch(DEFAULT_CONTROLLERS, measurement.q, np.zeros(robot.dof))
        tau = np.asarray(self._plant.tau, dtype=float)
        holding = self.grippers.closed.any() and tau.any() and np.isfinite(tau).all()
        gravity = np.array(self._kinematics.gravity(measurement.q))
        # The torques that hold an object go on.
        self.writer.applied = tau.copy() if holding else gravity

    def anticipate(self, period_s: float) -> None:
        """See `StackState.anticipate`; targets come with this period."""
        for controller in self._controllers:
            if isinstance(controller, JointTrajectoryController):
                controller.anticipate(period_s)

    def recover(self) -> None:
        """Resume after a reflex at the measured posture, from the torques applied last.

        Raises:
            UsageError: The arms move or are not measured, or the plant reports a fault.
        """
        catch_up(self._plant)
        measurement = self.reader.first()
        remedy = "go on with step() until they rest"
        self._check_rest(measurement, "the arms may not recover while they move", remedy=remedy)
        active = DEFAULT_CONTROLLERS if self.grippers.fault else self.manager.active
        self.manager.switch(active, measurement.q, measurement.v)
        for name in self.manager.active:  # first: what fails leaves the stop latched
            self.manager[name].activate(measurement.q, measurement.v)
        self.reader.begin(measurement)
        self._measurement = measurement
        self._v_last = measurement.v
        self.writer.resume(measurement.q)
        self._plant.brake(())
        self.manager.fade_left = 0  # from torques that were never applied
        if self.reflex is not None and self.reflex.reflex.name == "gripper_opened":
            self.grippers.forget_grip()
        self.supervisor.reset(holding=True)
        self.openings = self.grippers.openings
        self.reflex = None

    def _check_rest(self, measurement: Measurement, reason: str, *, remedy: str) -> None:
        speed = float(np.abs(measurement.v).max())
        still = self._still_rad_s
        if not speed < still:
            moving = f"the fastest joint moves at {speed:.3f} rad/s; still is below {still} rad/s"
            raise UsageError(f"{reason} ({moving})", remedy=remedy)

    @property
    def applied(self) -> Array:
        """Last torques (n,) [Nm] that the plant has taken, or has measured."""
        return self.writer.applied

    @property
    def measurement(self) -> Measurement:
        """Of this tick, validated; every part of the loop uses this one."""
        if self._measurement is None:
            self._measurement = self.reader.read(self.applied, self.supervisor.observer.needed)
        return self._measurement

    @property
    def v_slower(self) -> Array:
        """The slower of the last two velocities (n,) [rad/s] of each joint: one sample may be wrong."""
        return slower(self.measurement.v, self._v_last)

    def holds(self, hand: int) -> bool:
        """Return whether a hand has closed on something and feels it."""
        return self.grippers.holds(hand, self.measurement.fingers_m, self.measurement.grip_n)

    def fail(self, error: Exception) -> None:
        """Stop the arms in the next tick: something that the loop calls has failed."""
        self._failed = self._failed or error

    def follow(self, output: ArbiterOutput) -> None:
        """Take the arbiter's output of this tick."""
        measurement = self.measurement
        if self.reflex is None:
            self.openings = output.gripper.copy()  # who reads the output may change its arrays
        self.supervisor.heard(measurement.time_s)  # a silent arbiter triggers stale_command
        self._tell_payload()
        if output.halted:
            self.manager.switch(_STOPPING, measurement.q, self.v_slower, swiftly=True)
        self.payload.follow(
            output.gripper,
            [self.grippers.lost(hand, measurement.fingers_m) for hand in _ARMS],
            [self.holds(hand) for hand in _ARMS],
            stopped=self.reflex is not None,
        )
        self.manager.follow(output)

    def advance(self, executions: Sequence[Execution]) -> ReflexError | None:
        """Run one tick on the arbiter's last output; return the reflex that it has triggered.

        Raises:
            PlantEndedError: There is nothing left to drive.
        """
        measurement = self.measurement
        self._advance_executions(executions)
        tau, reflex = self._guard(measurement, self._law(measurement))
        self._v_last = measurement.v
        braking = self.reflex is not None and self.reader.braking_due
        self.writer.write(measurement, tau, self.openings, braking=braking)
        self._measurement = None
        return reflex

    def _advance_executions(self, executions: Sequence[Execution]) -> None:
        try:
            for execution in executions:
                execution.step()
        except Exception as error:
            self.fail(error)

    def _law(self, measurement: Measurement) -> Array:
        """Return the torques (n,) [Nm] that the active controllers ask for."""
        if self._failed is None and self.reflex is None:
            try:
                tau = self.manager.update(measurement.q, measurement.v)
            except Exception as error:
                self.fail(error)
            else:
                return self._measured_torques() if self.writer.by_position else tau
        return self.applied

    def _measured_torques(self) -> Array:
        """Return the torques (n,) [Nm] that a plant with drives of its own measures."""
        try:
            return np.array(self._plant.tau, dtype=float)
        except Exception as error:
            self.fail(error)
            return self.applied

    def _guard(self, measurement: Measurement, tau: Array) -> tuple[Array, ReflexError | None]:
        """Return the torques (n,) [Nm] to apply, and the reflex that this tick has triggered."""
        failed = self._failed
        self._failed = None
        try:
            if failed is None or measurement.fault is not None:
                acceleration = self.manager.acceleration if self.reflex is None else None
                return self.supervisor.guard(measurement, tau, self.applied, acceleration), None
            return self.supervisor.fail(measurement, self.applied, _reason(failed)), None
        except ReflexError as error:
            error.__cause__ = failed or error.__cause__
            self._stop(measurement, error)
            return error.tau, error
        except Exception as error:  # the supervisor's own: the next tick stops for it
            self.fail(error)
            return self.applied, None

    def _stop(self, measurement: Measurement, error: ReflexError) -> None:
        """Latch a reflex: fingers on the way stay where they are, and nobody drives."""
        self.reflex = error
        self.openings = self.grippers.stop(measurement.fingers_m, measurement.grip_n)
        try:
            self._tell_payload()
            self.on_reflex()
        except Exception as failure:
            self.fail(failure)

    def _reference(self) -> Reference:
        """Return where the active controllers, or the stop after a reflex, lead the arms."""
        if self.reflex is not None:
            return Reference(self.supervisor.stop_reference, ("reflex",))
        return Reference(np.array(self.manager.reference), self.manager.active)

    def _tell_payload(self) -> None:
        """Let the next controller bear the weight that the object impedance has borne."""
        if self.manager.active == OBJECT_CONTROLLERS:
            for arm in _ARMS:
                self.payload.bear(arm, self.impedance.mass_kg, at_once=True)

    def _expected(self) -> Expected:
        """Return what the observer is to expect of this tick."""
        manager = self.manager
        grip_fault = self.grippers.fault
        if manager.active == OBJECT_CONTROLLERS:
            load = self.impedance.load
            return Expected("held object", load, manager.reference, grip_fault)
        springs = any(
            hand.name in manager.active for hand in self.hands
        )  # dry joints hold them off
        if self.grippers.wide and not springs:
            return Expected("free motion", None, manager.reference, "")
        # fingers that open still touch what they held
        return Expected("closed hands", None, manager.reference, grip_fault)


def _reason(error: Exception) -> str:
    return error.message if isinstance(error, MinidualError) else f"{type(error).__name__}: {error}"
