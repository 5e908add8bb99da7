"""Configuration of the command arbiter."""

from pydantic import Field

from minidual.config.base import StrictModel

SPEED_OVERRIDE_MIN = 0.1


class ArbiterConfig(StrictModel):
    """When a source may drive, and how far a target may step."""

    stale_s: float = Field(default=0.1, ge=0.001, le=1.0)
    """Older commands are stale and ignored."""
    stop_after_s: float = Field(default=1.0, ge=0.001, le=60.0)
    """A source silent for this long must request its mode again."""
    still_speed_rad_s: float = Field(default=0.05, ge=0.001, le=0.5)
    """The arms are still if every joint is slower."""
    settle_timeout_s: float = Field(default=0.5, ge=0.001, le=10.0)
    """A switch is refused if the arms do not settle within this time."""
    switch_step_max_rad: float = Field(default=0.1, ge=0.001, le=0.5)
    """A larger step of a joint target is ramped at `align_speed_rad_s`; no trajectory may start farther away."""
    align_speed_rad_s: float = Field(default=1.0, ge=0.01, le=2.0)
    speed_override: float = Field(default=1.0, ge=SPEED_OVERRIDE_MIN, le=1.0)
    """Share of full speed of all motion."""
