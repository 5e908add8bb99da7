"""Carry an object under object impedance.

Proposes joint motions for free hands and object motions for holding hands, as source `moveit`. Controllers A and C are
switched after closing and after the internal force is gone. See docs/carry.md.
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
    """One trial; call `step` until `done`.

    Object and start are sensed. The default supervisor has standard bounds and ignores the arm distance.
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
            # Check the grasp before anything moves.
            grasp_posture(world.scene, world.robot, level, self._q_over)
        except GraspUnreachableError as error:
            self._stop_by.heed(("unreachable", error.message))
        else:
            self.stack.request(SOURCE)

    @property
    def phase(self) -> str:
        """Present phase."""
        return self._phase

    @property
    def fault(self) -> CarryFault | None:
        """Fault that stopped it, or None."""
        return self._stop_by.fault

    @property
    def done(self) -> bool:
        """Whether the trial is over, aborted or not."""
        return self._phase == "done"

    @property
    def aborted(self) -> str | None:
        """Text of the fault, or None."""
        return None if self.fault is None else self.fault.text

    @property
    def estimate(self) -> ObjectState:
        """Estimated object state."""
        return self._watch.estimate

    @property
    def squeeze_n(self) -> float:
        """Requested internal force [N]; reduced on slip."""
        return self._watch.squeeze_n

    @property
    def desired(self) -> ObjectState | None:
        """Desired object state; None unless controller C is active."""
        return self.stack.impedance.desired if self._law_drives else None

    def step(self) -> None:
        """Run one control step."""
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

    # Common to all phases -------------------------------------------------------------------------------

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
        """Propose a command; an immediate refusal ends the carry."""
        refusal = self.stack.propose(SOURCE, command)
        if refusal is not None:
            self._stop_by.heed_refusal(refusal)

    def _number(self) -> int:
        self._sequence += 1
        return self._sequence

    def _move(self, phase: str, q_goal: Array, *, duration_s: float | None = None) -> None:
        """Enter a phase that moves the open hands from the last target."""
        if duration_s is None:
            duration_s = joint_duration_s(self._q_last, q_goal, self._config.pace, self.world.robot)
        motion = JointMove(self._q_last, q_goal, duration_s, self.world.dt)
        self._q_last = q_goal
        self._propose(TrajectoryCommand(motion, _OPEN, self.world.time, self._number()))
        self._enter(phase)

    def _hold(self, phase: str, what: tuple[HeldMotion, Squeeze]) -> None:
        self._propose(ObjectCommand(*what, _CLOSED, self.world.time, self._number()))
        self._enter(phase)

    def _grasp(self, q_near: Array, *, above_m: float = 0.0) -> Array | None:
        """Return the posture (n,) at or over the grasps, or halt and return None."""
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
            # The grasp uses the mean of all poses so far, about a hundred.
            q_grasp = self._grasp(self._q_over)
            if q_grasp is not None:
                self._move("descend", q_grasp)

    def _descend(self, t: float) -> None:
        if not self.stack.executing:
            self._enter("close")
            self._close(0.0)

    def _close(self, t: float) -> None:
        # Closing ends on felt pinch, not on time, so the posture is streamed.
        if t == 0.0 or self.stack.tick_next:
            self._propose(JointCommand(self._q_last, _CLOSED, self.world.time, self._number()))
        if self.fault is not None:
            return
        if self._watch.gripped:
            self._engage()
        else:
            self._stop_by.heed(self._watch.closing(t))

    def _engage(self) -> None:
        """Plan the path, switch to controller C and begin to squeeze."""
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
        """Hold, under controller C if interrupted with the object."""
        self._mind_the_object()

    def _mind_the_object(self) -> None:
        """Halt if the object gets lost: the arbiter's stop leaves it squeezed."""
        if self._law_drives and not self._stop_by.halted:
            self._stop_by.heed(self._watch.holding(steady=False))
