"""Configuration of the held-object moves of the `plan` stage."""

from __future__ import annotations

from pydantic import Field

from minidual.config.base import AtLeast, AtMost, StrictModel


class HeldMovesConfig(StrictModel):
    """Number and limits of the held-object moves."""

    moves_n: AtLeast[int] = Field(default=100, ge=2, le=10_000)
    """Moves per generator seed."""
    executed_n: AtLeast[int] = Field(default=6, ge=1, le=1000)
    cpu_time_median_max_s: AtMost[float | None] = Field(default=0.05, gt=0.0, le=3600.0)
    """Median CPU time from query to proven trajectory; null sets no limit."""
    executed_error_max_m: AtMost[float] = Field(default=0.002, gt=0.0, le=0.002)
    executed_error_max_rad: AtMost[float] = Field(default=0.01745, gt=0.0, le=0.01745)
    """One degree."""
