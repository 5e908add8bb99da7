"""Turn what was asked (joints or poses) into checked joint configurations."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np

from minidual.collision.errors import GoalInCollisionError, OutOfLimitsError, StartInCollisionError
from minidual.collision.mujoco_engine import MujocoEngine
from minidual.errors import UsageError, unknown_name
from minidual.motion.ik import ArmIK, check_pose
from minidual.robot.constants import ARMS, DOF, GROUPS, JOINT_NAMES, Q_LOWER, Q_UPPER, Array

_ROUNDING = 1e-9


def group_arms(group: str) -> tuple[str, ...]:
    """Return the arms of a planning group.

    Raises:
        UsageError: No group of this name.
    """
    if group not in GROUPS:
        raise unknown_name("group", group, GROUPS)
    return ARMS if group == "both_arms" else (group.removesuffix("_arm"),)


def check_joints(q: Array, what: str) -> Array:
    """Return q as (14,) inside the limits (rounding at a limit is clipped).

    Raises:
        OutOfLimitsError: Wrong shape, not finite, or a joint outside its limits.
    """
    q = np.array(q, dtype=float)
    if q.shape != (DOF,):
        raise OutOfLimitsError(f"the {what} has shape {q.shape}; all {DOF} joints are needed, left arm first")
    if not np.isfinite(q).all():
        bad = int(np.argmin(np.isfinite(q)))
        raise OutOfLimitsError(f"the {what} has {JOINT_NAMES[bad]} = {q[bad]}; it must be a finite number")
    outside = np.maximum(Q_LOWER - q, q - Q_UPPER)
    worst = int(np.argmax(outside))
    if outside[worst] > _ROUNDING:
        raise OutOfLimitsError(
            f"the {what} has {JOINT_NAMES[worst]} = {q[worst]:.4f} rad; "
            f"its limits are {Q_LOWER[worst]:.4f} to {Q_UPPER[worst]:.4f} rad"
        )
    return np.clip(q, Q_LOWER, Q_UPPER)


def goal_joints(group: str, q_start: Array, q_goal: Array) -> Array:
    """Return the goal as (14,): a goal of the group's own size is completed by the start's other joints.

    Raises:
        OutOfLimitsError: Wrong shape, not finite, outside the limits.
        UsageError: A 14-joint goal that moves an arm outside the group.
    """
    joints = GROUPS[group]
    q_goal = np.asarray(q_goal, dtype=float)
    if q_goal.shape == (joints.stop - joints.start,):
        full = np.array(q_start)
        full[joints] = q_goal
        return check_joints(full, "goal")
    full = check_joints(q_goal, "goal")
    held = np.ones(DOF, dtype=bool)
    held[joints] = False
    if held.any() and np.abs(full - q_start)[held].max() > 1e-6:
        raise UsageError(
            f"the goal moves joints outside {group}, which holds the other arm",
            remedy="plan with the group both_arms, or give only the group's own joints",
        )
    full[held] = q_start[held]
    return full


def require_free(engine: MujocoEngine, q: Array, what: str) -> None:
    """Check that nothing touches at q (14,).

    Raises:
        StartInCollisionError, GoalInCollisionError: With the pair and the depth.
    """
    near = engine.closest(q, 0.001)
    if near and near[0].distance_m <= 0.0:
        kind = StartInCollisionError if what == "start" else GoalInCollisionError
        kept = engine.min_distance_m
        # Obstacles are grown by the distance to keep, so nearness to one looks like touching.
        grown = f" (the scene keeps {kept * 1e3:g} mm from obstacles)" if kept > 0.0 else ""
        raise kind(
            f"the {what} is in collision: {near[0]}{grown}",
            remedy="move it, remove the obstacle, or allow the pair in the scene",
        )


class PoseGoals:
    """Joint configurations for tcp poses of one or both arms."""

    def __init__(self) -> None:
        self._solvers = {arm: ArmIK(arm) for arm in ARMS}

    def candidates(
        self,
        group: str,
        q_start: Array,
        targets: Mapping[str, Array],
        engine: MujocoEngine,
        rng: np.random.Generator,
        *,
        restarts_n: int,
        candidates_n: int,
    ) -> list[Array]:
        """Return up to candidates_n configurations (14,) that are free, the nearest to the start first.

        Raises:
            UsageError: The targets do not name exactly the group's arms, or a pose is none.
            IKUnreachableError: A pose that no configuration reaches; with the residual.
            GoalInCollisionError: Every configuration found touches something; with the pair of the nearest.
        """
        arms = group_arms(group)
        if set(targets) != set(arms):
            raise UsageError(
                f"the targets name {', '.join(sorted(targets)) or 'no arm'}; {group} needs {', '.join(arms)}"
            )
        solvers = {
            arm: self._solvers[arm].solutions(
                check_pose(targets[arm], f"the target of the {arm} hand"),
                q_start[GROUPS[f"{arm}_arm"]],
                rng,
                restarts_n,
            )
            for arm in arms
        }
        found: dict[str, list[Array]] = {arm: [] for arm in arms}
        while True:
            new = {arm: list(itertools.islice(solvers[arm], candidates_n)) for arm in arms}
            for arm in arms:
                found[arm] += new[arm]
            combined = _combinations(q_start, found)
            free = list(itertools.islice((q for q in combined if not engine.in_collision(q)), candidates_n))
            if free:
                return free
            if not any(new.values()):
                require_free(engine, combined[0], "goal")


def _combinations(q_start: Array, found: Mapping[str, list[Array]]) -> list[Array]:
    """Return every combination of the arms' solutions as (14,), the nearest to the start first."""
    combined = []
    for parts in itertools.product(*found.values()):
        q = np.array(q_start)
        for arm, part in zip(found, parts, strict=True):
            q[GROUPS[f"{arm}_arm"]] = part
        combined.append(q)
    return sorted(combined, key=lambda q: float(np.linalg.norm(q - q_start)))
