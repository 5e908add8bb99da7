"""Configuration of `spatial_act`, found by file and class name."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.optim import AdamWConfig
from lerobot.policies.act.configuration_act import ACTConfig


@PreTrainedConfig.register_subclass("spatial_act")
@dataclass
class SpatialActConfig(PreTrainedConfig):
    """Settings of ACT's transformer (see `ACTConfig`) and the keypoint encoder.

    `keyframe_weight` > 0 adds a head predicting actions at the first `keyframes` gripper switches.
    """

    n_obs_steps: int = 1
    chunk_size: int = 100
    n_action_steps: int = 100
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: dict.fromkeys(("VISUAL", "STATE", "ACTION"), NormalizationMode.MEAN_STD)
    )
    dim_model: int = 512
    n_heads: int = 8
    dim_feedforward: int = 3200
    n_encoder_layers: int = 4
    n_decoder_layers: int = 1
    use_vae: bool = True
    dropout: float = 0.1
    kl_weight: float = 10.0
    optimizer_lr: float = 1e-5
    optimizer_weight_decay: float = 1e-4
    optimizer_lr_backbone: float = 1e-5
    keypoints: int = 32
    keyframe_weight: float = 1.0
    keyframes: int = 2

    def __post_init__(self) -> None:
        """Raise ValueError for unsupported settings."""
        super().__post_init__()
        if not 1 <= self.n_action_steps <= self.chunk_size:
            raise ValueError(f"n_action_steps {self.n_action_steps} is outside 1..chunk_size {self.chunk_size}")
        if self.n_obs_steps != 1:
            raise ValueError(f"n_obs_steps is {self.n_obs_steps}; spatial_act reads one observation")

    def transformer(self, **changes: Any) -> ACTConfig:
        """Return the transformer's ACT configuration."""
        shared = {f.name for f in fields(self) if f.init} & {f.name for f in fields(ACTConfig) if f.init}
        settings = {name: getattr(self, name) for name in shared} | changes
        return ACTConfig(**settings, pretrained_backbone_weights=None)

    def validate_features(self) -> None:
        """Raise ValueError without camera or action."""
        if not self.image_features or self.action_feature is None:
            raise ValueError("spatial_act needs at least one camera among its inputs, and an output 'action'")

    def get_optimizer_preset(self) -> AdamWConfig:
        """Return lerobot-train's optimiser."""
        return AdamWConfig(lr=self.optimizer_lr, weight_decay=self.optimizer_weight_decay)

    def get_scheduler_preset(self) -> None:
        """No scheduler."""

    @property
    def observation_delta_indices(self) -> None:
        """Current observation only."""

    @property
    def action_delta_indices(self) -> list[int]:
        """One chunk."""
        return list(range(self.chunk_size))

    @property
    def reward_delta_indices(self) -> None:
        """No rewards."""
