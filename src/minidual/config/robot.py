"""Configuration of the arms and of named postures."""

from __future__ import annotations

from pydantic import Field

from minidual.config.base import StrictModel


class RobotConfig(StrictModel):
    """Which arms are used."""

    arm: str = Field(default="panda", min_length=1)
    """Name in the table of arms (minidual.robot.arms)."""


class NamedStateConfig(StrictModel):
    """A posture of one or both arms."""

    left_rad: tuple[float, ...] | None = None
    """Joints of the left arm, base first."""
    right_rad: tuple[float, ...] | None = None
    description: str = ""


class SemanticsConfig(StrictModel):
    """Named states."""

    states: dict[str, NamedStateConfig] = Field(default={})
    """Added to the arm model's states (`home` and others), replacing same names."""
