"""Configuration of the `plan` stage and of the planner that other stages use."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from minidual.config.base import StrictModel
from minidual.config.held_moves import HeldMovesConfig

PlannerName = Literal["rrtconnect", "rrt", "rrtstar", "bitstar", "kpiece"]


class PlannerConfig(StrictModel):
    """How one plan is made. The defaults solve the standard queries; none of them weakens the final proof."""

    planner: PlannerName = "rrtconnect"
    range_rad: float = Field(default=1.0, gt=0.0, le=10.0)
    """Longest edge of a search tree, Euclidean in joint space."""
    edge_step_rad: float = Field(default=0.08, gt=0.0, le=0.2)
    """Largest joint step between two collision checks during the search; the proof finds what that misses."""
    padding_m: float = Field(default=0.008, ge=0.0, le=0.1)
    """Distance that the search keeps; it relaxes near a start or goal that is nearer than that."""
    fallback_planners: tuple[PlannerName, ...] = ("rrtconnect", "kpiece")
    """Planners that take turns after four searches of `planner` that found nothing."""
    search_checks_n: int = Field(default=2_500, ge=100, le=100_000_000)
    """State checks after which one search gives up; every further attempt has half as many again."""
    shortcut_rounds_n: int = Field(default=10, ge=0, le=10_000)
    blend_radius_rad: float = Field(default=0.3, gt=0.001, le=2.0)
    """Largest half length of a rounded corner."""
    velocity_scale: float = Field(default=0.95, gt=0.0, le=1.0)
    """Fraction of the robot's velocity limits that a plan uses; the rest is headroom."""
    acceleration_scale: float = Field(default=0.9, gt=0.0, le=1.0)
    torque_scale: float = Field(default=0.95, gt=0.0, le=1.0)
    jerk_scale: float = Field(default=0.95, gt=0.0, le=1.0)
    """Fraction of libfranka's jerk limits that a plan uses."""
    smoothing_s: float = Field(default=0.04, ge=0.0, le=1.0)
    """Window over which the path position is averaged, so that the acceleration does not jump."""
    ik_restarts_n: int = Field(default=30, ge=1, le=10_000)
    goal_candidates_n: int = Field(default=2, ge=1, le=100)
    """Joint solutions of a pose goal that are tried in turn, the nearest first."""
    verify_step_rad: float = Field(default=0.002, gt=0.0, le=0.002)
    """Largest joint step between the samples of an audit, which tests the continuous proof."""
    budget_s: float = Field(default=10.0, gt=0.0, le=3600.0)
    """Wall time after which a query is given up."""


class GroupTimes(StrictModel):
    """A time [s] for each planning group; None sets no limit."""

    left_arm: float | None = Field(default=None, gt=0.0)
    right_arm: float | None = Field(default=None, gt=0.0)
    both_arms: float | None = Field(default=None, gt=0.0)


class PlanConfig(StrictModel):
    """How many queries are planned, and how fast it must go."""

    queries_n: int = Field(default=20, ge=1, le=10000)
    """Queries per planning group."""
    second_seed: int = Field(default=20261, ge=0, lt=2**63)
    """Seed of a second query set, so that success does not rest on one set."""
    second_queries_n: int = Field(default=0, ge=0, le=10000)
    """Queries per planning group of the second set."""
    obstacles_n: int = Field(default=5, ge=0, le=50)
    """Boxes and cylinders on the table of each query."""
    blocked_fraction: float = Field(default=1.0, ge=0.0, le=1.0)
    """Share of the queries that are hard by construction: no straight line free, past an obstacle or an arm."""
    agreement_states_n: int = Field(default=2000, ge=100, le=1_000_000)
    """Random states on which the two collision engines are compared."""
    success_rate_min: float = Field(default=1.0, ge=0.0, le=1.0)
    time_max_s: float = Field(default=10.0, gt=0.0, le=3600.0)
    time_median_max_s: GroupTimes = GroupTimes()
    """Largest median time of each group, of every set."""
    time_p99_max_s: float | None = Field(default=None, gt=0.0)
    """Largest 99th percentile of the time of each group, of every set."""
    agreement_min: float = Field(default=0.999, ge=0.0, le=1.0)
    planner: PlannerConfig = PlannerConfig()
    held: HeldMovesConfig = HeldMovesConfig()
