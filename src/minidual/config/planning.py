"""Configuration of the `plan` stage."""

from __future__ import annotations

from pydantic import Field

from minidual.config.base import StrictModel


class PlanConfig(StrictModel):
    """How many queries are planned, and how fast it must go."""

    queries_n: int = Field(20, ge=1, le=10000)
    """Queries per planning group."""
