"""Configuration of `plan` and the planner."""

from pydantic import Field

from minidual.config.base import AtLeast, AtMost, StrictModel


class MotionLimits(StrictModel):
    """Limits of a timed motion, as fractions of the robot's."""

    velocity_scale: float = Field(default=0.95, ge=0.01, le=1.0)
    acceleration_scale: float = Field(default=0.9, ge=0.01, le=1.0)
    torque_scale: float = Field(default=0.95, ge=0.01, le=1.0)
    jerk_scale: float = Field(default=0.95, ge=0.01, le=1.0)
    """Fraction of the jerk limits."""
    smoothing_s: float = Field(default=0.04, ge=0.0, le=1.0)
    """Averaging window of the path position; makes acceleration continuous."""


class PlannerConfig(MotionLimits):
    """Settings of one plan; none weakens its proof."""

    planner: str = Field(default="rrtconnect", min_length=1)
    """Row of PLANNERS: rrtconnect or kpiece."""
    timing: str = Field(default="own", min_length=1)
    """Row of TIMING_ENGINES: own or toppra.

    toppra limits neither jerk nor the rate of torque. It times plans for empty hands; moves of an
    object in both hands are always timed by own.
    """
    range_rad: float = Field(default=1.0, ge=0.05, le=10.0)
    """Longest edge of a search tree (Euclidean)."""
    edge_step_rad: float = Field(default=0.08, ge=0.0005, le=0.2)
    """Largest joint step between checks in the search."""
    padding_m: float = Field(default=0.008, ge=0.0, le=0.1)
    """Clearance in the search; less near a tight start or goal."""
    fallback_planners: tuple[str, ...] = ("rrtconnect", "kpiece")
    """Planners used in turn after four failed searches."""
    search_checks_n: int = Field(default=2_500, ge=100, le=100_000_000)
    """State checks of the first search; each further one gets half as many more."""
    shortcut_rounds_n: int = Field(default=10, ge=0, le=10_000)
    blend_radius_rad: float = Field(default=0.3, gt=0.001, le=2.0)
    ik_restarts_n: int = Field(default=30, ge=1, le=10_000)
    goal_candidates_n: int = Field(default=2, ge=1, le=100)
    """Joint solutions tried for a pose goal, nearest first."""
    verify_step_rad: float = Field(default=0.002, ge=1e-4, le=0.002)
    """Largest joint step between audit samples."""
    budget_checks_n: int = Field(default=600_000, ge=1, le=1_000_000_000)
    """Work of a query until it gives up, in state checks: 12 to 50 s of a core.

    It limits all queries of trials, demonstrations and query sets.
    """
    budget_s: float = Field(default=10.0, ge=1e-6, le=3600.0)
    """Wall time of `minidual plan --to`, which a person waits for, instead of counted work."""


class GroupTimes(StrictModel):
    """Limits by group [s]; None: no limit."""

    left_arm: AtMost[float | None] = Field(default=0.2, gt=0.0, le=3600.0)
    right_arm: AtMost[float | None] = Field(default=0.2, gt=0.0, le=3600.0)
    both_arms: AtMost[float | None] = Field(default=2.0, gt=0.0, le=3600.0)


class HeldMovesConfig(StrictModel):
    """Moves of an object in both hands."""

    moves_n: AtLeast[int] = Field(default=100, ge=2, le=10_000)
    """Moves of each seed."""
    executed_n: AtLeast[int] = Field(default=6, ge=1, le=1000)
    cpu_time_median_max_s: AtMost[float | None] = Field(default=2.0, gt=0.0, le=3600.0)
    """Median CPU time from query to proven trajectory; None: no limit."""
    executed_error_max_m: AtMost[float] = Field(default=0.002, gt=0.0, le=0.002)
    executed_error_max_rad: AtMost[float] = Field(default=0.01745, gt=0.0, le=0.01745)
    """1 degree."""


class PlanConfig(StrictModel):
    """Configuration of `plan`."""

    queries_n: AtLeast[int] = Field(default=20, ge=1, le=10000)
    second_seed: int = Field(default=20261, ge=0, lt=2**63)
    second_queries_n: AtLeast[int] = Field(default=0, ge=0, le=10000)
    obstacles_n: AtLeast[int] = Field(default=5, ge=0, le=50)
    blocked_fraction: AtLeast[float] = Field(default=1.0, ge=0.0, le=1.0)
    """Share of queries whose straight line in joint space is blocked."""
    agreement_states_n: AtLeast[int] = Field(default=2000, ge=100, le=1_000_000)
    success_rate_min: AtLeast[float] = Field(default=1.0, ge=0.0, le=1.0)
    time_max_s: AtMost[float] = Field(default=10.0, gt=0.0, le=3600.0)
    """Limit on the slowest query."""
    time_median_max_s: GroupTimes = GroupTimes()
    """Limits on the median; generous, so that no gate depends on the machine's speed or load."""
    agreement_min: AtLeast[float] = Field(default=0.999, ge=0.0, le=1.0)
    planner: PlannerConfig = PlannerConfig()
    held: HeldMovesConfig = HeldMovesConfig()
