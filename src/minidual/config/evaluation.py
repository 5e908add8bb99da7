"""Configuration of the `benchmark` and `report` stages."""

from __future__ import annotations

from pydantic import Field

from minidual.config.base import StrictModel


class BenchmarkConfig(StrictModel):
    """Which methods are compared, and how often."""

    methods: tuple[str, ...] = Field(("moveit", "impedance", "act"), min_length=1)
    trials_n: int = Field(20, ge=1, le=10000)


class ReportConfig(StrictModel):
    """What the report is called."""

    title: str = Field("minidual: a measured dual-arm system", min_length=1)
