"""Carry an object under object impedance: approach, grasp, squeeze, lift, carry, lower, release, retreat.

Phases propose timed joint motions while the hands are free and object motions while they hold, as source `moveit`.
Controllers A and C change places between two control steps, when both hands have closed and when the squeeze is gone.
`carry_watch.py` senses, `carry_stop.py` stops, `carry_motions.py` makes what is proposed. See docs/carry.md.
"""

from __future__ import annotations

import numpy as np

from minidual.config.arbiter import ArbiterConfig
from minidual.config.control import CarryConfig
from minidual.config.seeds import stream
from minidual.control.commands import Command, JointCommand, ObjectCommand, TrajectoryCommand
from minidual.control.object_impedance import ObjectState, SingularPostureError
from minidual.control.object_path import ObjectPath
from minidual.control.stack import DEFAULT_CONTROLLERS, OBJECT_CONTROLLERS, ControlStack
from minidual.control.supervisor import Supervisor
from minidual.plant.protocol import ObjectSensors
from minidual.plant.sensing import Sensors
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.robot.poses import inverse
from minidual.skills.carry_motions import (
    HeldMotion,
    JointMove,
    Squeeze,
    carrying,
    gains,
    held_object,
    plan_path,
    releasing,
    squeezing,
)
from minidual.skills.carry_stop import CarryStop
from minidual.skills.carry_watch import CarryWatch
from minidual.skills.faults import CarryFault
from minidual.skills.pace import joint_duration_s
from minidual.skills.phases import PHASES
from minidual.skills.pipeline.drive import SOURCE
from minidual.skills.reach import GraspUnreachableError, grasp_posture
from minidual.tasks.rod_carry import level_part, placement
from minidual.tasks.task import Trial

_OPEN, _CLOSED = np.ones(2), np.zeros(2)
_STOPPED_S = 0.5


class ImpedanceCarry:
    """One trial under object impedance; call `step` until `done`.

    Args:
        world: The plant, already reset. Joints, fingers and motors are read from it, the object never.
        kinematics: Workspace.
        config: Speeds, gains, sensing, limits.
        trial: Start and goal. The start is not read: the object is found by its sensor.
        sensors: What senses the object; by default, the configured sensors on the trial's own stream of `seed`.
        seed: The run's seed.
        supervisor: Guards the motors; its reflex is a fault. By default one with the standard bounds, which does not
            watch the distance between the arms.
        arbiter: Bounds of the arbiter.

    Attributes:
        stack: The way to the motors, of this trial alone.
    """

    name = "impedance"

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
        self.world, self._config, self._trial = world, config, trial
        self._kinematics, self._scene = kinematics, world.scene
        if sensors is None:
            sensors = Sensors(world, config.sensing, stream(seed, f"sensing/{trial.purpose}", trial.index))
        self._watch = CarryWatch(world, kinematics, config, sensors)
        self.stack = ControlStack(
            world,
            kinematics,
            arbiter,
            pinch_force_n=config.impedance.pinch_n,
            sensor=self._watch,
            supervisor=Supervisor(dt_s=world.dt, kinematics=Kinematics(world.robot))
            if supervisor is None
            else supervisor,
            stop_share=config.faults.deceleration_share,
        )
        self._stop_by = CarryStop(self.stack, SOURCE, self._watch, deceleration_share=config.faults.deceleration_share)
        self._phase, self._began_s = "approach", world.time
        self._driving = False
        self._sequence = 0
        self._q_over = self._q_last = world.q
        self._path: ObjectPath | None = None
        self._T_level_object = np.eye(4)
        try:
            level = level_part(self._watch.T_world_object)
            over_m = PHASES["approach"].rise_m
            self._q_over = grasp_posture(world.scene, world.robot, level, world.robot.home, above_m=over_m)
            # A grasp out of reach is refused before anything moves.
            grasp_posture(world.scene, world.robot, level, self._q_over)
        except GraspUnreachableError as error:
            self._stop_by.heed(("unreachable", error.message))
        else:
            self.stack.request(SOURCE)

    @property
    def phase(self) -> str:
        """Name of the phase the trial is in."""
        return self._phase

    @property
    def fault(self) -> CarryFault | None:
        """What stopped the trial, or None."""
        return self._stop_by.fault

    @property
    def done(self) -> bool:
        """Return whether the cycle is over, aborted or not."""
        return self._phase == "done"

    @property
    def aborted(self) -> str | None:
        """Why the trial stopped itself, or None."""
        return None if self.fault is None else self.fault.text

    @property
    def estimate(self) -> ObjectState:
        """Where the controller believes the object to be."""
        return self._watch.estimate

    @property
    def squeeze_n(self) -> float:
        """Internal force that is wanted once the squeeze is complete [N]; it falls when the hands slip."""
        return self._watch.squeeze_n

    @property
    def desired(self) -> ObjectState | None:
        """Where the object should be in this step, or None while it is not carried under impedance."""
        return self.stack.impedance.desired if self._law_drives else None

    def step(self) -> None:
        """Run one control and physics step."""
        watch, stops = self._watch, self._stop_by
        watch.sense()
        if self._phase in ("approach", "descend"):
            stops.heed(watch.resting())
        stops.heed_motors()
        self._stop_if_due()
        getattr(self, f"_{self._phase}")(self.world.time - self._began_s)
        if stops.fault is None:
            self.stack.affirm(SOURCE)
        stops.step()
        self._stop_if_due()

    # What is common to all phases -----------------------------------------------------------------------

    @property
    def _law_drives(self) -> bool:
        return self.stack.manager.active == OBJECT_CONTROLLERS

    def _stop_if_due(self) -> None:
        if self._stop_by.fault is not None and self._phase not in ("stop", "done"):
            self._enter("stop")

    def _enter(self, phase: str) -> None:
        self._phase, self._began_s = phase, self.world.time
        self._stop_by.over = phase == "done"

    def _propose(self, command: Command) -> None:
        """Offer a command; one that is refused at once ends the carry, as after the step one refused when it is taken."""
        refusal = self.stack.propose(SOURCE, command)
        if refusal is not None:
            self._stop_by.heed_refusal(refusal)

    def _number(self) -> int:
        self._sequence += 1
        return self._sequence

    def _move(self, phase: str, q_goal: Array, *, duration_s: float | None = None) -> None:
        """Enter a phase in which the open hands go from where they were sent last to a posture (n,)."""
        if duration_s is None:
            duration_s = joint_duration_s(self._q_last, q_goal, self._config.pace, self.world.robot)
        motion = JointMove(self._q_last, q_goal, duration_s, self.world.dt)
        self._q_last = q_goal
        self._propose(TrajectoryCommand(motion, _OPEN, self.world.time, self._number()))
        self._enter(phase)

    def _hold(self, phase: str, what: tuple[HeldMotion, Squeeze]) -> None:
        """Enter a phase in which the object is held."""
        self._propose(ObjectCommand(*what, _CLOSED, self.world.time, self._number()))
        self._enter(phase)

    def _grasp(self, q_near: Array, *, above_m: float = 0.0) -> Array | None:
        """Return the posture (n,) with the hands at or over their grasps; None, and a soft stop, where there is none."""
        level = level_part(self._watch.T_world_object)
        try:
            return grasp_posture(self._scene, self.world.robot, level, q_near, above_m=above_m)
        except GraspUnreachableError as error:
            self._stop_by.heed(("unreachable", error.message))
            return None

    # Phases ---------------------------------------------------------------------------------------------

    def _approach(self, t: float) -> None:
        if not self._driving:
            if self.stack.source == SOURCE:
                self._driving = True
                self._move("approach", self._q_over)
        elif not self.stack.executing:
            # By now the object has been seen a hundred times: the grasp is placed by the mean.
            q_grasp = self._grasp(self._q_over)
            if q_grasp is not None:
                self._move("descend", q_grasp)

    def _descend(self, t: float) -> None:
        if not self.stack.executing:
            self._enter("close")
            self._close(0.0)

    def _close(self, t: float) -> None:
        # The lift is gated on what the fingers feel, not on a clock, so the posture is streamed.
        if t == 0.0 or self.stack.tick_next:
            self._propose(JointCommand(self._q_last, _CLOSED, self.world.time, self._number()))
        if self.fault is not None:
            return
        if self._watch.gripped:
            self._engage()
        else:
            self._stop_by.heed(self._watch.closing(t))

    def _engage(self) -> None:
        """Both hands have closed: plan the path, tell controller C what is held, let it take over, begin to squeeze."""
        world, watch = self.world, self._watch
        T_object = watch.T_world_object
        try:
            goal = placement(self._trial.goal[self._scene.object.name])
            self._path = plan_path(self._scene, world.robot, self._config, goal, T_object, world.q)
        except GraspUnreachableError as error:
            self._stop_by.heed(("unreachable", error.message))
            return
        self._T_level_object = inverse(level_part(T_object)) @ T_object
        held = held_object(self._scene, T_object, self._kinematics.tcp_poses(world.q))
        self.stack.impedance.configure(held, gains(self._config.impedance))
        watch.take_hold()
        try:
            self.stack.switch_controllers(OBJECT_CONTROLLERS)
        except SingularPostureError as error:
            self._stop_by.heed(("singular", error.message))
            return
        self._hold("squeeze", squeezing(self._path, self._T_level_object, self.squeeze_n))

    @property
    def _planned(self) -> ObjectPath:
        if self._path is None:
            raise RuntimeError(f"phase '{self.phase}' needs the object in both hands")
        return self._path

    def _squeeze(self, t: float) -> None:
        self._stop_by.heed(self._watch.holding(steady=False))
        if self.fault is None and not self.stack.executing:
            self._hold("carry", carrying(self._planned, self._T_level_object, self.squeeze_n))

    def _carry(self, t: float) -> None:
        self._stop_by.heed(self._watch.holding(steady=True))
        if self.fault is None and not self.stack.executing:
            self._hold("unload", releasing(self._planned, self._T_level_object, self.squeeze_n))

    def _unload(self, t: float) -> None:
        if not self.stack.executing:
            self._watch.let_go()
            self.stack.switch_controllers(DEFAULT_CONTROLLERS)
            self._q_last = self.world.q
            self._move("open", self._q_last, duration_s=PHASES["open"].force_s)

    def _open(self, t: float) -> None:
        if not self.stack.executing:
            q_above = self._grasp(self._q_last, above_m=PHASES["retreat"].rise_m)
            if q_above is not None:
                self._move("retreat", q_above)

    def _retreat(self, t: float) -> None:
        if not self.stack.executing:
            self._enter("done")

    def _stop(self, t: float) -> None:
        self._mind_the_object()
        if t > self._stop_by.duration_s + _STOPPED_S:
            self._enter("done")

    def _done(self, t: float) -> None:
        """Hold: the arms stay where they have come to rest, controller C too if it was interrupted with the object."""
        self._mind_the_object()

    def _mind_the_object(self) -> None:
        """Halt the arms when the object gets lost: stopped by the arbiter, it is still squeezed by both hands."""
        if self._law_drives and not self._stop_by.halted:
            self._stop_by.heed(self._watch.holding(steady=False))
