"""Configuration of the policy type `spatial_act` (LeRobot finds it by file and class name)."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.configs import PreTrainedConfig
from lerobot.policies.act.configuration_act import ACTConfig

SPATIAL_SOFTMAX = "spatial_softmax"


@PreTrainedConfig.register_subclass("spatial_act")
@dataclass
class SpatialActConfig(ACTConfig):
    """ACTConfig whose images go through a spatial-softmax keypoint encoder instead of a resnet.

    `keyframe_weight` > 0 adds a head that predicts the actions at the first `keyframes` gripper switches (grasp,
    release) from the keypoints; its prediction is also part of the transformer's image token.
    """

    vision_backbone: str = SPATIAL_SOFTMAX
    pretrained_backbone_weights: str | None = None
    keypoints: int = 32
    keyframe_weight: float = 1.0
    keyframes: int = 2

    def __post_init__(self) -> None:
        """Check what ACTConfig checks, except that the backbone here is no resnet.

        Raises:
            ValueError: a field does not fit this policy type.
        """
        PreTrainedConfig.__post_init__(self)
        if self.vision_backbone != SPATIAL_SOFTMAX:
            raise ValueError(f"vision_backbone of spatial_act is '{SPATIAL_SOFTMAX}', not '{self.vision_backbone}'")
        if self.pretrained_backbone_weights is not None:
            raise ValueError("spatial_act has no pretrained backbone weights; they must be null")
        if self.temporal_ensemble_coeff is not None:
            raise ValueError("spatial_act runs chunks from a queue; temporal_ensemble_coeff must be null")
        if not 1 <= self.n_action_steps <= self.chunk_size:
            raise ValueError(f"n_action_steps {self.n_action_steps} is outside 1..chunk_size {self.chunk_size}")
        if self.n_obs_steps != 1:
            raise ValueError(f"n_obs_steps is {self.n_obs_steps}; spatial_act reads one observation")
