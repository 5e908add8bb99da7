"""Checks of configurations and goals; configurations at poses."""

import itertools
from collections.abc import Mapping

import numpy as np

from minidual.collision.errors import GoalInCollisionError, OutOfLimitsError, StartInCollisionError
from minidual.errors import UsageError
from minidual.motion.ik import check_pose, solvers
from minidual.proof.scene_engines import SceneEngines
from minidual.registry import Registry
from minidual.robot.pair import SIDES, Array, Robot

GROUP_ARMS: Registry[tuple[str, ...]] = Registry(
    "group", {"left_arm": ("left",), "right_arm": ("right",), "both_arms": SIDES}
)
_ROUNDING = 1e-9


def check_joints(q: Array, what: str, robot: Robot) -> Array:
    """Return q (n,), clipped to the limits within rounding.

    Raises:
        OutOfLimitsError: Wrong shape, not finite, or outside limits.
    """
    q = np.array(q, dtype=float)
    if q.shape != (robot.dof,):
        raise OutOfLimitsError(f"the {what} has shape {q.shape}; all {robot.dof} joints are needed, left arm first")
    if not np.isfinite(q).all():
        bad = int(np.argmin(np.isfinite(q)))
        raise OutOfLimitsError(f"the {what} has {robot.joint_names[bad]} = {q[bad]}; it must be a finite number")
    outside = np.maximum(robot.q_lower - q, q - robot.q_upper)
    worst = int(np.argmax(outside))
    if outside[worst] > _ROUNDING:
        raise OutOfLimitsError(
            f"the {what} has {robot.joint_names[worst]} = {q[worst]:.4f} rad; "
            f"its limits are {robot.q_lower[worst]:.4f} to {robot.q_upper[worst]:.4f} rad"
        )
    return np.clip(q, robot.q_lower, robot.q_upper)


def goal_joints(group: str, q_start: Array, q_goal: Array, robot: Robot, what: str = "goal") -> Array:
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
        return check_joints(full, what, robot)
    full[joints] = check_joints(q_goal, what, robot)[joints]
    if np.abs(full - q_goal).max() > 1e-6:
        raise UsageError(
            f"the goal moves joints outside {group}, which holds the other arm",
            remedy="plan with the group both_arms, or give only the group's own joints",
        )
    return full


def require_free(engine: SceneEngines, q: Array, what: str) -> None:
    """Check that q (n,) is free.

    Raises:
        StartInCollisionError, GoalInCollisionError: It is not.
    """
    near = engine.closest(q, 0.001)
    if near and near[0].distance_m <= 0.0:
        kind = StartInCollisionError if what == "start" else GoalInCollisionError
        kept = engine.scene.min_distance_m
        # Obstacles are grown by this distance, so being near one counts as contact.
        grown = f" (the scene keeps {kept * 1e3:g} mm from obstacles)" if kept > 0.0 else ""
        raise kind(
            f"the {what} is in collision: {near[0]}{grown}",
            remedy="move it, remove the obstacle, or allow the pair in the scene",
        )


def check_targets(group: str, targets: Mapping[str, Array]) -> dict[str, Array]:
    """Return checked {arm: T_world_tcp (4, 4)}.

    Raises:
        UsageError: Wrong arms or an invalid pose.
    """
    arms = GROUP_ARMS[group]
    if set(targets) != set(arms):
        raise UsageError(f"the targets name {', '.join(sorted(targets)) or 'no arm'}; {group} needs {', '.join(arms)}")
    return {arm: check_pose(targets[arm], f"the target of the {arm} hand") for arm in arms}


def pose_goals(
    group: str,
    q_start: Array,
    targets: Mapping[str, Array],
    engine: SceneEngines,
    rng: np.random.Generator,
    restarts_n: int,
    goals_n: int = 1,
) -> list[Array]:
    """Return free configurations (n,) at tcp poses, nearest to the start first.

    Raises:
        IKUnreachableError, GoalInCollisionError: None exists.
        UsageError: Wrong arms or invalid pose.
    """
    arms = solvers(engine.scene.robot)
    solutions = {
        side: arms[side].solutions(T, q_start[arms[side].joints], rng, restarts_n)
        for side, T in check_targets(group, targets).items()
    }
    found: dict[str, list[Array]] = {side: [] for side in solutions}
    while True:
        new = {side: list(itertools.islice(more, goals_n)) for side, more in solutions.items()}
        for side in found:
            found[side] += new[side]
        combined = []
        for parts in itertools.product(*found.values()):
            q = np.array(q_start)
            for side, part in zip(found, parts, strict=True):
                q[arms[side].joints] = part
            combined.append(q)
        combined.sort(key=lambda q: float(np.linalg.norm(q - q_start)))
        free = list(itertools.islice(filter(engine.solids.free, combined), goals_n))
        if free:
            return free
        if not any(new.values()):
            require_free(engine, combined[0], "goal")
            raise GoalInCollisionError(
                "the goal is too close to contact: no plane separates all pairs at any of its solutions",
                remedy="move it a little, or allow the pair in the scene",
            )
