"""Motions of hands in a pipeline: free ones, slowed; straight ones, proven."""

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from minidual.collision.scene import PlanningScene
from minidual.motion.api import PlanResult
from minidual.motion.linear import TIP_LIMITS, Line, LinearPlanner
from minidual.robot.pair import SIDES, Array, group_of
from minidual.robot.trajectory import Trajectory
from minidual.skills.phases import PHASES
from minidual.skills.pipeline.stage import CandidateError, Tools
from minidual.skills.states import Segment, State

_TIP_MAX_M_PER_S = 1.6
"""Hand speed of free motions; the supervisor stops the arms at 1.7 m/s."""
_TIPS_EVERY = 8
"""Samples from one evaluation of the hands to the next."""
_CRAWL_RATIO = 2.5
"""Largest time of a straight motion over that of the hands alone; near singular postures it is 5
or more."""


def free(tools: Tools, phase: str, state: State, plan: PlanResult, scene: PlanningScene) -> Segment:
    """Return a planned free motion, slowed to 1.6 m/s.

    Hands that hold something are slowed to the limits of a carry.
    """
    motion = plan.trajectory
    sampled = motion.q[::_TIPS_EVERY]
    tips = np.array([tools.planner.kinematics.tcp_poses(q) for q in sampled])
    ratio = _slowdown(tips, _TIPS_EVERY * motion.dt_s, [SIDES.index(arm) for arm in state.held_by])
    slowed = Trajectory(
        ratio * motion.times,
        motion.q,
        motion.v / ratio,
        motion.a / ratio**2,
        motion.group,
    )
    return Segment(phase, slowed, state.openings, scene, plan.verification)


def _slowdown(tips: Array, step_s: float, holding: list[int]) -> float:
    """Return the factor of the duration, at least 1, that keeps the hands' limits.

    Args:
        tips: T_world_tcp (m, 2, 4, 4) of both hands, every `step_s`.
        step_s: Time between two of them.
        holding: Indices of the hands that hold something.
    """
    carry = PHASES["carry"].limits or TIP_LIMITS
    speeds = np.diff(tips[:, :, :3, 3], axis=0) / step_s
    fastest = np.linalg.norm(speeds, axis=2).max(initial=0.0)
    ratio = max(1.0, fastest / _TIP_MAX_M_PER_S)
    for hand in holding:
        lengths_m = [Line(*ends).length_m for ends in pairwise(tips[:, hand])]
        speed = max(lengths_m, default=0.0) / step_s
        changes = np.linalg.norm(np.diff(speeds[:, hand], axis=0), axis=1)
        acceleration = changes.max(initial=0.0) / step_s
        by_speed = speed / carry.speed_m_per_s
        by_acceleration = np.sqrt(acceleration / carry.acceleration_m_per_s2)
        ratio = max(ratio, by_speed, by_acceleration)
    return ratio


def straight(
    tools: Tools,
    phase: str,
    state: State,
    targets: Mapping[str, Array],
    scene: PlanningScene,
) -> Segment:
    """Return the proven straight motion of hands to {arm: T_world_tcp (4, 4)}.

    Raises:
        PlanningError: There is none.
        CandidateError: It crawls, because the arms pass a nearly singular posture.
    """
    engines = tools.planner.engines(scene)
    limits = PHASES[phase].limits
    linear = LinearPlanner(kinematics=tools.planner.kinematics)
    move = linear.plan(group_of(targets), state.q, targets, engines, limits=limits)
    tips = tools.planner.kinematics.tcp_poses(state.q)
    way_m = max(Line(tips[SIDES.index(arm)], T).length_m for arm, T in targets.items())
    tip_limits = limits or TIP_LIMITS
    speed = tip_limits.speed_m_per_s
    acceleration = tip_limits.acceleration_m_per_s2
    alone_s = way_m / speed + speed / acceleration
    takes_s = move.trajectory.duration_s
    if takes_s > _CRAWL_RATIO * alone_s:
        raise CandidateError(
            "crawls",
            f"{phase}: {way_m:.2f} m straight in {takes_s:.1f} s instead of {alone_s:.1f}: "
            "the arms pass a nearly singular posture",
        )
    return Segment(phase, move.trajectory, state.openings, scene, move.verification)


def off(tips: Mapping[str, Array], height_m: float) -> Array:
    """Return the shift (3,) [m] against the approach axes of hands at {arm: T_world_tcp}.

    Hands that face each other go up.
    """
    back = -np.sum([T[:3, 2] for T in tips.values()], axis=0)
    norm = float(np.linalg.norm(back))
    if norm > 0.1:
        return height_m * (back / norm)
    return height_m * np.array([0.0, 0.0, 1.0])
