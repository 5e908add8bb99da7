"""Carry an object under object impedance. See docs/carry.md."""

from collections.abc import Iterator

import numpy as np

from minidual.config.control import ArbiterConfig
from minidual.config.root import Config
from minidual.control.impedance import SingularPostureError
from minidual.control.reflexes import ReflexError
from minidual.control.soft_stop import halt_duration_s
from minidual.control.stack import OBJECT_CONTROLLERS, ControlStack
from minidual.control.supervisor import Supervisor
from minidual.errors import MinidualError
from minidual.motion.ik import PoseUnreachableError
from minidual.plant.protocol import ObjectSensors, Plant
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.skills.carry_phases import CarryPhases, RefusedError
from minidual.skills.carry_watch import CarryWatch
from minidual.skills.faults import OPENING, Fault, Order
from minidual.skills.interruptions import Interruptions
from minidual.skills.phases import PHASES
from minidual.skills.pipeline.drive import SOURCE
from minidual.tasks.task import Trial, placement

_OPEN = np.ones(2)
_BRAKED_S = 0.6
"""Longest braking along the path."""
_STOPPED_S = 0.5
"""Rest after a stop, before the trial ends."""


class ImpedanceCarry:
    """One trial; call `step` until `done`.

    A sensed fault halts the arms. After a reflex the supervisor stops them. Another mode, a halt by
    another source, a refusal or silence is the fault `interrupted`: the arbiter stops them.

    Args:
        plant: What is driven.
        kinematics: Of the arms.
        config: Scene, carry and arbiter.
        trial: Goal of the object.
        sensors: Of the object.
        supervisor: Guards the arms; by default one without distances.

    Attributes:
        plant: What is driven.
        watch: Senses the object and detects faults.
        stack: Drives the arms.
        fault: First fault, or None.
    """

    def __init__(
        self,
        plant: Plant,
        kinematics: Kinematics,
        config: Config,
        trial: Trial,
        *,
        sensors: ObjectSensors,
        supervisor: Supervisor | None = None,
    ) -> None:
        self.plant = plant
        scene = config.scene
        if supervisor is None:
            supervisor = Supervisor(dt_s=plant.dt, kinematics=Kinematics(plant.robot))
        self.watch = CarryWatch(plant, kinematics, scene, config.carry, sensors)
        self.stack = ControlStack(
            plant,
            kinematics,
            config.arbiter,
            pinch_force_n=config.carry.impedance.pinch_n,
            sensor=self.watch,
            supervisor=supervisor,
        )
        self._interruptions = Interruptions(self.stack)
        self._phases = CarryPhases(
            kinematics,
            scene,
            config.carry,
            placement(trial.goal[scene.object.name]),
            stack=self.stack,
            watch=self.watch,
            supervisor=supervisor,
            open_s=_open_s(config.arbiter),
        )
        self.fault: Fault | None = None
        self._halted = False
        self._stop_s = 0.0
        self._commanded: Array | None = None
        self._defect: BaseException | None = None
        """Failure of a controller, raised once the arms have stopped."""
        self._cycle = self._phases.run()
        self._advance()

    @property
    def phase(self) -> str:
        """Present phase; `stop` after a fault, then `done`."""
        return self._phases.phase

    @property
    def done(self) -> bool:
        """Whether the trial is over, aborted or not."""
        return self.phase == "done"

    @property
    def aborted(self) -> str | None:
        """Text of the fault, or None."""
        return None if self.fault is None else self.fault.text

    def step(self) -> None:
        """Run one control step.

        Raises:
            Exception: What failed in a sensor, a controller or here, once the arms have stopped.
        """
        for part in (self._look, self._advance):
            try:
                part()
            except Exception as error:  # this tick's torque must be applied all the same
                self.stack.fail(error)
        if self.fault is None:
            self.stack.affirm(SOURCE)
        try:
            self.stack.step()
        except ReflexError as error:
            self._take_reflex(error)
        else:
            self._heed_arbiter()
        self._commanded = self.stack.applied
        self._stop_if_due()
        if self._defect is not None and self.done:
            raise self._defect

    def _advance(self) -> None:
        """Go on in the present phase."""
        self._stop_if_due()
        if self.phase == "stop":
            stopped_s = self.plant.time - self._phases.began_s
            if stopped_s > self._stop_s + _STOPPED_S:
                self._phases.enter("done")
        elif self.phase != "done":
            try:
                next(self._cycle)
            except StopIteration:
                self._phases.enter("done")
            except PoseUnreachableError as error:
                self._halt(Fault("unreachable", error.message))
            except SingularPostureError as error:
                self._halt(Fault("singular", error.message))
            except RefusedError as error:
                self._note(Fault("interrupted", str(error)), _BRAKED_S)

    # Sensed faults -----------------------------------------------------------------------------

    def _look(self) -> None:
        """Sense, and halt the arms for a fault."""
        self.watch.sensing.sense()
        if self._commanded is not None:
            self._halt(self.watch.motors(self._commanded))
        self._halt(next((fault for fault in self._checks() if fault is not None), None))
        if self.watch.grip_limit_n < np.inf:
            self.stack.grippers.firmer()

    def _checks(self) -> Iterator[Fault | None]:
        """Make the checks of the present phase, until one finds a fault."""
        watch = self.watch
        match self.phase:
            case "approach" | "descend":
                follow = self.phase == "approach" and self._phases.follows
                yield watch.sensors(moving=False)
                yield watch.resting(follow=follow)
            case "close":
                yield watch.sensors(moving=False)
                yield watch.grippers(Order.CLOSE)
                if not watch.gripped:
                    yield watch.closing(self.plant.time - self._phases.began_s)
            case "squeeze" | "carry":
                yield watch.sensors(moving=True)
                yield watch.grippers(Order.NONE)
                yield watch.holding(steady=self.phase == "carry")
            case "unload":
                yield watch.sensors(moving=False)
                yield watch.grippers(Order.NONE)
            case "open":
                yield watch.grippers(Order.OPEN)
            case "retreat":
                yield watch.grippers(Order.OPEN)
                yield watch.resting(follow=False)
            case "stop" | "done":
                # The arbiter's stop leaves the object squeezed.
                if self.stack.manager.active == OBJECT_CONTROLLERS:
                    yield watch.holding(steady=False)

    def _halt(self, fault: Fault | None) -> None:
        """Stop the arms for a fault, unless there is none or something has stopped them already."""
        if fault is None or self._halted:
            return
        self._halted = True
        opens = fault.name in OPENING and self.stack.source == SOURCE
        self.stack.halt(SOURCE, _OPEN if opens else None)
        self._note(fault)

    # Reflexes and interruptions ----------------------------------------------------------------

    def _take_reflex(self, error: ReflexError) -> None:
        """Note a reflex as the fault; one sensed in the same tick is its consequence."""
        self._halted = True
        cause = error.__cause__
        reflex = error.reflex
        if self.fault is not None and self.fault.at_s == reflex.time_s:
            self.fault = None
        is_expected = isinstance(cause, MinidualError)
        if reflex.name == "controller_failed" and not is_expected:
            self._defect = cause
        if isinstance(cause, SingularPostureError):
            self._note(Fault("singular", cause.message, reflex.time_s))
        else:
            self._note(Fault("reflex", reflex.text, reflex.time_s))

    def _heed_arbiter(self) -> None:
        """Note the arbiter's interruptions of this step."""
        if self.done:
            return
        fault = self._interruptions.new_fault()
        if fault is None:
            return
        # After a halt the arms take the time of a soft stop.
        self._note(fault, None if self.stack.output.halted else _BRAKED_S)

    def _note(self, fault: Fault, stop_s: float | None = None) -> None:
        """Keep the first fault, and the time [s] to stop, by default that of a soft stop."""
        if self.fault is not None:
            return
        plant = self.plant
        if np.isnan(fault.at_s):
            fault = fault._replace(at_s=plant.time)
        self.fault = fault
        if stop_s is None:
            stop_s = halt_duration_s(plant.robot, plant.q, plant.v)
        self._stop_s = stop_s

    def _stop_if_due(self) -> None:
        if self.fault is not None and self.phase not in ("stop", "done"):
            self._phases.enter("stop")


def _open_s(arbiter: ArbiterConfig) -> float:
    """Return the duration of the phase `open`, longer for slower fingers."""
    usual = ArbiterConfig()
    return PHASES["open"].force_s * usual.finger_speed_m_per_s / arbiter.finger_speed_m_per_s
