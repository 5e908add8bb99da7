"""Configuration of `env-check`, `carry`, the arbiter and the supervisor."""

from typing import Literal, Self

from pydantic import Field, model_validator

from minidual.config.base import AtLeast, AtMost, Coordinate, StrictModel

SPEED_OVERRIDE_MIN = 0.1
Span = tuple[Coordinate, Coordinate]


class EnvCheckConfig(StrictModel):
    """Test motions and limits of `env-check`."""

    step_rad: AtLeast[float] = Field(default=0.3, ge=0.01, le=0.5)
    """Outward step of joint 1 of each arm."""
    step_duration_s: AtMost[float] = Field(default=2.0, ge=1.0, le=10.0)
    step_error_max_rad: AtMost[float] = Field(default=0.005, gt=0.0, le=0.05)
    single_step_rad: AtLeast[float] = Field(default=0.1, ge=0.01, le=0.3)
    single_duration_s: AtMost[float] = Field(default=0.6, ge=0.3, le=5.0)
    sine_amplitude_rad: AtLeast[float] = Field(default=0.3, ge=0.01, le=0.5)
    sine_frequency_hz: AtLeast[float] = Field(default=0.5, ge=0.05, le=1.0)
    sine_duration_s: AtLeast[float] = Field(default=10.0, ge=1.0, le=60.0)
    sine_rms_max_rad: AtMost[float] = Field(default=0.02, gt=0.0, le=0.05)
    rise_max_s: AtMost[float] = Field(default=0.25, gt=0.0, le=1.0)
    """From 10 % to 90 %."""
    overshoot_max_rad: AtMost[float] = Field(default=0.005, gt=0.0, le=0.02)
    stop_rest_max_s: AtMost[float] = Field(default=0.5, gt=0.0, le=2.0)
    agreement_states_n: AtLeast[int] = Field(default=20, ge=1, le=1000)
    agreement_max: AtMost[float] = Field(default=1e-10, gt=0.0, le=1e-6)


class ImpedanceConfig(StrictModel):
    """Gains of the object impedance; see docs/carry.md."""

    stiffness_n_per_m: float = Field(default=500.0, ge=50.0, le=3000.0)
    stiffness_nm_per_rad: float = Field(default=80.0, ge=1.0, le=200.0)
    damping_ratio: float = Field(default=1.0, ge=0.1, le=3.0)
    internal_force_n: float = Field(default=40.0, ge=5.0, le=80.0)
    """Squeeze along the object."""
    force_gain: float = Field(default=0.5, ge=0.0, lt=1.0)
    """Proportional force feedback; the loop oscillates from 1 on."""
    force_correction_max_n: float = Field(default=15.0, ge=0.0, le=20.0)
    squeeze_axes: Literal["object", "world"] = "object"
    """Axes in which the squeeze keeps its direction."""
    pinch_n: float = Field(default=60.0, gt=20.0, le=140.0)
    """Finger force; friction mu requires internal_force < 2 mu pinch."""


class CarryLimits(StrictModel):
    """Limits over all trials of the stage."""

    success_rate_min: AtLeast[float] = Field(default=0.99, gt=0.8, le=1.0)
    tilt_max_rad: AtMost[float] = Field(default=0.0349, gt=0.0, le=0.08727)
    """2 degrees."""
    duration_max_s: AtMost[float] = Field(default=8.0, gt=0.0, le=10.0)
    saturation_max_s: AtMost[float] = Field(default=0.02, gt=0.0, le=0.02)
    """Time at a torque limit, failed trials included."""


class SensingConfig(StrictModel):
    """Noise, delay and rate of sensing; zero disables each.

    Noise is white and Gaussian for each sample and axis, a bias is drawn for each trial. Encoders
    are exact. See docs/carry.md.
    """

    pose_noise_m: AtLeast[float] = Field(default=0.0005, ge=0.0, le=0.02)
    pose_noise_rad: AtLeast[float] = Field(default=0.005236, ge=0.0, le=0.2)
    """Standard deviation of each rotation vector component (0.3 degrees)."""
    pose_bias_m: AtLeast[float] = Field(default=0.0, ge=0.0, le=0.02)
    """Standard deviation of each coordinate of a trial's constant offset."""
    pose_bias_rad: AtLeast[float] = Field(default=0.0, ge=0.0, le=0.2)
    pose_rate_hz: float = Field(default=100.0, ge=1.0, le=1000.0)
    """Rounded to control steps."""
    force_noise_n: AtLeast[float] = Field(default=1.0, ge=0.0, le=50.0)
    """Standard deviation of each contact force component and pinch, at every control step."""
    delay_s: AtLeast[float] = Field(default=0.010, ge=0.0, le=0.5)
    force_filter_s: float = Field(default=0.010, ge=0.0, le=0.5)
    grasp_memory_s: float = Field(default=0.15, ge=0.0, le=5.0)
    """Averaging time of the object's pose between the hands; 0 uses the last sample."""


class PaceConfig(StrictModel):
    """Limits that set durations; see skills/carry_motions.py."""

    joint_speed_share: float = Field(default=0.85, ge=0.05, le=1.0)
    joint_acceleration_share: float = Field(default=0.5, ge=0.05, le=1.0)
    object_speed_m_per_s: float = Field(default=0.6, ge=0.02, le=2.0)
    object_acceleration_m_per_s2: float = Field(default=1.2, ge=0.02, le=10.0)
    object_turn_rad_per_s: float = Field(default=2.0, ge=0.05, le=10.0)
    object_turn_rad_per_s2: float = Field(default=5.0, ge=0.05, le=50.0)
    landing_m: float = Field(default=0.0, ge=0.0, le=0.05)
    """Slow last part of the lowering, over `landing_s`; 0: none."""
    landing_s: float = Field(default=0.3, ge=0.05, le=5.0)


class CarryFaultConfig(StrictModel):
    """Bounds on sensed quantities beyond which a carry has a fault; see skills/faults.py."""

    displaced_m: float = Field(default=0.004, gt=0.0, le=0.1)
    """Displacement of a resting object, or of hands along a held one.

    More for a resting object whose pose scatters more.
    """
    displaced_rad: float = Field(default=0.045, gt=0.0, le=1.0)
    creep_m: float = Field(default=0.001, gt=0.0, le=0.1)
    """Motion of the hands along the object that reduces the squeeze and makes the pinch firmer."""
    gap_margin_m: float = Field(default=0.004, gt=0.0, le=0.03)
    """A hand closed further than this below the object's width holds nothing."""
    grasp_timeout_s: float = Field(default=1.5, gt=0.1, le=10.0)
    gripper_answer_s: float = Field(default=0.08, ge=0.05, le=1.0)
    """Longest time without motion or change of pinch of a closing hand; twice as long to open."""
    lost_pinch_share: float = Field(default=0.25, gt=0.0, lt=1.0)
    squeeze_share: float = Field(default=0.4, gt=0.0, lt=1.0)
    """Share of the wanted internal force below which the grasp slips."""
    tilt_rad: float = Field(default=0.35, gt=0.0, le=1.5)
    motor_torque_n_m: float = Field(default=2.0, gt=0.0, le=50.0)
    """Difference between commanded and measured torque of a dead drive."""
    persistence_s: float = Field(default=0.005, ge=0.0, le=0.05)
    sensor_age_max_s: float = Field(default=0.03, gt=0.0, le=0.5)
    """Age of an object reading, beyond delay and sampling period, at which its sensor is silent."""
    force_glitch_n: float = Field(default=100.0, gt=0.0, le=1000.0)
    """A force this far from the filtered one is ignored for up to `persistence_s`."""


class CarryConfig(StrictModel):
    """Configuration of `carry`."""

    trials_n: AtLeast[int] = Field(default=20, ge=1, le=10000)
    object: str = "rod"
    """Row of OBJECTS in tasks/objects.py."""
    motion: str = "straight"
    """Row of MOTIONS in tasks/objects.py."""
    impedance: ImpedanceConfig = ImpedanceConfig()
    sensing: SensingConfig = SensingConfig()
    pace: PaceConfig = PaceConfig()
    faults: CarryFaultConfig = CarryFaultConfig()
    limits: CarryLimits = CarryLimits()


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
    switch_step_max_rad: float = Field(default=0.1, ge=0.001, le=0.2)
    """A larger step of a joint target is ramped at `align_speed_rad_s`.

    No trajectory may start farther away.
    """
    align_speed_rad_s: float = Field(default=1.0, ge=0.01, le=2.0)
    speed_override: float = Field(default=1.0, ge=SPEED_OVERRIDE_MIN, le=1.0)
    """Share of full speed of all motion."""
    finger_speed_m_per_s: float = Field(default=0.08, ge=0.005, le=0.1)
    """Of hands that open or close."""


class SupervisorConfig(StrictModel):
    """Bounds beyond which the arms stop. Scales can only tighten the robot's limits."""

    position_margin_rad: float = Field(default=0.0, ge=0.0, le=0.3)
    """Distance of the position bounds from the joint limits; tolerance 1 mrad."""
    velocity_scale: float = Field(default=1.0, ge=0.01, le=1.0)
    torque_scale: float = Field(default=1.0, ge=0.01, le=1.0)
    torque_rate_scale: float = Field(default=1.0, ge=0.01, le=1.0)
    """Share of the arm's torque rate limit."""
    # Targets streamed at 50 Hz jump once in 20 ticks and reach 1.3 between; chatter jumps each tick.
    torque_rate_excess: float = Field(default=3.0, ge=1.0, le=5.0)
    """Multiple of the torque rate bound beyond which a requested torque jumps."""
    torque_rate_patience_s: float = Field(default=0.05, ge=0.001, le=1.0)
    """Reflex when ticks with jumps outnumber others by this time."""
    saturation_s: float = Field(default=0.02, ge=0.001, le=1.0)
    acceleration_scale: float = Field(default=1.0, ge=0.01, le=1.0)
    jerk_reflex: bool = False
    """Reflex on the jerk of the commanded reference, as in the real arm.

    The reference filter does not bound the jerk.
    """
    tcp_speed_max_m_per_s: float = Field(default=1.7, ge=0.01, le=1.7)
    contact_scale: float = Field(default=1.0, ge=0.1, le=1.0)
    """Share of each mode's bounds (control/observer.py)."""
    deviation_scale: float = Field(default=1.0, ge=0.1, le=1.0)
    """Same, distance from the reference."""
    deviation_s: float = Field(default=0.05, ge=0.001, le=0.05)
    """Longest time beyond that bound."""
    workspace_m: tuple[Span, Span, Span] = ((-0.9, 1.1), (-1.2, 1.2), (0.005, 1.6))
    """Of the tool centre points, above the table (z = 0)."""
    self_collision_min_m: float = Field(default=0.01, ge=1e-4, le=0.2)
    stale_s: float = Field(default=0.1, ge=0.001, le=2.0)
    """Longest silence of the arbiter."""
    measurement_age_max_s: float = Field(default=0.02, gt=0.0, le=0.03)
    """Longest time without new joint measurements; default as in libfranka (20 lost packets)."""
    torque_delay_s: float = Field(default=0.0, ge=0.0, le=0.04)
    """How late a plant's torques act; the contact observer compares motion with torques so old."""
    position_mismatch_rad: float = Field(default=0.005, gt=0.0, le=0.05)
    """Difference between the change of a position and the integral of its velocity, over 0.1 s."""
    frozen_s: float = Field(default=0.02, gt=0.0, le=0.2)
    """Readings unchanged to the bit for this long, while the applied torque changes, are frozen."""
    slow_period_s: float = Field(default=0.01, ge=0.001, le=0.02)
    """Period of checks that need kinematics; see docs/supervisor.md."""
    stop_deceleration_scale: float = Field(default=0.9, ge=0.5, le=1.0)
    """Largest share of the joints' acceleration limits in a stop."""
    stop_frequency_rad_s: float = Field(default=10.0, ge=5.0, le=20.0)
    """Closed-loop frequency of the damped hold after a stop."""

    @model_validator(mode="after")
    def _ranges_in_order(self) -> Self:
        for axis, (low, high) in zip("xyz", self.workspace_m, strict=True):
            if not low < high:
                raise ValueError(
                    f"workspace_m of {axis} runs from {low} to {high}; it must run upwards",
                )
        return self
