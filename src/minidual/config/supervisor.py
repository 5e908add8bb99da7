"""Configuration of the supervisor: the bounds of the reflexes between the controllers and the motors."""

from __future__ import annotations

from pydantic import Field, model_validator

from minidual.config.base import StrictModel

Box = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]


class SupervisorConfig(StrictModel):
    """Bounds beyond which the arms are stopped. Scales may tighten the robot's own limits, never loosen them."""

    position_margin_rad: float = Field(default=0.0, ge=0.0, le=0.3)
    """Distance from a joint limit at which the arms stop. A joint may touch its bound within 1 mrad."""
    velocity_scale: float = Field(default=1.0, gt=0.0, le=1.0)
    torque_scale: float = Field(default=1.0, gt=0.0, le=1.0)
    torque_rate_scale: float = Field(default=1.0, gt=0.0, le=1.0)
    """Share of 1000 Nm/s to which the torque's rate is limited."""
    torque_rate_excess: float = Field(default=3.0, ge=1.0, le=5.0)
    """A torque that is asked for jumps if it changes by more than so many times that rate in one tick. Targets
    streamed at 50 Hz jump once in 20 ticks and change by up to 1.3 times the rate between, chatter in every tick."""
    torque_rate_patience_s: float = Field(default=0.05, gt=0.0, le=1.0)
    """A controller whose torque jumps for so long is stopped: ticks with a jump count up, others down."""
    saturation_s: float = Field(default=0.02, gt=0.0, le=1.0)
    """A motor may stand at its torque limit for this long."""
    acceleration_scale: float = Field(default=1.0, gt=0.0, le=1.0)
    jerk_reflex: bool = False
    """Stop at a jerk of the commanded reference over its limit, as the real arm does. Off by default: the reference
    filter bounds acceleration, not jerk, and the torque's rate is limited in any case."""
    tcp_speed_max_m_per_s: float = Field(default=1.7, gt=0.0, le=1.7)
    workspace_m: Box = ((-0.9, 1.1), (-1.2, 1.2), (-0.005, 1.6))
    """Ranges of x, y and z in the world that no tool centre point may leave."""
    self_collision_min_m: float = Field(default=0.01, gt=0.0, le=0.2)
    stale_s: float = Field(default=0.1, gt=0.0, le=2.0)
    """The arms stop when the arbiter has not reported to the supervisor for this long."""
    slow_period_s: float = Field(default=0.01, ge=0.001, le=0.02)
    """Period of the checks that need kinematics; see docs/supervisor.md for why it is short enough."""
    stop_deceleration_scale: float = Field(default=0.4, gt=0.0, le=0.8)
    """Share of the acceleration limits with which a soft stop brakes."""
    stop_frequency_rad_s: float = Field(default=10.0, gt=0.0, le=30.0)
    """Closed-loop frequency of the damped hold that follows."""

    @model_validator(mode="after")
    def _ranges_in_order(self) -> SupervisorConfig:
        for axis, (low, high) in zip("xyz", self.workspace_m, strict=True):
            if not low < high:
                raise ValueError(f"workspace_m of {axis} runs from {low} to {high}; it must run upwards")
        return self
