"""Configuration of the held-object moves that the `plan` stage plans and drives."""

from __future__ import annotations

from pydantic import Field

from minidual.config.base import StrictModel


class HeldMovesConfig(StrictModel):
    """How many moves of an object in both hands are planned, and how well and fast it must go."""

    moves_n: int = Field(default=100, ge=2, le=10_000)
    """Moves of each of the two generator seeds."""
    executed_n: int = Field(default=6, ge=1, le=1000)
    """Plans that are driven in the simulated world."""
    cpu_time_median_max_s: float | None = Field(default=0.05, gt=0.0, le=3600.0)
    """Median processor time from query to proven trajectory; null reports it without a limit."""
    executed_error_max_m: float = Field(default=0.002, gt=0.0, le=0.002)
    executed_error_max_rad: float = Field(default=0.01745, gt=0.0, le=0.01745)
    """One degree."""
