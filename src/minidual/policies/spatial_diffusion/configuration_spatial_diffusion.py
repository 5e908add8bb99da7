"""Configuration of `spatial_diffusion`, found by file and class name."""

from dataclasses import dataclass

from lerobot.configs import NormalizationMode, PolicyFeature, PreTrainedConfig
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig

from minidual.policies.spatial_act.configuration_spatial_act import SpatialActConfig

_STAGES_N = 2
"""Stages of the UNet; each halves the time axis."""


@PreTrainedConfig.register_subclass("spatial_diffusion")
@dataclass
class SpatialDiffusionConfig(SpatialActConfig):
    """Settings of `spatial_act`, with LeRobot's diffusion instead of ACT's transformer.

    `dim_model` is the width of the UNet's inner stage. Settings of the transformer have no meaning.
    """

    noise_levels: int = 100
    denoising_steps: int = 5

    @property
    def horizon(self) -> int:
        """Ticks that the UNet denoises: the chunk, up to a length that it can halve."""
        whole = 2**_STAGES_N
        return whole * -(-self.chunk_size // whole)

    def unet(self, input_features: dict[str, PolicyFeature]) -> DiffusionConfig:
        """Return the configuration of LeRobot's diffusion for these inputs, none of them pictures."""
        return DiffusionConfig(
            input_features=input_features,
            output_features=self.output_features,
            device=self.device,
            push_to_hub=False,
            n_obs_steps=1,
            horizon=self.horizon,
            n_action_steps=self.chunk_size,
            normalization_mapping=dict.fromkeys(
                ("VISUAL", "STATE", "ACTION", "ENV"),
                NormalizationMode.IDENTITY,
            ),
            pretrained_backbone_weights=None,
            down_dims=(self.dim_model // 2, self.dim_model),
            kernel_size=3,
            diffusion_step_embed_dim=self.dim_model // 2,
            noise_scheduler_type="DDIM",
            num_train_timesteps=self.noise_levels,
            num_inference_steps=self.denoising_steps,
            prediction_type="sample",
            clip_sample=False,
        )
