"""Configuration of the `env-check` and `carry` stages."""

from __future__ import annotations

from pydantic import Field

from minidual.config.base import StrictModel


class EnvCheckConfig(StrictModel):
    """What is driven to see that the arms answer."""

    step_rad: float = Field(0.3, gt=0.0, le=0.6)


class CarryConfig(StrictModel):
    """How many carries are tried."""

    trials_n: int = Field(20, ge=1, le=10000)
