"""Plan the whole task, then execute it: by position, or by impedance where what a hand holds may touch something."""

from collections.abc import Mapping

import pinocchio as pin

from minidual.control.impedance import InHand
from minidual.control.stack import DEFAULT_CONTROLLERS, ControlStack
from minidual.motion.api import Planner
from minidual.plant.world import World
from minidual.robot.pair import SIDES, Array, inverse, pose, rotation_log
from minidual.skills.cycle import solve
from minidual.skills.phases import OPEN, Segment, State
from minidual.skills.pipeline.drive import Drive
from minidual.skills.pipeline.search import Solution, TaskFailedError
from minidual.tasks.task import Task, Trial, level_part, placement, pose_of


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
        self.task, self.world = task, (world := stack.plant)
        supervisor = stack.supervisor
        self.poses = {name: world.object_pose(name) for name in task.objects} if poses is None else poses
        known = self._poses = {
            name: pose_of(task.objects[name].body, placement(T))
            if isinstance(trial.start[name], tuple)
            else level_part(T)
            for name, T in self.poses.items()
        }
        start = State(world.q, dict(known))
        apart_m = None if supervisor is None else supervisor.config.self_collision_min_m
        self.solution: Solution | None = None
        try:
            self.solution = solve(task, trial, start, planner, seed, apart_m, self.by_force)
            self.record = self.solution.record
            super().__init__(stack, self.solution.segments)
        except TaskFailedError as error:
            super().__init__(stack, ())
            self.aborted, self.record = error.summary, error.record


class CompliantCarry(PlannedCarry):
    """One planned trial; the `soft` hands of a segment run under impedance."""

    by_force = True

    def _take_control(self, segment: Segment) -> None:
        stack, laws = self.stack, [hand.law for hand in self.stack.hands]
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
        laws, poses = [hand.law for hand in self.stack.hands], self._poses
        for T_tcp, law, opening in zip(tips, laws, segment.openings, strict=True):
            if law.held.name:
                poses[law.held.name] = T_tcp @ law.held.T_tcp_object
            if opening == OPEN:
                law.held = InHand()
        for held in () if segment.scene is None else segment.scene.attached:
            arm, item = self.world.robot.tcp_names.index(held.link), self.task.objects[held.name]
            if laws[arm].held.name != held.name:
                planned = held.shape.T_parent_shape
                T = _centred(inverse(tips[arm]) @ poses[held.name], planned)
                laws[arm].held = InHand(held.name, T, planned, item.body.mass_kg, item.touches_m)


def _centred(T_tcp_object: Array, planned: Array) -> Array:
    """Return the pose after fingers, closing along y, have centred the object and turned it along them."""
    turned = rotation_log(T_tcp_object[:3, :3] @ planned[:3, :3].T) * [0.0, 1.0, 0.0]
    x, _, z = T_tcp_object[:3, 3]
    return pose(pin.exp3(turned) @ planned[:3, :3], (x, planned[1, 3], z))
