"""Configuration of the `benchmark` and `report` stages."""

from __future__ import annotations

from pydantic import Field

from minidual.config.base import StrictModel


class BenchmarkConfig(StrictModel):
    """Which methods are compared, under which conditions, and how often."""

    methods: tuple[str, ...] = Field(default=("moveit", "impedance", "act"), min_length=1)
    conditions: tuple[str, ...] = Field(default=("clean",), min_length=1)
    """Rows of the table of conditions, `clean` among them, or `all`."""
    trials_n: int = Field(default=30, ge=1, le=10000)
    """Trials of each method that nothing disturbs; limits hold for these."""
    perturbed_trials_n: int = Field(default=20, ge=1, le=10000)
    """Trials of each method under each other condition, on the first of the same starts."""
    success_rate_min: dict[str, float] = Field(default={"moveit": 0.8, "impedance": 0.8, "act": 0.5})
    """Least success rate of a method; a method without an entry is reported without a limit."""


class ReportConfig(StrictModel):
    """What the report is called."""

    title: str = Field(default="minidual: a measured dual-arm system", min_length=1)
