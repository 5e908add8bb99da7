"""Configuration of `spatial_act`, found by file and class name."""

from dataclasses import dataclass, fields
from typing import Any

from lerobot.configs import PreTrainedConfig
from lerobot.policies.act.configuration_act import ACTConfig


@PreTrainedConfig.register_subclass("spatial_act")
@dataclass
class SpatialActConfig(ACTConfig):
    """Settings of ACT's transformer and of the keypoint encoder that replaces its resnet.

    A head predicts the actions at the first `keyframes` gripper switches. `bf16`: convolve in bfloat16.
    """

    pretrained_backbone_weights: str | None = None
    keypoints: int = 64
    keyframes: int = 2
    bf16: bool = False

    def transformer(self, **changes: Any) -> ACTConfig:
        """Return the transformer's ACT configuration."""
        return ACTConfig(
            **{f.name: getattr(self, f.name) for f in fields(ACTConfig) if f.init} | changes,
        )
