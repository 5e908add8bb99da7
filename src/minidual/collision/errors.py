"""Reasons for refusing to plan."""

from minidual.errors import MinidualError


class PlanningError(MinidualError):
    """Base class; `reason` is machine-readable."""

    reason = "planning_failed"

    def __init_subclass__(cls, reason: str | None = None) -> None:
        cls.reason = reason or cls.reason


class IKUnreachableError(PlanningError, reason="ik_unreachable"):
    """No collision-free configuration reaches the pose."""


class StartInCollisionError(PlanningError, reason="start_in_collision"):
    """The start is in collision."""


class GoalInCollisionError(PlanningError, reason="goal_in_collision"):
    """The goal is in collision."""


class OutOfLimitsError(PlanningError, reason="out_of_limits"):
    """A configuration is outside the limits, not finite, or misshapen."""


class NoPathInTimeError(PlanningError, reason="no_path_in_time"):
    """No verified path within the budget of work or time."""


class TimingError(PlanningError, reason="timing_failed"):
    """No timing within the limits."""


class ClosedChainError(PlanningError, reason="closed_chain"):
    """The hands cannot keep their grasps."""


class LinearMoveError(PlanningError, reason="linear_blocked"):
    """A straight motion ends early."""
