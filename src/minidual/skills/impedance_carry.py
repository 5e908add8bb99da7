"""Carry an object under object impedance.

Source `moveit` proposes joint motions for free hands (controller A) and object motions for holding hands (C). See
docs/carry.md.
"""

from collections.abc import Callable, Generator, Iterator

import numpy as np

from minidual.config.control import ArbiterConfig, CarryConfig
from minidual.config.seeds import stream
from minidual.control.commands import (
    ArbiterState,
    Command,
    JointCommand,
    ObjectCommand,
    TrajectoryCommand,
)
from minidual.control.impedance import SingularPostureError
from minidual.control.object_path import ObjectPath
from minidual.control.reflexes import ReflexError
from minidual.control.soft_stop import halt_duration_s
from minidual.control.stack import DEFAULT_CONTROLLERS, OBJECT_CONTROLLERS, ControlStack
from minidual.control.supervisor import Supervisor
from minidual.errors import MinidualError
from minidual.motion.ik import PoseUnreachableError
from minidual.plant.protocol import ObjectSensors
from minidual.plant.sensing import Sensors
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, inverse
from minidual.skills.carry_motions import (
    grasp_posture,
    held_motion,
    held_object,
    joint_move,
    plan_path,
    posture_over,
)
from minidual.skills.carry_watch import CarryWatch
from minidual.skills.cycle import thing_of
from minidual.skills.faults import CLOSED, OPENING, Fault
from minidual.skills.phases import PHASES
from minidual.skills.pipeline.drive import SOURCE
from minidual.tasks.task import Trial, level_part, placement, pose_of

_OPEN = np.ones(2)
_CLOSED = np.zeros(2)
# what the hands are told in a phase
_TOLD = {"close": "close", "open": "open", "retreat": "open"}
_BRAKED_S = 0.6  # longest braking along the path
_ARRIVALS = 4
_ONWARD_S = 0.8
_ARRIVED_M = 0.003
_STRETCH_M = 0.018
# most corrections of a path's end, their time, the distance that needs none, the longest stretch of the spring
_STOPPED_S = 0.5
_CALM_S = 2.0


class _RefusedError(Exception):
    """A proposed command was refused."""


class ImpedanceCarry:
    """One trial; call `step` until `done`.

    A sensed fault halts the arms; lost motors also lose their torque. After a reflex the supervisor stops them. Another
    mode, a halt by another source, a refusal or silence is the fault `interrupted`: the arbiter stops them.

    Attributes:
        phase: Present phase; `stop` after a fault, then `done`.
    """

    def __init__(
        self,
        world: World,
        kinematics: Kinematics,
        config: CarryConfig,
        trial: Trial,
        *,
        sensors: ObjectSensors | None = None,
        seed: int = 0,
        supervisor: Supervisor | None = None,
        arbiter: ArbiterConfig | None = None,
    ) -> None:
        self.world = world
        self._kinematics = kinematics
        self._config = config
        self._trial = trial
        if sensors is None:
            sensors = Sensors(
                world,
                config.sensing,
                stream(seed, f"sensing/{trial.purpose}", trial.index),
            )
        self.watch = CarryWatch(world, kinematics, config, sensors)
        supervisor = self._supervisor = supervisor or Supervisor(
            dt_s=world.dt,
            kinematics=Kinematics(world.robot),
        )
        self.stack = ControlStack(
            world,
            kinematics,
            arbiter,
            pinch_force_n=config.impedance.pinch_n,
            sensor=self.watch,
            supervisor=supervisor,
        )
        self.stack.on_flush(self._flushed)
        usual = ArbiterConfig()
        self._open_s = (
            PHASES["open"].force_s
            * usual.finger_speed_m_per_s
            / (arbiter or usual).finger_speed_m_per_s
        )
        self.phase = "approach"
        self._began_s = world.time
        self._sequence = 0
        self.fault: Fault | None = None
        self._halted = False
        self._follows = True
        self._stop_s = 0.0
        self._told: Array | None = None
        self._broken: BaseException | None = None
        self._asked_for: str | None = None
        self._refusals_seen = 0
        self._heeded = self.stack.output
        self._cycle = self._phases()
        self._advance()

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
            except Exception as error:  # must not take this tick's torque away
                self.stack.fail(error)
        if self.fault is None:
            self.stack.affirm(SOURCE)
        try:
            self.stack.step()
        except ReflexError as error:
            self._halted = True
            cause = error.__cause__
            if self.fault is not None and self.fault.at_s == error.reflex.time_s:
                self.fault = None  # a consequence, sensed in the same tick
            if error.reflex.name == "controller_failed" and not isinstance(cause, MinidualError):
                self._broken = cause
            singular = isinstance(cause, SingularPostureError)
            text = cause.message if singular else error.reflex.text
            self._note("singular" if singular else "reflex", text, at_s=error.reflex.time_s)
        else:
            self._heed_arbiter()
        self._told = self.stack.applied
        self._stop_if_due()
        if self._broken is not None and self.done:
            raise self._broken

    # Phases ---------------------------------------------------------------------------------------------

    def _advance(self) -> None:
        self._stop_if_due()
        if self.phase == "stop":
            if self.world.time - self._began_s > self._stop_s + _STOPPED_S:
                self._enter("done")
        elif self.phase != "done":
            try:
                next(self._cycle)
            except StopIteration:
                self._enter("done")
            except (PoseUnreachableError, SingularPostureError) as error:
                name = "singular" if isinstance(error, SingularPostureError) else "unreachable"
                self._halt(Fault(name, error.message))
            except _RefusedError as error:
                self._note("interrupted", str(error), _BRAKED_S)

    def _phases(self) -> Iterator[None]:
        world = self.world
        watch = self.watch
        stack = self.stack
        q_over = posture_over(world.scene, world.robot, self._lying(), PHASES["approach"].rise_m)
        self._grasp(q_over)  # before anything moves
        stack.request(SOURCE)
        q = world.q
        while stack.source != SOURCE:
            yield
        for self._follows in (True, True, False):  # shifted a third time, it is a fault
            yield from self._move("approach", q, q_over)
            if not watch.shifted:
                break
            q = q_over
            watch.shifted = False
            q_over = self._grasp(q, above_m=PHASES["approach"].rise_m)
        q = self._grasp(q_over)  # of the mean of all poses so far, about a hundred
        rest_m = float(watch.T_world_object[2, 3])
        yield from self._move("descend", q_over, q)

        # Closing ends on felt pinch, not on time, so the posture is streamed.
        self._propose("close", JointCommand, q, _CLOSED)
        while not watch.gripped:
            yield
            if stack.tick_next:
                self._propose("close", JointCommand, q, _CLOSED)

        T_object = watch.T_world_object
        scene = world.scene
        goal = placement(self._trial.goal[scene.object.name])
        path = plan_path(scene, world.robot, self._config.pace, goal, T_object, world.q, rest_m)
        T_level_object = inverse(level_part(T_object)) @ T_object
        tcps = self._kinematics.tcp_poses(world.q)
        stack.impedance.configure(held_object(scene, T_object, tcps), self._config.impedance)
        watch.take_hold()
        self._supervisor.hold(
            0,
            inverse(tcps[0]) @ self._lying() @ thing_of(scene.object).shape.T_parent_shape,
        )
        stack.switch_controllers(OBJECT_CONTROLLERS)
        for phase in ("squeeze", "carry", "unload"):
            if phase == "carry":
                watch.lift()
            if phase == "unload":
                path = yield from self._arrive(path, T_level_object)
            self._propose(
                phase,
                ObjectCommand,
                *held_motion(phase, path, T_level_object, watch.squeeze_n),
                _CLOSED,
            )
            yield from self._executing()
        while not stack.calm and world.time < self._began_s + _CALM_S:
            yield  # the object is down, an elbow may still swing
        watch.let_go()
        self._supervisor.hold(None)
        stack.switch_controllers(DEFAULT_CONTROLLERS)

        q = world.q
        yield from self._move("open", q, q, self._open_s)
        yield from self._move("retreat", q, self._grasp(q, above_m=PHASES["retreat"].rise_m))

    def _arrive(self, path: ObjectPath, T_level_object: Array) -> Generator[None, None, ObjectPath]:
        """Move a path's end on until the object is there."""  # friction in the joints holds a spring off
        goal_m = end_m = path.at(path.duration_s, T_level_object).T_world_object[:3, 3]
        for _ in range(_ARRIVALS):
            p_m = self.watch.T_world_object[:3, 3]
            short, stretched = (float(np.linalg.norm(to_m - p_m)) for to_m in (goal_m, end_m))
            if short < _ARRIVED_M or stretched >= _STRETCH_M:
                break
            onward_m = (goal_m - p_m) * min(1.0, (_STRETCH_M - stretched) / short)
            path = path.onward(onward_m, _ONWARD_S)
            end_m = end_m + onward_m
            motion = held_motion("carry", path, T_level_object, self.watch.squeeze_n)
            self._propose("carry", ObjectCommand, *motion, _CLOSED)
            yield from self._executing()
        return path

    def _grasp(self, q_near: Array, *, above_m: float = 0.0) -> Array:
        """Return the posture (n,) at or over the grasps."""
        return grasp_posture(
            self.world.scene,
            self.world.robot,
            self._lying(),
            q_near,
            above_m=above_m,
        )

    def _lying(self) -> Array:
        """Return the object's pose (4, 4) at its known height on the table."""
        return pose_of(self.world.scene.object, placement(self.watch.T_world_object))

    def _move(
        self,
        phase: str,
        q: Array,
        q_goal: Array,
        duration_s: float | None = None,
    ) -> Iterator[None]:
        world = self.world
        motion = joint_move(q, q_goal, world.robot, self._config.pace, world.dt, duration_s)
        self._propose(phase, TrajectoryCommand, motion, _OPEN)
        yield from self._executing()

    def _executing(self) -> Iterator[None]:
        yield
        while self.stack.executing:
            desired = self.stack.impedance.desired
            if self.phase == "carry" and desired is not None and desired.twist[2] < 0.0:
                self._supervisor.lower()  # the object may land early
            yield

    def _propose(self, phase: str, kind: Callable[..., Command], *what: object) -> None:
        self._sequence += 1
        if refusal := self.stack.propose(SOURCE, kind(*what, self.world.time, self._sequence)):
            raise _RefusedError(f"{refusal.name}: {refusal.detail}")
        if phase != self.phase:
            self._enter(phase)

    def _enter(self, phase: str) -> None:
        self.phase = phase
        self._began_s = self.world.time

    # Faults ---------------------------------------------------------------------------------------------

    def _look(self) -> None:
        self.watch.sense()
        if self._told is not None:
            self._halt(self.watch.motors(self._told))
        self._halt(self._sensed())
        if self.watch.grip_limit_n < np.inf:
            self.stack.grippers.firmer()

    def _sensed(self) -> Fault | None:
        watch = self.watch
        phase = self.phase
        if phase in ("squeeze", "carry"):
            return (
                watch.sensors(moving=True)
                or watch.grippers("")
                or watch.holding(steady=phase == "carry")
            )
        if phase not in ("open", "retreat", "stop", "done") and (
            lost := watch.sensors(moving=False)
        ):
            return lost
        untouched = phase in ("approach", "descend", "retreat")
        hands = (
            None
            if phase in ("approach", "descend", "stop", "done")
            else watch.grippers(_TOLD.get(phase, ""))
        )
        if hands is not None or untouched:
            return hands or watch.resting(follow=self._follows and phase == "approach")
        if phase == "close":
            return None if watch.gripped else watch.closing(self.world.time - self._began_s)
        # the arbiter's stop leaves the object squeezed
        pressed = phase in ("stop", "done") and self.stack.manager.active == OBJECT_CONTROLLERS
        return watch.holding(steady=False) if pressed else None

    def _halt(self, fault: Fault | None) -> None:
        if fault is None or self._halted:
            return
        self._halted = True
        self.stack.halt(
            SOURCE,
            _OPEN if fault.name in OPENING and self.stack.source == SOURCE else None,
        )
        self._note(fault.name, fault.detail)

    def _heed_arbiter(self) -> None:
        stack = self.stack
        if (stack.output is self._heeded and stack.refused_n == self._refusals_seen) or self.done:
            return
        self._heeded = stack.output
        news = stack.refused_since(self._refusals_seen)
        self._refusals_seen = stack.refused_n
        refused = next((r for r in news if r.source == SOURCE), None)
        if stack.output.halted:  # first: sources see a halt as a hold request
            self._note("interrupted", "the arms were halted")
        elif refused is not None and refused.name in CLOSED:
            self._note(refused.name, refused.detail, _BRAKED_S)
        elif refused is not None:
            self._note("interrupted", f"{refused.name}: {refused.detail}", _BRAKED_S)
        elif self._asked_for is not None:
            self._note("interrupted", f"'{self._asked_for}' was asked for", _BRAKED_S)
        elif stack.state in (ArbiterState.STALE, ArbiterState.STOPPED):
            self._note(
                "interrupted",
                f"the arbiter is {stack.state}: it has not heard of the carry",
                _BRAKED_S,
            )

    def _note(
        self,
        name: str,
        detail: str,
        stop_s: float | None = None,
        at_s: float | None = None,
    ) -> None:
        if self.fault is not None:
            return
        world = self.world
        self.fault = Fault(name, detail, world.time if at_s is None else at_s)
        if stop_s is None:
            stop_s = halt_duration_s(world.robot, world.q, world.v)
        self._stop_s = stop_s

    def _stop_if_due(self) -> None:
        if self.fault is not None and self.phase not in ("stop", "done"):
            self._enter("stop")

    def _flushed(self, mode: str) -> None:
        if mode != SOURCE:
            self._asked_for = mode
