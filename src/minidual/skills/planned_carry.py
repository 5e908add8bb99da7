"""Plan the whole task, then execute it by position: the internal force results from stiff joints."""

from collections.abc import Mapping

from minidual.control.stack import ControlStack
from minidual.motion.api import Planner
from minidual.plant.world import World
from minidual.robot.pair import Array
from minidual.skills.cycle import pose_of, solve
from minidual.skills.pipeline.drive import Drive
from minidual.skills.pipeline.search import Solution, TaskFailedError
from minidual.skills.pipeline.stage import Gap
from minidual.skills.pipeline.state import State
from minidual.skills.supervised import arm_distance
from minidual.tasks.rod_carry import level_part, placement
from minidual.tasks.task import Task, Trial

GAP_MARGIN_M = 0.005


class PlannedCarry(Drive):
    """One planned trial; call `step` until `done`.

    `poses` are the objects' sensed poses, by default the true ones. The plan keeps the supervisor's minimum arm
    distance plus a margin.
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
            name: pose_of(task.objects[name].body, placement(T)) if task.stands else level_part(T)
            for name, T in self.poses.items()
        }
        start = State(world.q, dict(known))
        gap = None
        if supervisor is not None:
            gap = Gap(arm_distance(world.robot), supervisor.config.self_collision_min_m + GAP_MARGIN_M)
        self.solution: Solution | None = None
        why: str | None = None
        try:
            self.solution = solve(task, trial, start, planner, seed, gap, self.by_force)
            self.record = self.solution.record
        except TaskFailedError as error:
            why, self.record = error.summary, error.record
        super().__init__(stack, () if self.solution is None else self.solution.segments)
        self.aborted = why
