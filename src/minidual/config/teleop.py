"""Configuration of the `teleop-record` stage."""

from __future__ import annotations

from pydantic import Field

from minidual.config.base import StrictModel


class TeleopConfig(StrictModel):
    """How many demonstrations are recorded."""

    episodes_n: int = Field(50, ge=1, le=10000)
