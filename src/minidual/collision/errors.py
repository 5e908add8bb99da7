"""Why a plan was refused: one class a reason, each message with names and numbers."""

from __future__ import annotations

from minidual.errors import MinidualError


class PlanningError(MinidualError):
    """No plan. `reason` is a short machine-readable word that tables and CSV files keep."""

    reason = "planning_failed"


class IKUnreachableError(PlanningError):
    """No joint configuration reaches the asked pose (or none that is free of collision)."""

    reason = "ik_unreachable"


class StartInCollisionError(PlanningError):
    """The start configuration touches something that is not allowed."""

    reason = "start_in_collision"


class GoalInCollisionError(PlanningError):
    """The goal configuration touches something that is not allowed."""

    reason = "goal_in_collision"


class OutOfLimitsError(PlanningError):
    """A configuration leaves the joint limits or is not a finite vector of the right shape."""

    reason = "out_of_limits"


class NoPathInTimeError(PlanningError):
    """No verified path was found within the budget."""

    reason = "no_path_in_time"


class TimingError(PlanningError):
    """A path could not be given times inside the limits."""

    reason = "timing_failed"


class ClosedChainError(PlanningError):
    """The two hands cannot keep their grasps along the asked object path."""

    reason = "closed_chain"


class LinearMoveError(PlanningError):
    """A straight line of the hands ends before the part of it that was asked for."""

    reason = "linear_blocked"
