"""Bring the arms of any plant home, by planned motions."""

from contextlib import suppress

import numpy as np

from minidual.config.root import Config
from minidual.control.reflexes import ReflexError
from minidual.motion.api import Planner
from minidual.plant.lifecycle import Connection
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array
from minidual.robot.trajectory import Trajectory
from minidual.skills.plant_drive import DriveError, PlantDrive, come_to_rest

_AT_HOME_RAD = 0.005
_TRIES = 3
_OPENING_S = 1.0
_LOW_M = 0.18
"""Hands that are lower go up first: fingers at the table are in collision with it."""
_LIFT_STEP_M = 0.005
_DAMPING = 1e-4
_TURN_MAX_RAD = 1.0
_REST_S = 0.4
"""After an arm's motion, before the other one moves."""
_GROUPS = ("left_arm", "right_arm")


def bring_home(link: Connection, config: Config, planner: Planner, seed: int) -> None:
    """Clear errors, open the hands, and move one arm after the other home; a stop is tried again.

    Raises:
        PlanningError: There is no way.
        ReflexError, DriveError: The plant did not get there.
        UsageError: The plant reports a fault that it cannot clear.
    """
    for tries_left in reversed(range(_TRIES)):
        if link.plant.health:
            link.recover()
        come_to_rest(link.plant)
        drive = PlantDrive(link, config, config.arbiter.speed_override, source="moveit")
        try:
            _drive_home(drive, planner, seed)
        except (ReflexError, DriveError):
            if not tries_left:
                raise
            while drive.stack.stopping:
                with suppress(ReflexError):
                    drive.stack.step()
        else:
            return


def _drive_home(drive: PlantDrive, planner: Planner, seed: int) -> None:
    robot = drive.robot
    drive.begin()
    drive.openings[:] = 1.0
    drive.hold(_OPENING_S)
    drive.move(lifted(drive.stack.kinematics, drive.q))
    drive.hold(_REST_S)
    q = drive.q.copy()
    motions: list[tuple[Array, Trajectory]] = []
    if float(np.abs(q - robot.home).max()) > _AT_HOME_RAD:
        for group in _GROUPS:
            joints = robot.groups[group]
            result = planner.plan_to_joints(group, q, robot.home[joints], seed=seed)
            motions.append((q.copy(), result.trajectory))
            q[joints] = robot.home[joints]
    drive.stack.reset()  # the plans took time, which may go on meanwhile
    drive.begin()
    step_s = drive.plant.dt * drive.speed
    for (start, motion), group in zip(motions, _GROUPS, strict=False):
        drive.follow(_postures(motion, start, robot.groups[group], step_s))
        drive.hold(_REST_S)
    drive.move(robot.home)
    drive.settle()


def lifted(kinematics: Kinematics, q: Array) -> Array:
    """Return the posture (n,) whose hands are straight above low ones, from where a plan may begin."""
    robot = kinematics.robot
    goal = np.array(q)
    up = np.array([0.0, 0.0, _LIFT_STEP_M, 0.0, 0.0, 0.0])
    for arm in range(len(SIDES)):
        own = robot.joints_of(arm)
        while kinematics.tcp_poses(goal)[arm][2, 3] < _LOW_M:
            J = kinematics.tcp_jacobians(goal)[arm][:, own]
            square = J @ J.T + _DAMPING * np.eye(len(up))
            goal[own] += J.T @ np.linalg.solve(square, up)
            goal = np.clip(goal, robot.q_lower, robot.q_upper)
            if _is_stuck(kinematics, q, goal, arm):
                break
    return goal


def _is_stuck(kinematics: Kinematics, q: Array, goal: Array, arm: int) -> bool:
    """Return whether an arm turns far without its hand coming up."""
    return float(np.abs(goal - q)[kinematics.robot.joints_of(arm)].max()) > _TURN_MAX_RAD


def _postures(motion: Trajectory, start: Array, joints: slice, step_s: float) -> Array:
    """Return postures (T, n) of both arms, one for each step of the motion; the other arm stays."""
    steps = range(1, round(motion.duration_s / step_s) + 2)
    times = np.array([step * step_s for step in steps])
    samples = motion.sample_many(times).q
    postures = np.tile(start, (len(times), 1))
    own = samples if samples.shape[1] < postures.shape[1] else samples[:, joints]
    postures[:, joints] = own
    return postures
