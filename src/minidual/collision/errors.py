"""Reasons for refusing to plan."""

from __future__ import annotations

from minidual.errors import MinidualError


class PlanningError(MinidualError):
    """Base class; `reason` is machine-readable."""

    reason = "planning_failed"


class IKUnreachableError(PlanningError):
    """No collision-free configuration reaches the pose."""

    reason = "ik_unreachable"


class StartInCollisionError(PlanningError):
    """The start is in collision."""

    reason = "start_in_collision"


class GoalInCollisionError(PlanningError):
    """The goal is in collision."""

    reason = "goal_in_collision"


class OutOfLimitsError(PlanningError):
    """A configuration is outside the limits, not finite, or misshapen."""

    reason = "out_of_limits"


class NoPathInTimeError(PlanningError):
    """No verified path within the time budget."""

    reason = "no_path_in_time"


class TimingError(PlanningError):
    """No timing within the limits."""

    reason = "timing_failed"


class ClosedChainError(PlanningError):
    """The hands cannot keep their grasps."""

    reason = "closed_chain"


class LinearMoveError(PlanningError):
    """A straight motion ends early."""

    reason = "linear_blocked"
