"""Configuration of the `benchmark` and `report` stages."""

from __future__ import annotations

from pydantic import Field

from minidual.config.base import AtLeast, Rate, StrictModel


class BenchmarkConfig(StrictModel):
    """Methods, conditions and numbers of trials."""

    methods: AtLeast[tuple[str, ...]] = Field(default=("moveit", "impedance", "act"), min_length=1)
    conditions: AtLeast[tuple[str, ...]] = Field(default=("clean",), min_length=1)
    """Names of conditions, `clean` among them, or `all`."""
    trials_n: AtLeast[int] = Field(default=30, ge=1, le=10000)
    """Undisturbed trials per method; limits apply to these."""
    perturbed_trials_n: AtLeast[int] = Field(default=20, ge=1, le=10000)
    """Trials per method and other condition, on the first of the same starts."""
    success_rate_min: AtLeast[dict[str, Rate]] = Field(default={"moveit": 0.8, "impedance": 0.8, "act": 0.5})
    """Least success rate by method; others are only reported."""


class ReportConfig(StrictModel):
    """Title of the report."""

    title: str = Field(default="minidual: a measured dual-arm system", min_length=1)
