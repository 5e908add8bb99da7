"""Configuration of the `train-act` and `deploy` stages."""

from __future__ import annotations

from pydantic import Field

from minidual.config.base import StrictModel


class TrainConfig(StrictModel):
    """How the policy is trained."""

    steps_n: int = Field(2000, ge=1, le=1_000_000)


class DeployConfig(StrictModel):
    """How the policy is tried."""

    trials_n: int = Field(50, ge=1, le=10000)
