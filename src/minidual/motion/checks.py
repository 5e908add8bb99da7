"""Checks of requested poses, joints and targets."""

from collections.abc import Mapping

import numpy as np

from minidual.collision.errors import (
    GoalInCollisionError,
    OutOfLimitsError,
    StartInCollisionError,
)
from minidual.errors import UsageError
from minidual.proof.scene_engines import SceneEngines
from minidual.robot.limits import clipped, joint_text, outside_limits
from minidual.robot.pair import GROUP_ARMS, Array, Robot

_ORTHONORMAL = 1e-6
_LAST_ROW = 1e-9
_STILL_RAD = 1e-6
_NEAR_M = 0.001


def check_pose(T: Array, subject: str) -> Array:
    """Return T (4, 4).

    Raises:
        UsageError: Not a finite rigid pose.
    """
    T = np.asarray(T, dtype=float)
    if T.shape != (4, 4):
        raise UsageError(f"{subject} has shape {T.shape}; a pose is (4, 4)")
    if not np.isfinite(T).all():
        raise UsageError(f"{subject} holds a value that is not finite: {T.ravel().tolist()}")
    R = T[:3, :3]
    off = np.abs(R @ R.T - np.eye(3)).max()
    det = np.linalg.det(R)
    last_row_off = np.abs(T[3] - (0.0, 0.0, 0.0, 1.0)).max()
    if off > _ORTHONORMAL or det < 0.0 or last_row_off > _LAST_ROW:
        raise UsageError(
            f"{subject} is no rigid pose: R R^T is {off:.2g} from the identity, det {det:.3f}",
        )
    return T


def place_text(T: Array) -> str:
    """Return the position of a pose (4, 4) for messages."""
    x, y, z = T[:3, 3]
    return f"({x:.3f}, {y:.3f}, {z:.3f}) m"


def check_joints(q: Array, subject: str, robot: Robot) -> Array:
    """Return q (n,), on its limit where it is beyond by no more than rounding.

    Raises:
        OutOfLimitsError: Wrong shape, not finite, or outside limits.
    """
    q = np.array(q, dtype=float)
    if q.shape != (robot.dof,):
        raise OutOfLimitsError(
            f"the {subject} has shape {q.shape}; all {robot.dof} joints are needed, left arm first",
        )
    if not np.isfinite(q).all():
        bad = int(np.argmin(np.isfinite(q)))
        raise OutOfLimitsError(
            f"the {subject} has {robot.joint_names[bad]} = {q[bad]}; it must be a finite number",
        )
    if outside_limits(q, robot).any():
        worst = int(np.argmax(np.maximum(robot.q_lower - q, q - robot.q_upper)))
        value = joint_text(q[worst])
        lower = joint_text(robot.q_lower[worst])
        upper = joint_text(robot.q_upper[worst])
        raise OutOfLimitsError(
            f"the {subject} has {robot.joint_names[worst]} = {value} rad; "
            f"its limits are {lower} to {upper} rad",
        )
    return clipped(q, robot)


def goal_joints(
    group: str,
    q_start: Array,
    q_goal: Array,
    robot: Robot,
    subject: str = "goal",
) -> Array:
    """Return the goal (n,), completed from the start if of the group's size.

    Raises:
        OutOfLimitsError: See `check_joints`.
        UsageError: The goal moves another arm.
    """
    joints = robot.groups[group]
    q_goal = np.asarray(q_goal, dtype=float)
    full = np.array(q_start)
    if q_goal.shape == full[joints].shape:
        full[joints] = q_goal
        return check_joints(full, subject, robot)
    full[joints] = check_joints(q_goal, subject, robot)[joints]
    if np.abs(full - q_goal).max() > _STILL_RAD:
        raise UsageError(
            f"the goal moves joints outside {group}, which holds the other arm",
            remedy="plan with the group both_arms, or give only the group's own joints",
        )
    return full


def require_free(engines: SceneEngines, q: Array, subject: str) -> None:
    """Check that q (n,), the "start" or "goal", is free.

    Raises:
        StartInCollisionError, GoalInCollisionError: It is not.
    """
    near = engines.closest(q, _NEAR_M)
    if not near or near[0].distance_m > 0.0:
        return
    error_type = StartInCollisionError if subject == "start" else GoalInCollisionError
    min_distance_m = engines.scene.min_distance_m
    # Obstacles are grown by this distance, so being near one counts as contact.
    grown = ""
    if min_distance_m > 0.0:
        grown = f" (the scene keeps {min_distance_m * 1e3:g} mm from obstacles)"
    raise error_type(
        f"the {subject} is in collision: {near[0]}{grown}",
        remedy="move it, remove the obstacle, or allow the pair in the scene",
    )


def check_targets(group: str, targets: Mapping[str, Array]) -> dict[str, Array]:
    """Return checked {arm: T_world_tcp (4, 4)}.

    Raises:
        UsageError: Wrong arms or an invalid pose.
    """
    arms = GROUP_ARMS[group]
    if set(targets) != set(arms):
        names = ", ".join(sorted(targets)) or "no arm"
        raise UsageError(f"the targets name {names}; {group} needs {', '.join(arms)}")
    return {arm: check_pose(targets[arm], f"the target of the {arm} hand") for arm in arms}
