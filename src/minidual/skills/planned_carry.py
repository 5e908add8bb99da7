"""Plan the whole task, then execute it by position: the internal force results from stiff joints."""

from minidual.control.stack import ControlStack
from minidual.motion.api import Planner
from minidual.plant.world import World
from minidual.robot.pair import Array
from minidual.skills.cycle import around, pipeline_of, thing_of
from minidual.skills.pipeline.drive import Drive
from minidual.skills.pipeline.search import Solution, TaskFailedError
from minidual.skills.pipeline.stage import Gap, Tools
from minidual.skills.pipeline.state import State
from minidual.skills.supervised import arm_distance
from minidual.tasks.rod_carry import level_part
from minidual.tasks.task import Task, Trial

_GAP_MARGIN_M = 0.005


class PlannedCarry(Drive):
    """One planned trial; call `step` until `done`.

    `T_world_object` is the object's sensed pose, by default the true one. The plan keeps the supervisor's minimum arm
    distance plus a margin.
    """

    def __init__(
        self,
        stack: ControlStack[World],
        planner: Planner,
        task: Task,
        trial: Trial,
        seed: int,
        *,
        T_world_object: Array | None = None,
    ) -> None:
        world = self.world = stack.plant
        body, supervisor = task.objects[task.carried].body, stack.supervisor
        self.T_world_object = world.object_pose(body.name) if T_world_object is None else T_world_object
        start = level_part(self.T_world_object)
        gap = None
        if supervisor is not None:
            gap = Gap(arm_distance(world.robot), supervisor.config.self_collision_min_m + _GAP_MARGIN_M)
        tools = Tools(around(task.scene, world.robot), thing_of(body), planner, seed, gap)
        self.solution: Solution | None = None
        why: str | None = None
        try:
            self.solution = pipeline_of(task, trial).solve(State(world.q, start), tools)
            self.record = self.solution.record
        except TaskFailedError as error:
            why, self.record = error.summary, error.record
        super().__init__(stack, () if self.solution is None else self.solution.segments)
        self.aborted = why
