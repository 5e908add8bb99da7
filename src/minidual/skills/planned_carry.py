"""Carry the object by planning alone: the whole cycle is searched before the arms move, then driven by position.

Free motion to over the object, straight down, the carry on which both hands keep their grasps, straight away. Nothing
is fed back but joint positions; the squeeze is whatever the stiff joints give.
"""

from __future__ import annotations

from minidual.config.arbiter import ArbiterConfig
from minidual.config.planning import PlannerConfig
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.motion.api import Planner
from minidual.motion.held.planner import HeldPlanner
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.skills.cycle import around, carry_pipeline, thing_of
from minidual.skills.pipeline.drive import SOURCE, Drive
from minidual.skills.pipeline.search import Solution, TaskFailedError
from minidual.skills.pipeline.stage import Gap, Tools
from minidual.skills.pipeline.state import State
from minidual.skills.supervised import arm_distance
from minidual.tasks.rod_carry import level_part, level_pose, placement
from minidual.tasks.task import Trial

__all__ = ["SOURCE", "PlannedCarry", "make_planners"]

_GAP_MARGIN_M = 0.005


class PlannedCarry(Drive):
    """One planned trial; call `step` until `done`.

    Args:
        world: The plant, already reset.
        kinematics: Dynamics for the joint controller.
        planner: Plans to the object; shared by trials.
        carrier: Plans with the object in both hands; shared by trials.
        trial: Goal.
        seed: Of the planner.
        arbiter: Bounds of the arbiter.
        T_world_object: Pose (4, 4) at which the object is believed to lie, as it was sensed before the motion; where it
            truly lies by default.
        supervisor: Guards the motors; its reflex ends the trial. The plan keeps the distance between the arms that it
            watches, with a margin.

    Attributes:
        solution: The plan, or None where there is none.
    """

    def __init__(
        self,
        world: World,
        kinematics: Kinematics,
        planner: Planner,
        carrier: HeldPlanner,
        trial: Trial,
        seed: int,
        arbiter: ArbiterConfig | None = None,
        *,
        T_world_object: Array | None = None,
        supervisor: Supervisor | None = None,
    ) -> None:
        self.world, scene = world, world.scene
        start = level_part(world.object_pose() if T_world_object is None else T_world_object)
        x, y, yaw = placement(trial.goal[scene.object.name])
        goal = level_pose(x, y, scene.object.rest_height_m, yaw)
        gap = None
        if supervisor is not None:
            gap = Gap(arm_distance(world.robot), supervisor.config.self_collision_min_m + _GAP_MARGIN_M)
        tools = Tools(
            around(scene, world.robot), thing_of(scene.object, scene.object.name), planner, seed, gap, holder=carrier
        )
        self.solution: Solution | None = None
        why: str | None = None
        try:
            self.solution = carry_pipeline(scene, goal).solve(State(world.q, start), tools)
        except TaskFailedError as error:
            why = error.summary
        stack = ControlStack(world, kinematics, arbiter, supervisor=supervisor)
        super().__init__(stack, () if self.solution is None else self.solution.segments)
        self.aborted = why


def make_planners(config: PlannerConfig) -> tuple[Planner, HeldPlanner]:
    """Return the planners that trials of one process share."""
    planner = Planner(config=config)
    return planner, HeldPlanner(planner)
