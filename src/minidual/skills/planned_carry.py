"""Plan the whole task, then execute it: by position, or by impedance where what a hand holds may touch something."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin

from minidual.control.hand_impedance import InHand
from minidual.control.reflexes import ReflexError
from minidual.control.stack import DEFAULT_CONTROLLERS, ControlStack
from minidual.errors import MinidualError
from minidual.motion.api import Planner
from minidual.plant.world import World
from minidual.robot.pair import SIDES, Array, inverse, pose
from minidual.skills.cycle import solve
from minidual.skills.phases import OPEN, Segment, State, moved
from minidual.skills.pipeline.drive import Drive
from minidual.skills.pipeline.hands import retreat
from minidual.skills.pipeline.search import Pipeline, Solution, TaskFailedError
from minidual.skills.pipeline.stage import Stage
from minidual.tasks.task import Task, Trial, level_part, placement, pose_of

_TRIES = 3  # of a trial; open fingers leave 15 mm on either side of a bottle
_ASIDE_M = 0.020
_PRESSED_N = (
    10.0  # least force that a touch explains, and its least distance from the hand's middle
)
_BESIDE_M = 0.010


class PlannedCarry(Drive):
    """One planned trial by position: stiff joints give the internal force. Call `step` until `done`.

    `poses` are the objects' sensed poses, by default the true ones; what starts on the table has a known height. The
    plan keeps the supervisor's minimum arm distance plus a margin.
    """

    by_force = False

    def __init__(
        self,
        stack: ControlStack[World],
        planner: Planner,
        task: Task,
        trial: Trial,
        seed: int,
        *,
        poses: Mapping[str, Array] | None = None,
    ) -> None:
        self.task = task
        self.world = (world := stack.plant)
        self.poses = (
            {name: world.object_pose(name) for name in task.objects} if poses is None else poses
        )
        lying = {name for name, where in trial.start.items() if isinstance(where, tuple)}
        level = {
            name: placement(T) if name in lying else level_part(T) for name, T in self.poses.items()
        }
        known = self._poses = {
            name: pose_of(task.objects[name].body, where) for name, where in level.items()
        }
        start = State(world.q, dict(known))
        self._tries_left = _TRIES
        self._touch: tuple[Solution, Segment, Array] | None = None
        apart_m = stack.supervisor.config.self_collision_min_m
        self.solution: Solution | None = None
        try:
            self.solution = solve(task, trial, start, planner, seed, apart_m, self.by_force)
            self.record = self.solution.record
            super().__init__(stack, self.solution.segments)
        except TaskFailedError as error:
            super().__init__(stack, ())
            self.aborted = error.summary
            self.record = error.record

    def step(self) -> None:
        """Run one control step; simulated time stands still while it plans anew."""
        super().step()
        if self.stack.output.halted:  # by somebody: the arms stay
            self._touch = None
        if self._touch is not None and not self.stack.stopping:
            touch = self._touch
            self._touch = None
            with suppress(
                MinidualError,
                np.linalg.LinAlgError,
            ):  # moving, unmeasured or unplanned: it stays aborted
                self._grasp_again(*touch)

    def _tell_held(self, segment: Segment) -> None:
        super()._tell_held(segment)
        if segment.scene is not None and not self.task.together:
            held = {
                held.link: self.task.objects[held.name].body.mass_kg
                for held in segment.scene.attached
            }
            for arm, link in enumerate(self.world.robot.tcp_names):
                self.stack.payload.bear(arm, held.get(link, 0.0))

    def _stopped(self, error: ReflexError) -> None:
        solution = self.solution
        supervisor = self.stack.supervisor
        touched = error.reflex.label in ("contact.joint", "contact.hand")
        if solution and touched and self.phase == "descend" and self._tries_left:
            self._touch = solution, self._left[0], supervisor.touch
        super()._stopped(error)

    def _grasp_again(self, solution: Solution, segment: Segment, torque: Array) -> None:
        """Back off from what a finger came down on, and grasp it further towards that finger."""
        stack = self.stack
        q = self.world.q
        arm = int(np.argmax(np.abs(torque))) // (len(torque) // 2)
        k, state = next(
            (k, solution.states[k]) for k, part in enumerate(solution.parts) if segment in part
        )
        name = state.object_of(SIDES[arm])
        own = self.world.robot.joints_of(arm)
        wrench = np.linalg.lstsq(stack.kinematics.tcp_jacobians(q)[arm][:, own].T, torque[own])[0]
        x, y, z = stack.kinematics.tcp_poses(q)[arm][:3, :3].T
        pressed_n = -z @ wrench[:3]
        aside_nm = -x @ wrench[3:]
        on_a_finger = pressed_n > _PRESSED_N and abs(aside_nm) > _BESIDE_M * pressed_n
        if not on_a_finger or name in map(state.object_of, state.held_by):
            return
        self._tries_left -= 1
        self._poses[name] = moved(state.objects[name], np.sign(aside_nm) * _ASIDE_M * y)
        start = replace(state, q=q, objects={**state.objects, name: self._poses[name]})
        was = solution.pipeline
        back = Stage("back off", partial(retreat, tuple(state.reached)))
        self.solution = Pipeline(was.name, (back, *was.stages[k - 1 :]), was.keenness).solve(
            start,
            solution.tools,
        )
        stack.recover()  # not before: without a plan the reflex stays latched
        super().__init__(stack, self.solution.segments)


class CompliantCarry(PlannedCarry):
    """One planned trial; the `soft` hands of a segment run under impedance."""

    by_force = True

    def _take_control(self, segment: Segment) -> None:
        stack = self.stack
        laws = [hand.law for hand in self.stack.hands]
        self._note_grasps(segment)
        names = tuple(f"{side}_{'hand' if side in segment.soft else 'arm'}" for side in SIDES)
        names = names if segment.soft else DEFAULT_CONTROLLERS
        if names != stack.manager.active:
            for law, other in zip(laws, reversed(laws), strict=True):
                law.other = other.held if segment.phase == "insert" else None
            stack.switch_controllers(names)

    def _note_grasps(self, segment: Segment) -> None:
        """Note where in closed hands objects are, from where they lay."""
        tips = self.stack.kinematics.tcp_poses(self.world.q)
        laws = [hand.law for hand in self.stack.hands]
        poses = self._poses
        for T_tcp, law, opening in zip(tips, laws, segment.openings, strict=True):
            if law.held.name:
                poses[law.held.name] = T_tcp @ law.held.T_tcp_object
            if opening == OPEN:
                law.held = InHand()
        for held in () if segment.scene is None else segment.scene.attached:
            arm = self.world.robot.tcp_names.index(held.link)
            item = self.task.objects[held.name]
            if laws[arm].held.name != held.name:
                planned = held.shape.T_parent_shape
                T = _centred(inverse(tips[arm]) @ poses[held.name], planned)
                laws[arm].held = InHand(held.name, T, planned, item.touches_m)


def _centred(T_tcp_object: Array, planned: Array) -> Array:
    """Return the pose after fingers, closing along y, have centred the object and turned it along them."""
    turned = pin.log3(T_tcp_object[:3, :3] @ planned[:3, :3].T) * [0.0, 1.0, 0.0]
    x, _, z = T_tcp_object[:3, 3]
    return pose(pin.exp3(turned) @ planned[:3, :3], (x, planned[1, 3], z))
