"""Configuration of the arms and named postures."""

from typing import Annotated

from pydantic import Field

from minidual.config.base import StrictModel

Angle = Annotated[float, Field(ge=-100.0, le=100.0)]


class RobotConfig(StrictModel):
    """The arms."""

    arm: str = Field(default="panda", min_length=1)
    """Row of robot.pair.ARM_MODELS."""


class NamedStateConfig(StrictModel):
    """A posture of one or both arms."""

    left_rad: tuple[Angle, ...] | None = None
    """Base first."""
    right_rad: tuple[Angle, ...] | None = None
    description: str = ""


class SemanticsConfig(StrictModel):
    """Named states."""

    states: dict[str, NamedStateConfig] = Field(default={})
    """Added to the arm model's states (`home` and others), or replace them."""
