"""Configuration of the live view; no stage depends on it."""

from pydantic import Field

from minidual.config.base import StrictModel


class ViewConfig(StrictModel):
    """The web view."""

    host: str = Field(default="127.0.0.1", min_length=1)
    """Network interface; the default serves this machine only."""
    port: int = Field(default=8080, ge=1, le=65535)
    remote_drives: bool = False
    """Whether pages on other machines may move sliders; those that come through ssh count as on this machine."""
    rate_hz: float = Field(default=30.0, ge=1.0, le=120.0)
    speed_max: float = Field(default=0.0, ge=0.0, le=100.0)
    """Most simulated seconds per wall second; 0: no limit."""
