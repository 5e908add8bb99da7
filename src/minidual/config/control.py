"""Configuration of the `env-check` and `carry` stages."""

from __future__ import annotations

from pydantic import Field

from minidual.config.base import StrictModel


class EnvCheckConfig(StrictModel):
    """What is driven to see that the arms answer, and how well they must."""

    step_rad: float = Field(default=0.3, gt=0.0, le=0.5)
    """Step of joint 1 of each arm, outwards."""
    step_duration_s: float = Field(default=2.0, ge=1.0, le=10.0)
    step_error_max_rad: float = Field(default=0.005, gt=0.0, le=0.05)
    """Limit on the 14-D error norm that is left after the step."""
    single_step_rad: float = Field(default=0.1, gt=0.0, le=0.3)
    """Step of one joint alone."""
    single_duration_s: float = Field(default=0.6, ge=0.3, le=5.0)
    sine_amplitude_rad: float = Field(default=0.3, gt=0.0, le=0.5)
    sine_frequency_hz: float = Field(default=0.5, gt=0.0, le=1.0)
    sine_duration_s: float = Field(default=10.0, ge=1.0, le=60.0)
    sine_rms_max_rad: float = Field(default=0.02, gt=0.0, le=0.05)
    """Limit on the RMS over time of the 14-D error norm while all joints swing at once."""
    pulse_share: float = Field(default=0.1, gt=0.0, le=0.5)
    """Torque pulse that tells which joint a motor moves, as a share of the motor's limit."""
    agreement_states_n: int = Field(default=20, ge=1, le=1000)
    agreement_max: float = Field(default=1e-10, gt=0.0, le=1e-6)
    cost_steps_n: int = Field(default=2000, ge=100, le=100_000)
    video_fps: int = Field(default=25, ge=10, le=60)
    video_width_px: int = Field(default=800, ge=160, le=1920)
    video_height_px: int = Field(default=600, ge=120, le=1080)


class ImpedanceConfig(StrictModel):
    """Gains of the object impedance; see docs/carry.md for the law."""

    stiffness_n_per_m: float = Field(default=500.0, ge=50.0, le=3000.0)
    stiffness_nm_per_rad: float = Field(default=20.0, ge=1.0, le=200.0)
    damping_ratio: float = Field(default=1.0, ge=0.1, le=3.0)
    internal_force_n: float = Field(default=40.0, ge=5.0, le=80.0)
    """Squeeze along the object; 80 N is the ceiling."""
    force_gain: float = Field(default=0.5, ge=0.0, lt=1.0)
    """Proportional force feedback; at 1 and over the loop limit-cycles."""
    force_correction_max_n: float = Field(default=15.0, ge=0.0, le=20.0)
    pinch_n: float = Field(default=60.0, gt=20.0, le=70.0)
    """Finger force; the pads carry the squeeze by friction, so internal_force < 2 mu pinch."""


class CarryConfig(StrictModel):
    """How many carries are tried, how fast, and with which gains."""

    trials_n: int = Field(default=20, ge=1, le=10000)
    lift_s: float = Field(default=1.0, gt=0.2, le=5.0)
    transport_s: float = Field(default=2.2, gt=0.5, le=10.0)
    lower_s: float = Field(default=1.2, gt=0.2, le=5.0)
    impedance: ImpedanceConfig = ImpedanceConfig()
