"""Configuration of `spatial_act`, found by file and class name."""

from dataclasses import dataclass, field, fields

from lerobot.configs import PolicyFeature, PreTrainedConfig
from lerobot.policies.act.configuration_act import ACTConfig


@PreTrainedConfig.register_subclass("spatial_act")
@dataclass
class SpatialActConfig(ACTConfig):
    """Settings of ACT's transformer and of the keypoint encoder that replaces its resnet.

    A head predicts the actions at the first `keyframes` gripper switches, which `minidual train-act`
    labels. A trainer without such labels, such as `lerobot-train`, leaves `keyframes` at 0: then the
    transformer gets the keypoints. `octaves` (see `PlaceWaves`) and `head_width` make the head; their
    defaults are those of a checkpoint that does not name them. `bf16`: convolve in bfloat16.
    `grippers` are the entries of a state that are openings, `commanded_grippers` those of an action,
    in the same order; none if no command belongs to each.
    """

    pretrained_backbone_weights: str | None = None
    keypoints: int = 64
    keyframes: int = 0
    octaves: int = 0
    head_width: int = 64
    bf16: bool = False
    grippers: list[int] = field(default_factory=lambda: [-2, -1])
    commanded_grippers: list[int] = field(default_factory=list)

    def transformer(self, input_features: dict[str, PolicyFeature]) -> ACTConfig:
        """Return ACT's configuration for these inputs."""
        settings = {
            field.name: getattr(self, field.name) for field in fields(ACTConfig) if field.init
        }
        settings["input_features"] = input_features
        return ACTConfig(**settings)
