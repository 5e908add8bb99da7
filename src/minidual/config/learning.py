"""Configuration of `teleop-record`, `train-act` and `deploy`."""

from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from minidual.config.base import AtLeast, AtMost, Rate, StrictModel
from minidual.config.leading import (
    GamepadConfig,
    GelloConfig,
    LinkConfig,
    MirrorConfig,
    MultiplyConfig,
    NetworkConfig,
    PersonConfig,
    ReplayConfig,
)

_Log = Annotated[float, Field(ge=-5.0, le=5.0)]


class OperatorConfig(StrictModel):
    """Accuracy and variety of the scripted operator."""

    overlap_s: float = Field(default=0.3, ge=0.0, le=0.6)
    """Overlap of the correction with the approach, and of the descent with the correction."""
    approach_noise_m: float = Field(default=0.010, ge=0.0, le=0.05)
    """Standard deviation of the position error across the object, before the correction."""
    along_noise_m: float = Field(default=0.025, ge=0.0, le=0.05)
    """The same along the object, corrected as the hands go down."""
    approach_noise_rad: float = Field(default=0.04, ge=0.0, le=0.2)
    speed_spread: float = Field(default=0.0, ge=0.0, le=0.5)
    """Largest relative change of a phase's duration, drawn for each trial, as the next two."""
    pause_s: float = Field(default=0.0, ge=0.0, le=5.0)
    """Longest pause before the lift and before the lowering."""
    grasp_spread_m: float = Field(default=0.0, ge=0.0, le=0.05)
    """Largest shift of each hand's grasp along the object."""
    set_down_m: float = Field(default=0.0015, ge=0.0, le=0.005)
    """How far below its rest height the object is led before the hands open.

    A policy that copies the lowering ends a millimetre higher or lower; it must not let go in the
    air.
    """


class TeleopConfig(StrictModel):
    """Leader, recording and limits."""

    episodes_n: AtLeast[int] = Field(default=120, ge=1, le=10000)
    leader: str = Field(default="scripted", min_length=1)
    rate_hz: float = Field(default=50.0, ge=40.0, le=100.0)
    cameras: tuple[Literal["high", "left", "right"], ...] = ("high",)
    signals: tuple[
        Literal[
            "joint_torques",
            "external_torques",
            "hand_wrench",
            "internal_force",
            "arbiter_state",
            "reflex",
            "driver",
            "late_s",
            "lost_pictures",
        ],
        ...,
    ] = ()
    """What episodes hold beside joints and pictures; docs/data.md."""
    correct: str = ""
    """Checkpoint of a policy that drives until the leader takes over; empty: the leader drives."""
    conditions: tuple[str, ...] = Field(default=("clean",), min_length=1)
    """Conditions that the episodes take in turn; only those that change what is there."""
    room_change_s: float = Field(default=0.0, ge=0.0, le=60.0)
    """Time after which an episode goes on under the next condition, drawn anew; 0: never."""
    widen: float = Field(default=1.3, ge=1.0, le=2.0)
    """Start range as a multiple of the tests'."""
    attempts_max_ratio: float = Field(default=1.5, ge=1.0, le=10.0)
    """Most attempts per requested episode."""
    jerk_max_rad_s3: AtMost[float] = Field(default=200.0, gt=0.0, le=1e6)
    """Episodes with a larger RMS jerk are rejected."""
    following: Literal["auto", "smooth", "swift"] = "auto"
    """How the arms follow: swift feeds the leader's velocity forward. auto: swift for persons and
    devices, smooth for scripts. Policies drive as their demonstrations were led."""
    latency_max_s: AtMost[float] = Field(default=0.1, gt=0.0, le=60.0)
    lag_max_s: AtMost[float] = Field(default=0.1, gt=0.0, le=60.0)
    """Of the joints behind the leader, median of all moving samples."""
    episodes_per_min: AtLeast[float | None] = Field(default=3.0, ge=0.0, le=1e4)
    """None reports the rate: a few episodes say more of the start of processes than of recording."""
    operator: OperatorConfig = OperatorConfig()
    mirror: MirrorConfig = MirrorConfig()
    person: PersonConfig = PersonConfig()
    link: LinkConfig = LinkConfig()
    network: NetworkConfig = NetworkConfig()
    gamepad: GamepadConfig = GamepadConfig()
    gello: GelloConfig = GelloConfig()
    replay: ReplayConfig = ReplayConfig()
    augment: MultiplyConfig = MultiplyConfig()

    @field_validator("signals")
    @classmethod
    def _distinct(cls, signals: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(signals)) != len(signals):
            raise ValueError(f"signals repeat: {', '.join(signals)}")
        return signals

    @field_validator("cameras")
    @classmethod
    def _some_and_distinct(cls, cameras: tuple[str, ...]) -> tuple[str, ...]:
        if not cameras:
            raise ValueError("at least one camera must be recorded; there are high, left, right")
        if len(set(cameras)) != len(cameras):
            raise ValueError(f"cameras repeat: {', '.join(cameras)}")
        return cameras


class AugmentConfig(StrictModel):
    """Random changes of training pictures.

    Values are half-widths of uniform distributions unless named otherwise.
    """

    photometric: bool = True
    geometric: bool = True
    light_log: tuple[_Log, _Log] = (-0.6, 0.5)
    """Ends of the range of the logarithm of the light."""
    channel_gain_log: float = Field(default=0.25, ge=0.0, le=2.0)
    channel_mixing: float = Field(default=0.3, ge=0.0, le=1.0)
    offset: float = Field(default=0.08, ge=0.0, le=1.0)
    """Of full scale."""
    permuted_share: float = Field(default=0.25, ge=0.0, le=1.0)
    """Pictures with permuted colour channels."""
    turn_deg: float = Field(default=4.0, ge=0.0, le=180.0)
    scale: float = Field(default=0.06, ge=0.0, lt=1.0)
    shift: float = Field(default=0.08, ge=0.0, lt=1.0)
    """Of width and height."""
    straight_share: float = Field(default=0.1, ge=0.0, le=1.0)
    """Pictures that keep their place."""


class TrainConfig(StrictModel):
    """Policy and training; defaults for the CPU."""

    # Architecture
    policy: str = Field(default="spatial_act", min_length=1)
    """Row of POLICIES: spatial_act (keyframes, then ACT), spatial_diffusion, or LeRobot's own act and
    diffusion."""
    chunk_size: int = Field(default=50, ge=1, le=500)
    """Ticks predicted by one inference."""
    dim_model: int = Field(default=128, ge=16, le=1024, multiple_of=16)
    dim_feedforward: int = Field(default=512, ge=16, le=8192)
    encoder_layers: int = Field(default=2, ge=1, le=12)
    decoder_layers: int = Field(default=1, ge=1, le=12)
    heads: int = Field(default=8, ge=1, le=16)
    dropout: float = Field(default=0.0, ge=0.0, lt=1.0)
    use_vae: bool = False
    kl_weight: float = Field(default=10.0, ge=0.0, le=1e4)
    keypoints: int = Field(default=64, ge=4, le=256)
    """Spatial-softmax keypoints of each camera."""
    octaves: int = Field(default=0, ge=0, le=8)
    """Wave lengths in which the keyframe head reads the places of keypoints; 0: places alone. 3 helps
    if an object may stand at either end of the picture; the rod is carried less often with it."""
    head_width: int = Field(default=64, ge=8, le=1024)
    """Hidden units of the keyframe head."""
    denoising_steps: int = Field(default=5, ge=1, le=100)
    """Of diffusion: passes of its network for one chunk."""

    # Optimisation
    seeds_n: AtLeast[int] = Field(default=1, ge=1, le=10)
    """Trainings, each with its own seed; deploy runs every policy, benchmark the first."""
    steps: int = Field(default=7000, ge=1, le=10_000_000)
    budget_s: float | None = Field(default=None, gt=0.0, le=1e7)
    """Time of each training, instead of `steps`: the first steps are timed to count those that fit."""
    time_limit_s: float = Field(default=86_400.0, gt=0.0, le=1e7)
    """Guard: a training that takes longer is stopped and fails the check `steps_done`."""
    batch_size: int = Field(default=32, ge=1, le=4096)
    learning_rate: float = Field(default=1e-3, ge=1e-8, le=1.0)
    backbone_learning_rate: float = Field(default=2.5e-3, ge=1e-8, le=1.0)
    """Of what reads pictures; it follows the course of `learning_rate`."""
    weight_decay: float = Field(default=1e-4, ge=0.0, le=1.0)
    warmup_fraction: float = Field(default=0.03, ge=0.0, le=0.5)
    gradient_clip: float = Field(default=1.0, ge=1e-3, le=1e6)
    ema_decay: float = Field(default=0.999, ge=0.0, lt=1.0)
    """Moving average of the weights; 0 switches it off."""
    device: Literal["cpu", "cuda"] = "cpu"
    threads: int = Field(default=2, ge=1, le=256)
    """Torch threads on the CPU."""

    # Data
    cameras: tuple[str, ...] = ("high",)
    """Empty means all."""
    inputs: tuple[str, ...] = ()
    """Recorded signals that the policy reads beside joints and pictures; docs/train-act.md."""
    validation_fraction: float = Field(default=0.08, ge=0.0, le=0.5)
    approach_weight: float = Field(default=3.0, gt=0.0, le=100.0)
    """Sampling weight of ticks before the grasp."""
    corrections: tuple[str, ...] = ()
    """Folders of LeRobot datasets recorded with teleop-record --correct, which are added."""
    correction_weight: float = Field(default=4.0, ge=0.0, le=100.0)
    """Sampling weight of ticks in which somebody corrected the policy."""
    own_weight: float = Field(default=0.0, ge=0.0, le=100.0)
    """Sampling weight of ticks in which the policy drove itself."""
    state_noise_approach_rad: float = Field(default=0.06, ge=0.0, le=0.5)
    state_noise_rad: float = Field(default=0.01, ge=0.0, le=0.5)
    """After the grasp."""
    augment: AugmentConfig = AugmentConfig()
    std_floor: float = Field(default=1e-2, ge=1e-6, le=10.0)
    """Least standard deviation for normalisation; some joints hardly move."""

    # Bookkeeping
    log_every_steps: int = Field(default=20, ge=1, le=10_000_000)
    validate_every_steps: int = Field(default=500, ge=1, le=10_000_000)
    checkpoint_every_steps: int = Field(default=1000, ge=1, le=10_000_000)

    # Acceptance
    loss_ratio_max: AtMost[float] = Field(default=0.5, gt=0.0, le=1.0)
    actions_in_limits_min: AtLeast[float] = Field(default=0.999, gt=0.0, le=1.0)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.dim_model % self.heads:
            raise ValueError(f"dim_model {self.dim_model} is not a multiple of heads {self.heads}")
        if len(set(self.inputs)) != len(self.inputs):
            raise ValueError(f"inputs repeat: {', '.join(self.inputs)}")
        return self


class DeployConfig(StrictModel):
    """Policy runtime and closed-loop trials."""

    n_action_steps: int = Field(default=25, ge=1, le=500)
    """Ticks of a chunk run before the next inference."""
    blend_ticks: int = Field(default=8, ge=0, le=50)
    """Ticks over which a new chunk replaces the old one."""
    answer_s: float | None = Field(default=None, ge=0.0, le=60.0)
    """Simulated time from a look to its chunk.

    None: what a policy server took, and nothing for a policy of this process.
    """
    policy: str = ""
    """Folder of a checkpoint, or address of a policy server, instead of the trained policy."""
    policy_digest: str = ""
    """Filled in: what `policy` is."""
    threads: int = Field(default=1, ge=1, le=64)
    """Torch threads."""
    device: Literal["cpu", "cuda"] = "cpu"
    trials: AtLeast[int] = Field(default=50, ge=1, le=10_000)
    """Trials from starts held out from training."""
    first_start: int = Field(default=0, ge=0, le=10_000_000)
    """Number of the first held-out start."""
    training_trials: AtLeast[int] = Field(default=20, ge=0, le=10_000)
    conditions: tuple[str, ...] = ("room",)
    """Conditions under which the held-out trials run again."""
    hidden_trials: AtLeast[int] = Field(default=5, ge=0, le=10_000)
    """Held-out trials with the object hidden, in which a policy that looks must fail."""
    hidden_rate_max: AtMost[float | None] = Field(default=0.2, ge=0.0, le=1.0)
    condition_rate_min: AtLeast[dict[str, Rate]] = Field(default={})
    """Least success rate by condition; the others are reported."""
    success_rate_min: AtLeast[float | None] = Field(default=0.5, ge=0.0, le=1.0)
    """None: reported only."""
    inference_hz_min: AtLeast[float] = Field(default=30.0, gt=0.0, le=1e5)

    @model_validator(mode="after")
    def _limits_are_measured(self) -> Self:
        for name in self.condition_rate_min:
            if name not in self.conditions:
                names = ", ".join(self.conditions)
                raise ValueError(
                    f"condition_rate_min limits {name}, not one of conditions ({names}): "
                    "name it there too, or set condition_rate_min to {}",
                )
        return self
