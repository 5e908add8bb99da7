"""A task's plan as a demonstration."""

import numpy as np

from minidual.config.seeds import stream, subseed
from minidual.control.kernels import minimum_jerk
from minidual.motion.api import Planner
from minidual.motion.ik import ArmIK, solvers
from minidual.robot.pair import GROUP_ARMS, SIDES, Array, Robot, pose
from minidual.skills.cycle import solve
from minidual.skills.operator import REST_S, Demonstration
from minidual.skills.states import OPEN, Segment, State
from minidual.tasks.task import Task, Trial, pose_of

_SPEED_SHARE = 0.6
"""Of the joints' limits.

Faster, the arms would lag by up to 0.3 rad behind what is streamed and leave the proven path.
"""


def demonstrate_plan(
    task: Task,
    trial: Trial,
    planner: Planner,
    *,
    seed: int,
    rate_hz: float,
) -> Demonstration:
    """Return the task's plan as a demonstration.

    While both hands are open, they err along what they grasp until they are down.

    Raises:
        TaskFailedError: There is no plan.
    """
    robot = planner.robot
    purpose = f"operator/{trial.purpose}"
    objects = {name: pose_of(item.body, trial.start[name]) for name, item in task.objects.items()}
    solution = solve(
        task,
        trial,
        State(robot.home, objects),
        planner,
        subseed(seed, purpose, trial.index),
        task.config.supervisor.self_collision_min_m,
    )
    rng = stream(seed, purpose, trial.index)
    noise_m = task.config.teleop.operator.along_noise_m
    errors_m = noise_m * np.clip(rng.standard_normal(len(SIDES)), -2.0, 2.0)
    q: list[Array] = []
    gripper: list[Array] = []
    for segment in solution.segments:
        targets = _streamed(segment, robot, errors_m, rate_hz)
        q.append(targets)
        gripper.append(np.tile(segment.openings, (len(targets), 1)))
    last = solution.segments[-1]
    rest = round(rate_hz * REST_S)
    q.append(np.tile(last.trajectory.q[-1], (rest, 1)))
    gripper.append(np.tile(last.openings, (rest, 1)))
    return Demonstration(rate_hz, np.vstack(q), np.vstack(gripper))


def _streamed(segment: Segment, robot: Robot, errors_m: Array, rate_hz: float) -> Array:
    """Return the joint targets (T, n) of a segment, slowed, with the hands' errors (2,)."""
    motion = segment.trajectory
    speed_share = float(np.abs(motion.v / robot.v_max).max())
    slower = max(1.0, speed_share / _SPEED_SHARE)
    times: Array = np.arange(0.0, motion.duration_s, 1.0 / (slower * rate_hz), dtype=float)
    targets = motion.sample_many(times).q
    # A hand that takes something from the other one needs its room.
    both_open = min(segment.openings) == OPEN
    if not both_open or segment.phase not in ("approach", "descend"):
        return targets
    arrived = np.array([minimum_jerk(t / motion.duration_s)[0] for t in times.tolist()])
    shares = arrived if segment.phase == "approach" else 1.0 - arrived
    for side in GROUP_ARMS[motion.group]:
        _shift_along(solvers(robot)[side], targets, shares * errors_m[SIDES.index(side)])
    return targets


def _shift_along(arm: ArmIK, q: Array, offsets_m: Array) -> None:
    """Shift a hand by offsets (T,) along the part between its fingers; q is (T, n) [rad]."""
    for row, offset_m in zip(q[:, arm.joints], offsets_m.tolist(), strict=True):
        T_world_tcp = arm.tcp_pose(row) @ pose(np.eye(3), (offset_m, 0.0, 0.0))
        shifted = arm.nearest(T_world_tcp, row)
        if shifted is not None:
            row[:] = shifted
