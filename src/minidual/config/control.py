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
    """Limit on the error norm of all joints that is left after the step."""
    single_step_rad: float = Field(default=0.1, gt=0.0, le=0.3)
    """Step of one joint alone."""
    single_duration_s: float = Field(default=0.6, ge=0.3, le=5.0)
    sine_amplitude_rad: float = Field(default=0.3, gt=0.0, le=0.5)
    sine_frequency_hz: float = Field(default=0.5, gt=0.0, le=1.0)
    sine_duration_s: float = Field(default=10.0, ge=1.0, le=60.0)
    sine_rms_max_rad: float = Field(default=0.02, gt=0.0, le=0.05)
    """Limit on the RMS over time of the error norm of all joints while all joints swing at once."""
    pulse_share: float = Field(default=0.1, gt=0.0, le=0.5)
    """Torque pulse that tells which joint a motor moves, as a share of the motor's limit."""
    rise_max_s: float = Field(default=0.25, gt=0.0, le=1.0)
    """Limit on the time in which each joint goes from 10 % to 90 % of its own step."""
    overshoot_max_rad: float = Field(default=0.005, gt=0.0, le=0.02)
    """Limit on how far each joint goes beyond its own step."""
    latency_max_us: float = Field(default=1000.0, gt=0.0, le=10_000.0)
    """Limit on the wall time from a proposed command to the motors' torques, the arbiter's period apart."""
    stop_rest_max_s: float = Field(default=0.5, gt=0.0, le=2.0)
    """Limit on the time that swinging arms need to come to rest after an emergency stop."""
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
    pinch_n: float = Field(default=60.0, gt=20.0, le=140.0)
    """Finger force; the pads carry the squeeze by friction, so internal_force < 2 mu pinch."""


class CarryLimits(StrictModel):
    """What the trials of the stage must reach together; the success test of one trial is the scene's."""

    success_rate_min: float = Field(default=0.99, gt=0.8, le=1.0)
    tilt_max_rad: float = Field(default=0.0349, gt=0.0, le=0.08727)
    """Two degrees; the success test of one trial allows five."""
    duration_max_s: float = Field(default=8.0, gt=0.0, le=10.0)
    saturation_max_s: float = Field(default=0.02, gt=0.0, le=0.02)
    """Longest time that a motor may stand at its torque limit, failed trials included."""


class SensingConfig(StrictModel):
    """What stands between the object and the controller: noise, delay and rate. Zero switches each one off.

    Noise is white and Gaussian, drawn anew for every sample and axis; a bias is drawn once a trial. Joints and fingers
    are read from their encoders, without noise. See docs/carry.md for the standard condition.
    """

    pose_noise_m: float = Field(default=0.0005, ge=0.0, le=0.02)
    """Standard deviation of each coordinate of the object's position."""
    pose_noise_rad: float = Field(default=0.005236, ge=0.0, le=0.2)
    """Standard deviation of each component of the object's rotation vector (0.3 degrees)."""
    pose_bias_m: float = Field(default=0.0, ge=0.0, le=0.02)
    """Standard deviation of each coordinate of an offset that stays the same for a whole trial."""
    pose_bias_rad: float = Field(default=0.0, ge=0.0, le=0.2)
    pose_rate_hz: float = Field(default=100.0, ge=0.0, le=1000.0)
    """Rate of the pose sensor, a camera; 0 samples at every control step."""
    force_noise_n: float = Field(default=1.0, ge=0.0, le=50.0)
    """Standard deviation of each component of a hand's contact force, and of its pinch, at every control step."""
    delay_s: float = Field(default=0.010, ge=0.0, le=0.5)
    """Age of pose and force when they reach the controller."""
    force_filter_s: float = Field(default=0.010, ge=0.0, le=0.5)
    """Time constant of the first-order filter on sensed forces."""
    grasp_memory_s: float = Field(default=0.15, ge=0.0, le=5.0)
    """Time over which the pose of the object in the hands is averaged; 0 believes the last sample alone."""

    @classmethod
    def perfect(cls) -> SensingConfig:
        """Return sensing without noise, delay or averaging: every step, the truth."""
        return cls(
            pose_noise_m=0.0,
            pose_noise_rad=0.0,
            pose_rate_hz=0.0,
            force_noise_n=0.0,
            delay_s=0.0,
            force_filter_s=0.0,
            grasp_memory_s=0.0,
        )


class PaceConfig(StrictModel):
    """Limits to which the durations of a carry are planned; see skills/pace.py."""

    joint_speed_share: float = Field(default=0.85, gt=0.0, le=1.0)
    """Largest joint speed, as a share of the joint's limit."""
    joint_acceleration_share: float = Field(default=0.5, gt=0.0, le=1.0)
    object_speed_m_per_s: float = Field(default=0.6, gt=0.0, le=2.0)
    object_acceleration_m_per_s2: float = Field(default=1.2, gt=0.0, le=10.0)
    object_turn_rad_per_s: float = Field(default=2.0, gt=0.0, le=10.0)
    object_turn_rad_per_s2: float = Field(default=5.0, gt=0.0, le=50.0)
    landing_m: float = Field(default=0.0, ge=0.0, le=0.05)
    """Last part of the lowering that is travelled slowly; 0 lands in one motion."""
    landing_s: float = Field(default=0.3, gt=0.0, le=5.0)
    """Duration of that part."""


class CarryFaultConfig(StrictModel):
    """When a carry gives itself up; each limit reads sensed quantities only. See skills/faults.py."""

    displaced_m: float = Field(default=0.004, gt=0.0, le=0.1)
    """Distance of a resting object from where it lay, or of a held one from where the hands should have it; more where
    the sensor scatters more while the object lies still."""
    displaced_rad: float = Field(default=0.045, gt=0.0, le=1.0)
    creep_m: float = Field(default=0.001, gt=0.0, le=0.1)
    """How far the hands may move along the object before the squeeze is eased."""
    gap_margin_m: float = Field(default=0.004, gt=0.0, le=0.03)
    """A hand that closes this far under the object's width holds nothing."""
    grasp_timeout_s: float = Field(default=1.5, gt=0.1, le=10.0)
    lost_pinch_share: float = Field(default=0.25, gt=0.0, lt=1.0)
    """A hand that pinches less than this share of what it should has lost the object."""
    squeeze_share: float = Field(default=0.4, gt=0.0, lt=1.0)
    """Internal force under this share of what is wanted means that the grip slips."""
    tilt_rad: float = Field(default=0.35, gt=0.0, le=1.5)
    motor_torque_n_m: float = Field(default=2.0, gt=0.0, le=50.0)
    """Difference between commanded and measured motor torque that tells a dead drive."""
    persistence_s: float = Field(default=0.005, ge=0.0, le=0.05)
    """How long a force or torque must be out of bounds."""
    deceleration_share: float = Field(default=0.5, gt=0.0, le=1.0)
    """Deceleration of the soft stop, as a share of the joints' acceleration limits."""


class CarryConfig(StrictModel):
    """What is carried and how, how many carries are tried, and what they must reach."""

    trials_n: int = Field(default=20, ge=1, le=10000)
    object: str = "rod"
    """A name from the catalogue in tasks/objects.py."""
    motion: str = "straight"
    """A name from the table in tasks/motions.py."""
    lift_s: float | None = Field(default=None, gt=0.2, le=5.0)
    """Duration of the lift; None plans it to the limits of `pace`."""
    transport_s: float | None = Field(default=None, gt=0.5, le=10.0)
    lower_s: float | None = Field(default=None, gt=0.2, le=5.0)
    impedance: ImpedanceConfig = ImpedanceConfig()
    sensing: SensingConfig = SensingConfig()
    pace: PaceConfig = PaceConfig()
    faults: CarryFaultConfig = CarryFaultConfig()
    limits: CarryLimits = CarryLimits()
