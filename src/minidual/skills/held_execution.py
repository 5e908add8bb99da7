"""Drive a held-object plan in the simulated world and measure how far the rod strays from it.

The rod lies on the table and the open hands are round it; they close, the rod is lifted and moved along the plan by
joint trajectory control (`JointLoop`), which sees joint positions and nothing else. The rod's true pose is read for
scoring only, at every step from the moment the hands have closed until the arms have come to rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from minidual.config.scene import SceneConfig
from minidual.control.loop import JointLoop
from minidual.motion.held_path import CarriedTrajectory
from minidual.plant.world import World
from minidual.robot.constants import DOF, Array
from minidual.robot.kinematics import Kinematics
from minidual.robot.poses import inverse, rotation_log

CLOSE_S = 0.95
SETTLE_S = 0.5
_CLOSED = np.zeros(2)
_FLAT = 1e-6


@dataclass(frozen=True)
class Execution:
    """How far the rod was from where the plan had it.

    Attributes:
        error_max_m, error_max_rad: Largest deviation of position and of orientation.
        at_m_s, at_rad_s: When each happened, in seconds after the start of the plan.
        grasp_error_m, grasp_error_rad: Deviation when the plan began: what closing the hands did.
        end_error_m, end_error_rad: Deviation after the arms came to rest.
        pinch_min_n: Smallest pinch of either hand along the way [N].
    """

    error_max_m: float
    error_max_rad: float
    at_m_s: float
    at_rad_s: float
    grasp_error_m: float
    grasp_error_rad: float
    end_error_m: float
    end_error_rad: float
    pinch_min_n: float


def deviation(T_world_rod: Array, T_world_planned: Array) -> tuple[float, float]:
    """Return distance [m] and angle [rad] between the rod's pose and the planned one."""
    E = inverse(T_world_planned) @ T_world_rod
    return float(np.linalg.norm(E[:3, 3])), float(np.linalg.norm(rotation_log(E[:3, :3])))


def execute(
    plan: CarriedTrajectory, scene: SceneConfig, *, world: World | None = None, close_s: float = CLOSE_S
) -> Execution:
    """Return how the rod followed a plan that starts with the rod level on the table.

    Args:
        plan: Starts at rest with both open hands round the rod.
        scene: Physics and rod.
        world: A world to use again, of the same scene.
        close_s: Time for the hands to close.

    Raises:
        ValueError: The plan starts with a tilted rod, which cannot lie on the table.
    """
    T_start = plan.Ts_world_object[0]
    if abs(T_start[2, 1]) > _FLAT or abs(T_start[2, 0]) > _FLAT:
        raise ValueError(f"the plan starts with the rod tilted: {T_start[2, :3]}; it must lie level on the table")
    world = world or World(scene)
    yaw = float(np.arctan2(T_start[1, 0], T_start[0, 0]))
    world.reset(plan.q[0], poses={world.objects[0]: (float(T_start[0, 3]), float(T_start[1, 3]), yaw)})
    loop = JointLoop(world, Kinematics())
    still = np.zeros(DOF)
    for _ in range(round(close_s / world.dt)):
        loop.follow(plan.q[0], still, still, _CLOSED)
    errors = [deviation(world.object_pose(), T_start)]
    pinch = [float(world.pinch().min())]
    duration = plan.duration_s
    steps = round((duration + SETTLE_S) / world.dt)
    times = np.minimum(np.arange(1, steps + 1) * world.dt, duration)
    q, v, a = plan.sample_many(times)
    a[times >= duration] = 0.0
    rows = np.minimum(np.round(times / plan.dt_s).astype(int), len(plan.times) - 1)
    for k in range(steps):
        loop.follow(q[k], v[k], a[k], _CLOSED)
        errors.append(deviation(world.object_pose(), plan.Ts_world_object[rows[k]]))
        pinch.append(float(world.pinch().min()))
    deviations = np.array(errors)
    worst = np.argmax(deviations, axis=0)
    return Execution(
        *np.max(deviations, axis=0).tolist(),
        *(worst * world.dt).tolist(),
        *deviations[0].tolist(),
        *deviations[-1].tolist(),
        float(np.min(pinch)),
    )
