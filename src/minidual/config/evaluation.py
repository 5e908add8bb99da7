"""Configuration of `benchmark` and `report`."""

from typing import Annotated

from pydantic import Field

from minidual.config.base import AtLeast, Rate, StrictModel


class BenchmarkConfig(StrictModel):
    """Configuration of `benchmark`."""

    tasks: AtLeast[tuple[str, ...]] = ()
    """Empty: the run's `task` and `further_tasks`."""
    further_tasks: AtLeast[dict[str, Annotated[int, Field(ge=1, le=10000)]]] = Field(default={})
    """Undisturbed trials of each method in other tasks, {task: trials}; at most `trials_n`."""
    methods: AtLeast[tuple[str, ...]] = Field(default=("moveit", "impedance", "act"), min_length=1)
    conditions: AtLeast[tuple[str, ...]] = Field(default=("clean",), min_length=1)
    """Conditions, with `clean`; or `all`."""
    trials_n: AtLeast[int] = Field(default=30, ge=1, le=10000)
    """Undisturbed trials of each method, which have limits."""
    perturbed_trials_n: AtLeast[int] = Field(default=20, ge=1, le=10000)
    """Trials of each method under each other condition, on the first of the same starts."""
    success_rate_min: AtLeast[dict[str, Rate]] = Field(default={"moveit": 0.8, "impedance": 0.8, "act": 0.5})
    """By method; others are only reported."""


class ReportConfig(StrictModel):
    """Configuration of `report`."""

    title: str = Field(default="minidual: a measured dual-arm system", min_length=1)
