"""Execute a held-object plan in simulation and measure the object's deviation.

The hands close, then follow the plan by position. Only the score uses the true pose.
"""

from dataclasses import dataclass

import numpy as np

from minidual.control.kernels import apart
from minidual.control.stack import ControlStack
from minidual.errors import MinidualError
from minidual.motion.held.path import CarriedTrajectory
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.skills.phases import PHASES
from minidual.skills.pipeline.drive import Drive
from minidual.skills.states import CLOSED, Segment, still

_CLOSED = (CLOSED, CLOSED)
_FLAT = 1e-6


class NotDrivenError(MinidualError):
    """The control stack stopped the plan."""


@dataclass(frozen=True)
class DrivenMove:
    """Largest deviation of the object from the plan, and least pinch."""

    error_max_m: float
    error_max_rad: float
    pinch_min_n: float


def execute(plan: CarriedTrajectory, world: World, *, close_s: float = 0.7) -> DrivenMove:
    """Execute a plan that starts at rest, with the object level on the table and open hands at it.

    Raises:
        ValueError: The object is tilted at the start.
        NotDrivenError: The control stack refused or stopped it.
    """
    T_start = plan.Ts_world_object[0]
    _reset(world, plan)
    segments = [
        still("close", plan.q[0], close_s, _CLOSED),
        Segment("carry", plan, _CLOSED),
        still("settle", plan.q[-1], PHASES["settle"].hold_s, _CLOSED),
    ]
    drive = Drive(ControlStack(world, Kinematics(world.robot)), segments)
    errors: list[tuple[float, float]] = []
    pinches_n: list[float] = []
    while not drive.done:
        T_before = world.object_pose()
        pinch_before_n = float(world.truth().pinch().min())
        drive.step()
        if drive.phase not in ("carry", "settle") or drive.elapsed_s == 0.0:
            continue
        if not errors:
            errors = [_error(T_before, T_start)]
            pinches_n = [pinch_before_n]
        errors.append(_error(world.object_pose(), _planned(plan, drive)))
        pinches_n.append(float(world.truth().pinch().min()))
    if drive.aborted is not None:
        raise NotDrivenError(drive.aborted)
    error_max_m, error_max_rad = np.max(errors, axis=0).tolist()
    return DrivenMove(error_max_m, error_max_rad, min(pinches_n))


def _reset(world: World, plan: CarriedTrajectory) -> None:
    """Put the arms and the object to the start of the plan."""
    T_start = plan.Ts_world_object[0]
    if abs(T_start[2, 1]) > _FLAT or abs(T_start[2, 0]) > _FLAT:
        raise ValueError(
            f"the plan starts with the object tilted: {T_start[2, :3]}; "
            "it must lie level on the table",
        )
    yaw = float(np.arctan2(T_start[1, 0], T_start[0, 0]))
    start = (float(T_start[0, 3]), float(T_start[1, 3]), yaw)
    world.reset(plan.q[0], poses={world.objects[0]: start})


def _planned(plan: CarriedTrajectory, drive: Drive) -> Array:
    """Return the planned pose (4, 4) of the object at this moment."""
    elapsed_s = drive.elapsed_s if drive.phase == "carry" else plan.duration_s
    row = min(round(elapsed_s / plan.dt_s), len(plan.times) - 1)
    return plan.Ts_world_object[row]


def _error(T: Array, T_planned: Array) -> tuple[float, float]:
    """Return distance [m] and angle [rad] between poses (4, 4)."""
    return apart(T, T_planned, np.empty(6))
