"""Configuration of the command arbiter."""

from __future__ import annotations

from pydantic import Field

from minidual.config.base import StrictModel


class ArbiterConfig(StrictModel):
    """When a source may drive, and how far a target may move at once."""

    stale_s: float = Field(default=0.1, gt=0.0, le=1.0)
    """A command older than this no longer drives."""
    stop_after_s: float = Field(default=1.0, gt=0.0, le=60.0)
    """A source silent for this long loses its turn; it must be requested again."""
    still_speed_rad_s: float = Field(default=0.05, gt=0.0, le=0.5)
    """The arms are still when no joint is faster."""
    settle_timeout_s: float = Field(default=0.5, gt=0.0, le=10.0)
    """A switch is refused when the arms are not still by then."""
    switch_step_max_rad: float = Field(default=0.1, gt=0.0, le=0.5)
    """Largest step of a joint target that is let through at once; a larger one is aligned."""
    align_speed_rad_s: float = Field(default=1.0, gt=0.0, le=2.0)
    """How fast the target moves towards a source that is farther away."""
