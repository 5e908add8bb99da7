"""Plan the whole task, then execute it by position, or by impedance where objects may touch."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.errors import MinidualError
from minidual.motion.api import Planner
from minidual.plant.lifecycle import runs_on
from minidual.plant.protocol import Plant
from minidual.robot.pair import SIDES, Array
from minidual.skills.cycle import solve
from minidual.skills.pipeline.drive import Drive
from minidual.skills.pipeline.hands import retreat
from minidual.skills.pipeline.search import Pipeline, Solution, TaskFailedError
from minidual.skills.pipeline.stage import Stage
from minidual.skills.states import Segment, State, moved
from minidual.tasks.task import Task, Trial, level_part, placement, pose_of

_TRIES = 3
"""New grasps of a trial; open fingers leave 15 mm on either side of a bottle."""
_ASIDE_M = 0.020
"""Distance to the side of a new grasp."""
_PRESSED_N = 10.0
"""Least force that a touch explains."""
_BESIDE_M = 0.010
"""Least distance of a touch from the hand's middle."""


class _Touch(NamedTuple):
    """A finger that came down on something: the plan, its segment, external torques (n,) [Nm]."""

    solution: Solution
    segment: Segment
    torque: Array


class PlannedCarry(Drive):
    """One planned trial by position: stiff joints give the internal force.

    Call `step` until `done`. What starts on the table has a known height. The plan keeps the
    supervisor's minimum arm distance plus a margin.

    Args:
        stack: Drives the arms.
        planner: Plans free motions.
        task: What is to be done.
        trial: Its goal.
        seed: Of the search.
        poses: The objects' sensed poses (4, 4).

    Attributes:
        task: What is done.
        plant: What is driven.
        poses: The objects' sensed poses (4, 4).
        solution: The plan; None if there is none.
        record: Of the search.
    """

    by_force = False

    def __init__(
        self,
        stack: ControlStack[Plant],
        planner: Planner,
        task: Task,
        trial: Trial,
        seed: int,
        poses: Mapping[str, Array],
    ) -> None:
        self.task = task
        self.plant = stack.plant
        self.poses = poses
        self._poses = _at_known_height(task, trial, poses)
        self._tries_left = _TRIES
        self._touch: _Touch | None = None
        self.solution: Solution | None = None
        start = State(self.plant.q, dict(self._poses))
        apart_m = stack.supervisor.config.self_collision_min_m
        try:
            self.solution = solve(task, trial, start, planner, seed, apart_m, self.by_force)
        except TaskFailedError as error:
            super().__init__(stack, ())
            self.aborted = error.summary
            self.record = error.record
        else:
            self.record = self.solution.record
            if runs_on(self.plant):
                stack.reset()  # its time went on during the search
            super().__init__(stack, self.solution.segments)

    def step(self) -> None:
        """Run one control step; simulated time stands still during a new plan."""
        super().step()
        if self.stack.output.halted:  # by somebody: the arms stay
            self._touch = None
        if self._touch is not None and not self.stack.stopping:
            touch = self._touch
            self._touch = None
            # Arms that move, are not measured or have no plan stay aborted.
            with suppress(MinidualError, np.linalg.LinAlgError):
                self._grasp_again(*touch)

    def _tell_held(self, segment: Segment) -> None:
        super()._tell_held(segment)
        if segment.scene is None or self.task.together:
            return
        payloads_kg: dict[str, float] = {}
        for attached in segment.scene.attached:
            payloads_kg[attached.link] = self.task.objects[attached.name].body.mass_kg
        for arm, link in enumerate(self.plant.robot.tcp_names):
            self.stack.payload.bear(arm, payloads_kg.get(link, 0.0))

    def _stopped(self, error: ReflexError) -> None:
        solution = self.solution
        is_touch = error.reflex.label in ("contact.joint", "contact.hand")
        may_grasp_again = is_touch and self.phase == "descend" and self._tries_left > 0
        if solution is not None and may_grasp_again:
            self._touch = _Touch(solution, self._left[0], self.stack.supervisor.touch)
        super()._stopped(error)

    def _grasp_again(self, solution: Solution, segment: Segment, torque: Array) -> None:
        """Back off from the object that a finger came down on, and grasp it further towards that finger.

        Args:
            solution: The plan that was driven.
            segment: The descent that was stopped.
            torque: (n,) [Nm], external torques of the touch.
        """
        stack = self.stack
        q = self.plant.q
        arm = int(self.plant.robot.arm_of_joint[np.argmax(np.abs(torque))])
        shift_m = self._shift_to_finger(q, arm, torque)
        stage = _stage_of(solution, segment)
        state = solution.states[stage]
        name = state.object_of(SIDES[arm])
        is_held = name in (state.object_of(holder) for holder in state.held_by)
        if shift_m is None or is_held:
            return
        self._tries_left -= 1
        self._poses[name] = moved(state.objects[name], shift_m)
        start = replace(state, q=q, objects={**state.objects, name: self._poses[name]})
        old = solution.pipeline
        back_off = Stage("back off", partial(retreat, tuple(state.reached)))
        pipeline = Pipeline(old.name, (back_off, *old.stages[stage - 1 :]), old.keenness)
        self.solution = pipeline.solve(start, solution.tools)
        stack.recover()  # after the plan: without one the reflex stays latched
        self._begin(self.solution.segments)

    def _shift_to_finger(self, q: Array, arm: int, torque: Array) -> Array | None:
        """Return the shift (3,) [m] of a grasp towards the finger that was touched.

        None if the torques (n,) [Nm] are not those of a force on a finger along the hand.
        """
        kinematics = self.stack.kinematics
        own = self.plant.robot.joints_of(arm)
        J = kinematics.tcp_jacobians(q)[arm][:, own]
        wrench = np.linalg.lstsq(J.T, torque[own])[0]
        x, y, z = kinematics.tcp_poses(q)[arm][:3, :3].T
        pressed_n = -z @ wrench[:3]
        aside_nm = -x @ wrench[3:]
        is_on_finger = pressed_n > _PRESSED_N and abs(aside_nm) > _BESIDE_M * pressed_n
        if not is_on_finger:
            return None
        return np.sign(aside_nm) * _ASIDE_M * y


def _at_known_height(
    task: Task,
    trial: Trial,
    poses: Mapping[str, Array],
) -> dict[str, Array]:
    """Return level poses (4, 4); objects that start on the table have their known height."""
    level_poses: dict[str, Array] = {}
    for name, T in poses.items():
        starts_on_table = isinstance(trial.start.get(name), tuple)
        where = placement(T) if starts_on_table else level_part(T)
        level_poses[name] = pose_of(task.objects[name].body, where)
    return level_poses


def _stage_of(solution: Solution, segment: Segment) -> int:
    """Return the index of the stage of a segment."""
    return next(k for k, part in enumerate(solution.parts) if segment in part)
