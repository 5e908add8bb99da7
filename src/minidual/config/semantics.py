"""Named postures beside those of the arm model."""

from __future__ import annotations

from pydantic import Field

from minidual.config.base import StrictModel


class NamedStateConfig(StrictModel):
    """A posture with a name. One arm may be left out; the state then says nothing about it."""

    left_rad: tuple[float, ...] | None = None
    """Joints of the left arm, base first."""
    right_rad: tuple[float, ...] | None = None
    """Joints of the right arm, base first."""
    description: str = ""


class SemanticsConfig(StrictModel):
    """Named states."""

    states: dict[str, NamedStateConfig] = Field(default={})
    """They add to the arm model's own (`home` and others), or replace one under its name."""
