"""Diffusion: LeRobot's policy as it is, and LeRobot's UNet behind the eyes of `spatial_act`.

The second is for CPUs: a resnet18 is the least that the first can have, and takes most of its time.
"""

import dataclasses
from pathlib import Path

from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor

from minidual.config.learning import TrainConfig
from minidual.demos.lerobot_reader import STATE
from minidual.policies.act import ActKind, SpatialActKind, input_features, output_features
from minidual.policies.architectures import (
    KEYFRAME_DIFFUSION,
    KEYPOINT_DIFFUSION,
    STOCK_DIFFUSION,
    Architecture,
)
from minidual.policies.chunk_policy import ChunkPolicy
from minidual.policies.demonstrations import Demonstrations
from minidual.policies.draws import same_draws
from minidual.policies.foreign import FOREIGN
from minidual.policies.kinds import Training, TrainResult, require_library
from minidual.policies.spatial_act.configuration_spatial_act import SpatialActConfig
from minidual.policies.spatial_diffusion.configuration_spatial_diffusion import (
    SpatialDiffusionConfig,
)
from minidual.policies.spatial_diffusion.modeling_spatial_diffusion import SpatialDiffusionPolicy

_NOISE_LEVELS = 100
_STAGES_N = 2
"""Stages of the UNet; each halves the time axis, so a chunk is a multiple of 4 ticks."""


class OneLookDiffusion(DiffusionPolicy):
    """LeRobot's policy with the batches of our training loop: one look a sample, state (B, D)."""

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, float]]:  # type: ignore[override]
        """Return the mean squared error of the denoised actions, in squared standard deviations."""
        loss, _ = super().forward(_one_look(batch))
        return loss, {"l1_loss": float(loss.detach())}

    def predict_action_chunk(self, batch: dict[str, Tensor], noise: Tensor | None = None) -> Tensor:
        """Return a chunk (B, S, A); equal looks have equal answers."""
        with same_draws():
            return super().predict_action_chunk(_one_look(batch), noise)


def _one_look(batch: dict[str, Tensor]) -> dict[str, Tensor]:
    """Return a batch whose states (B, 1, D) have an axis of looks; LeRobot adds that of pictures."""
    return {**batch, STATE: batch[STATE].unsqueeze(1)}


class DiffusionKind(ActKind):
    """A one-dimensional UNet denoises chunks, given keypoints of a resnet18 and the state."""

    config_class = DiffusionConfig
    policy_class = DiffusionPolicy
    draws_in_forward = True

    def require(self, device: str) -> None:
        """See `PolicyKind.require`; the library of noise schedules is an extra."""
        require_library("diffusion")
        super().require(device)

    def architecture(self, policy_config: PreTrainedConfig) -> Architecture:
        """See `ActKind.architecture`."""
        return STOCK_DIFFUSION

    def train(self, job: Training, folder: Path) -> TrainResult:
        """See `PolicyKind.train`; chunks are as long as the UNet can halve."""
        whole = 2**_STAGES_N
        chunk_size = whole * -(-job.config.chunk_size // whole)
        config = job.config.model_copy(update={"chunk_size": chunk_size})
        return super().train(job._replace(config=config), folder)

    def make(self, config: TrainConfig, demos: Demonstrations) -> PreTrainedPolicy:
        """See `ActKind.make`.

        The network predicts the clean actions from noisy ones, not the noise: it learns faster and
        needs fewer passes (as in Ze et al., 3D Diffusion Policy, 2024).
        """
        return OneLookDiffusion(
            DiffusionConfig(
                input_features=input_features(demos),
                output_features=output_features(demos),
                device=config.device,
                push_to_hub=False,
                n_obs_steps=1,
                horizon=config.chunk_size,
                n_action_steps=config.chunk_size,
                normalization_mapping=dict.fromkeys(
                    ("VISUAL", "STATE", "ACTION"),
                    NormalizationMode.MEAN_STD,
                ),
                vision_backbone="resnet18",
                pretrained_backbone_weights=None,
                use_group_norm=True,
                spatial_softmax_num_keypoints=config.keypoints,
                down_dims=(config.dim_model // 2, config.dim_model),
                diffusion_step_embed_dim=config.dim_model // 2,
                noise_scheduler_type="DDIM",
                num_train_timesteps=_NOISE_LEVELS,
                num_inference_steps=config.denoising_steps,
                prediction_type="sample",
                clip_sample=False,
                optimizer_lr=config.learning_rate,
                optimizer_weight_decay=config.weight_decay,
            ),
        )

    def load(self, folder: Path, device: str, threads: int | None) -> ChunkPolicy:
        """See `PolicyKind.load`; checkpoints of `lerobot-train` are of this type too."""
        self.require(device)
        return FOREIGN.load(folder, device, threads)


class SpatialDiffusionKind(SpatialActKind):
    """Keypoints of each picture, then keyframes, then LeRobot's diffusion."""

    config_class = SpatialDiffusionConfig
    policy_class = SpatialDiffusionPolicy

    def require(self, device: str) -> None:
        """See `DiffusionKind.require`."""
        require_library("spatial_diffusion")
        super().require(device)

    def architecture(self, policy_config: PreTrainedConfig) -> Architecture:
        """See `SpatialActKind.architecture`."""
        assert isinstance(policy_config, SpatialActConfig)
        return KEYFRAME_DIFFUSION if policy_config.keyframes else KEYPOINT_DIFFUSION

    def configuration(self, config: TrainConfig, demos: Demonstrations) -> SpatialActConfig:
        """See `SpatialActKind.configuration`."""
        policy_config = super().configuration(config, demos)
        return dataclasses.replace(policy_config, denoising_steps=config.denoising_steps)


DIFFUSION = DiffusionKind()
SPATIAL_DIFFUSION = SpatialDiffusionKind()
