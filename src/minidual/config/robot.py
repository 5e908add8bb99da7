"""Configuration of the arms."""

from __future__ import annotations

from pydantic import Field

from minidual.config.base import StrictModel


class RobotConfig(StrictModel):
    """Which arms are used."""

    arm: str = Field(default="panda", min_length=1)
    """Name in the table of arms (minidual.robot.arms)."""
