"""The supervisor of a trial."""

from __future__ import annotations

from functools import cache

from minidual.collision.arm_distance import ArmDistance
from minidual.collision.scene import PlanningScene
from minidual.config.supervisor import SupervisorConfig
from minidual.control.supervisor import OnReflex, Supervisor
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Robot


@cache
def arm_distance(robot: Robot) -> ArmDistance:
    """Return the arm distance, cached: it compiles a model."""
    return ArmDistance(PlanningScene(robot=robot))


def trial_supervisor(
    config: SupervisorConfig, dt_s: float, robot: Robot, on_reflex: OnReflex | None = None
) -> Supervisor:
    """Return a supervisor that also watches the arm distance."""
    distance = arm_distance(robot)
    return Supervisor(config, dt_s=dt_s, kinematics=Kinematics(robot), self_distance=distance, on_reflex=on_reflex)
