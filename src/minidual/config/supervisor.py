"""Configuration of the supervisor's reflexes."""

from __future__ import annotations

from pydantic import Field, model_validator

from minidual.config.base import Coordinate, StrictModel

Span = tuple[Coordinate, Coordinate]
Box = tuple[Span, Span, Span]


class SupervisorConfig(StrictModel):
    """Bounds beyond which the arms stop. Scales can only tighten the robot's limits."""

    position_margin_rad: float = Field(default=0.0, ge=0.0, le=0.3)
    """Distance of the position bounds from the joint limits; tolerance 1 mrad."""
    velocity_scale: float = Field(default=1.0, ge=0.01, le=1.0)
    torque_scale: float = Field(default=1.0, ge=0.01, le=1.0)
    torque_rate_scale: float = Field(default=1.0, ge=0.01, le=1.0)
    """Share of the arm's torque rate limit."""
    # targets streamed at 50 Hz jump once in 20 ticks and reach 1.3 between; chatter jumps every tick
    torque_rate_excess: float = Field(default=3.0, ge=1.0, le=5.0)
    """Multiple of the torque rate bound beyond which a requested torque jumps."""
    torque_rate_patience_s: float = Field(default=0.05, ge=0.001, le=1.0)
    """Reflex when ticks with jumps outnumber others by this time."""
    saturation_s: float = Field(default=0.02, ge=0.001, le=1.0)
    acceleration_scale: float = Field(default=1.0, ge=0.01, le=1.0)
    jerk_reflex: bool = False
    """Reflex on the jerk of the commanded reference, as in the real arm; the reference filter does not bound it."""
    tcp_speed_max_m_per_s: float = Field(default=1.7, ge=0.01, le=1.7)
    contact_scale: float = Field(default=1.0, ge=0.1, le=1.0)
    """Share of each mode's bounds (control/contact.py)."""
    deviation_scale: float = Field(default=1.0, ge=0.1, le=1.0)
    """Same, distance from the reference."""
    deviation_s: float = Field(default=0.05, ge=0.001, le=0.05)
    """Longest time beyond that bound."""
    workspace_m: Box = ((-0.9, 1.1), (-1.2, 1.2), (0.005, 1.6))
    """Of the tool centre points, above the table (z = 0)."""
    self_collision_min_m: float = Field(default=0.01, ge=1e-4, le=0.2)
    stale_s: float = Field(default=0.1, ge=0.001, le=2.0)
    """Longest silence of the arbiter."""
    measurement_age_max_s: float = Field(default=0.02, gt=0.0, le=0.2)
    """Longest time without new joint measurements; default as in libfranka (20 lost packets)."""
    position_mismatch_rad: float = Field(default=0.005, gt=0.0, le=0.05)
    """Difference between the change of a position and the integral of its velocity, over 0.1 s."""
    frozen_s: float = Field(default=0.02, gt=0.0, le=0.2)
    """Readings unchanged to the bit for this long, while the applied torque changes, are frozen."""
    slow_period_s: float = Field(default=0.01, ge=0.001, le=0.02)
    """Period of checks that need kinematics; see docs/supervisor.md."""
    stop_deceleration_scale: float = Field(default=0.9, ge=0.01, le=1.0)
    """Largest share of the joints' acceleration limits in a stop."""
    stop_frequency_rad_s: float = Field(default=10.0, ge=0.1, le=30.0)
    """Closed-loop frequency of the damped hold after a stop."""

    @model_validator(mode="after")
    def _ranges_in_order(self) -> SupervisorConfig:
        for axis, (low, high) in zip("xyz", self.workspace_m, strict=True):
            if not low < high:
                raise ValueError(f"workspace_m of {axis} runs from {low} to {high}; it must run upwards")
        return self
