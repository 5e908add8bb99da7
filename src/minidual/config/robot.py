"""Configuration of the arms."""

from __future__ import annotations

from pydantic import Field

from minidual.config.base import StrictModel


class RobotConfig(StrictModel):
    """Which arms stand on the table."""

    arm: str = Field(default="panda", min_length=1)
    """Row of the table of arms (minidual.robot.arms): panda, xarm7, ur5, or one of another distribution."""
