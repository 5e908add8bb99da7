"""Configuration of the live view. It changes what a person sees and nothing else: no stage lists it as a parameter."""

from __future__ import annotations

from pydantic import Field

from minidual.config.base import StrictModel


class ViewConfig(StrictModel):
    """How a live view shows what runs."""

    host: str = Field(default="127.0.0.1", min_length=1)
    """Interface that the web view binds. The default is reached from this machine only (or through ssh)."""
    port: int = Field(default=8080, ge=1, le=65535)
    """First port to try; the next free one is taken and named."""
    rate_hz: float = Field(default=30.0, ge=1.0, le=120.0)
    """Pictures a second of wall time."""
    speed_max: float = Field(default=0.0, ge=0.0, le=100.0)
    """Hold a watched stage to this many simulated seconds a second; 0 lets it run as fast as it does unwatched."""
