"""Configuration of `teleop-record`."""

from typing import Literal, Self

from pydantic import Field, field_validator, model_validator

from minidual.config.base import AtLeast, AtMost, StrictModel


class OperatorConfig(StrictModel):
    """Phase durations and accuracy of the scripted operator."""

    approach_s: float = Field(default=1.8, ge=0.5, le=20.0)
    correct_s: float = Field(default=0.6, ge=0.1, le=20.0)
    descend_s: float = Field(default=0.9, ge=0.2, le=20.0)
    lift_s: float = Field(default=0.8, ge=0.2, le=20.0)
    carry_s: float = Field(default=2.0, ge=0.5, le=20.0)
    lower_s: float = Field(default=0.8, ge=0.2, le=20.0)
    retreat_s: float = Field(default=0.5, ge=0.2, le=20.0)
    rest_s: float = Field(default=0.1, ge=0.02, le=20.0)
    overlap_s: float = Field(default=0.3, ge=0.0, le=1.0)
    """Overlap of the correction with the approach, and of the descent with the correction."""
    approach_noise_m: float = Field(default=0.010, ge=0.0, le=0.05)
    """Standard deviation of the position error before the correction."""
    approach_noise_rad: float = Field(default=0.04, ge=0.0, le=0.2)
    speed_spread: float = Field(default=0.0, ge=0.0, le=0.5)
    """Largest relative change of a phase's duration, drawn for each trial, as the next two."""
    pause_s: float = Field(default=0.0, ge=0.0, le=5.0)
    """Longest pause before the lift and before the lowering."""
    grasp_spread_m: float = Field(default=0.0, ge=0.0, le=0.05)
    """Largest shift of each hand's grasp along the object."""

    @model_validator(mode="after")
    def _overlap_fits(self) -> Self:
        shortest = min(self.approach_s, self.correct_s, self.descend_s)
        if self.overlap_s > shortest:
            raise ValueError(f"overlap_s {self.overlap_s} is longer than a phase it joins ({shortest} s)")
        return self


class MirrorConfig(StrictModel):
    """When a leader may drive the follower."""

    start_error_max_rad: float = Field(default=0.1, ge=0.001, le=0.6)
    workspace_margin_rad: float = Field(default=0.0, ge=0.0, le=0.3)
    """Distance of mirrored targets from the joint limits."""


class TeleopConfig(StrictModel):
    """Leader, recording and limits."""

    episodes_n: AtLeast[int] = Field(default=120, ge=1, le=10000)
    leader: str = Field(default="scripted", min_length=1)
    rate_hz: float = Field(default=50.0, ge=10.0, le=100.0)
    cameras: tuple[Literal["high", "left", "right"], ...] = ("high",)
    conditions: tuple[str, ...] = Field(default=("clean",), min_length=1)
    """Conditions that the episodes take in turn; only those that change what is there."""
    room_change_s: float = Field(default=0.0, ge=0.0, le=60.0)
    """Time after which an episode goes on under the next of the conditions, drawn anew; 0: never."""
    widen: float = Field(default=1.3, ge=1.0, le=2.0)
    """Start range as a multiple of the tests'."""
    attempts_max_ratio: float = Field(default=1.5, ge=1.0, le=10.0)
    """Most attempts per requested episode."""
    jerk_max_rad_s3: AtMost[float] = Field(default=200.0, gt=0.0, le=1e6)
    """Episodes with a larger RMS jerk are rejected."""
    latency_max_s: AtMost[float] = Field(default=0.1, gt=0.0, le=60.0)
    episodes_per_min: AtLeast[float] = Field(default=3.0, ge=0.0, le=1e4)
    person_time_limit_s: float = Field(default=120.0, ge=5.0, le=3600.0)
    operator: OperatorConfig = OperatorConfig()
    mirror: MirrorConfig = MirrorConfig()

    @field_validator("cameras")
    @classmethod
    def _some_and_distinct(cls, cameras: tuple[str, ...]) -> tuple[str, ...]:
        if not cameras:
            raise ValueError("at least one camera must be recorded; there are high, left, right")
        if len(set(cameras)) != len(cameras):
            raise ValueError(f"cameras repeat: {', '.join(cameras)}")
        return cameras
