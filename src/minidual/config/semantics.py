"""Named postures."""

from __future__ import annotations

from pydantic import Field

from minidual.config.base import StrictModel


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
