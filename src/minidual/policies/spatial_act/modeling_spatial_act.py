"""The policy `spatial_act`: keypoints per camera, then LeRobot's unmodified ACT transformer.

The stock ACT already takes a vector beside the robot state (its environment-state token). The keypoints of all
cameras, in the order of the configuration, and the predicted keyframes enter there, so not a line of the
transformer is ours.

A keyframe is the action at a moment when a gripper switches (the grasp, the release). Every frame before the
switch is asked to predict it from the image alone. That gives the encoder a localisation signal in each sample,
where the action chunk, which reaches one second ahead, gives hardly any early in the approach.
"""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACT, ACTPolicy
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGES, OBS_STATE
from torch import Tensor, nn

from minidual.policies.backbone import KeypointEncoder
from minidual.policies.spatial_act.configuration_spatial_act import SpatialActConfig

KEYFRAME = "keyframe"
KEYFRAME_VALID = "keyframe_is_valid"


class SpatialActModel(nn.Module):
    """Keypoint encoders, the keyframe head and the ACT transformer."""

    def __init__(self, config: SpatialActConfig) -> None:
        super().__init__()
        action = config.action_feature
        if action is None:
            raise ValueError("spatial_act needs an output feature 'action'")
        action_dim = action.shape[0]
        # Named as in the stock ACT so that get_optim_params finds the image part.
        self.backbone = nn.ModuleList([KeypointEncoder(config.keypoints) for _ in config.image_features])
        keypoint_dim = sum(encoder.output_dim for encoder in self.backbone)  # type: ignore[misc]
        self.has_keyframe = config.keyframe_weight > 0
        keyframe_dim = 0
        if self.has_keyframe:
            # Linear plus a small nonlinear branch: the map from pixels to joints is close to linear over the
            # few centimetres that an object moves, and few demonstrations determine a linear map well.
            keyframe_dim = config.keyframes * action_dim
            self.keyframe_linear = nn.Linear(keypoint_dim, keyframe_dim)
            self.keyframe_hidden = nn.Sequential(nn.Linear(keypoint_dim, 64), nn.ReLU(), nn.Linear(64, keyframe_dim))
            self.keyframe_shape = (config.keyframes, action_dim)
        token_dim = keypoint_dim + keyframe_dim
        self.act = ACT(_transformer_config(config, token_dim))

    def forward(self, batch: dict[str, Any]) -> tuple[Tensor, tuple[Tensor | None, Tensor | None], Tensor | None]:
        """Return the action chunk (B, S, A), the latent parameters, and the keyframes (B, K, A) or None."""
        images: list[Tensor] = batch[OBS_IMAGES]
        keypoints = torch.cat([encoder(image) for encoder, image in zip(self.backbone, images, strict=True)], dim=1)
        keyframe: Tensor | None = None
        token = keypoints
        if self.has_keyframe:
            flat = self.keyframe_linear(keypoints) + self.keyframe_hidden(keypoints)
            token = torch.cat([keypoints, flat], dim=1)
            keyframe = flat.unflatten(1, self.keyframe_shape)
        inner = {key: batch[key] for key in (OBS_STATE, ACTION, "action_is_pad") if key in batch}
        inner[OBS_ENV_STATE] = token
        actions, latent = self.act(inner)
        return actions, latent, keyframe


def _transformer_config(config: SpatialActConfig, token_dim: int) -> ACTConfig:
    """Return the stock configuration of the transformer: the images replaced by a vector of `token_dim`."""
    inputs = {key: ft for key, ft in (config.input_features or {}).items() if ft.type is not FeatureType.VISUAL}
    inputs[OBS_ENV_STATE] = PolicyFeature(type=FeatureType.ENV, shape=(token_dim,))
    return ACTConfig(
        n_obs_steps=config.n_obs_steps,
        chunk_size=config.chunk_size,
        n_action_steps=config.n_action_steps,
        input_features=inputs,
        output_features=config.output_features,
        device=config.device,
        pretrained_backbone_weights=None,
        pre_norm=config.pre_norm,
        dim_model=config.dim_model,
        n_heads=config.n_heads,
        dim_feedforward=config.dim_feedforward,
        feedforward_activation=config.feedforward_activation,
        n_encoder_layers=config.n_encoder_layers,
        n_decoder_layers=config.n_decoder_layers,
        use_vae=config.use_vae,
        latent_dim=config.latent_dim,
        n_vae_encoder_layers=config.n_vae_encoder_layers,
        dropout=config.dropout,
        kl_weight=config.kl_weight,
    )


class SpatialActPolicy(ACTPolicy):
    """LeRobot policy of type `spatial_act`; saving, loading, queue and reset are the stock ACT's."""

    config_class = SpatialActConfig
    name = "spatial_act"

    def __init__(self, config: SpatialActConfig, **kwargs: Any) -> None:
        PreTrainedPolicy.__init__(self, config)
        config.validate_features()
        self.config = config
        self.model = SpatialActModel(config)
        self.reset()

    def _with_images(self, batch: dict[str, Any]) -> dict[str, Any]:
        return {**batch, OBS_IMAGES: [batch[key] for key in self.config.image_features]}

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Tensor]) -> Tensor:
        """Return the normalised action chunk (B, chunk_size, A) for a normalised observation batch."""
        self.eval()
        return self.model(self._with_images(batch))[0]

    @torch.no_grad()
    def predict_keyframes(self, batch: dict[str, Tensor]) -> Tensor:
        """Return the normalised actions (B, K, A) at the gripper switches, predicted from the images alone.

        Raises:
            ValueError: the policy was configured with keyframe_weight 0 and has no such head.
        """
        self.eval()
        keyframe = self.model(self._with_images(batch))[2]
        if keyframe is None:
            raise ValueError("this policy has no keyframe head: keyframe_weight is 0")
        return keyframe

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, float]]:
        """Return the training loss and its parts: masked L1, keyframe L1, KL divergence with a VAE.

        The batch may carry `keyframe` (B, K, A) with `keyframe_is_valid` (B, K): the normalised actions at the
        gripper switches, used only for the switch that lies next ahead of each sample.
        """
        actions, (mean, log_variance), keyframe = self.model(self._with_images(batch))
        mask = ~batch["action_is_pad"].unsqueeze(-1)
        count = (mask.sum() * actions.shape[-1]).clamp_min(1)
        l1 = (F.l1_loss(actions, batch[ACTION], reduction="none") * mask).sum() / count
        parts = {"l1_loss": float(l1.detach())}
        loss = l1
        if keyframe is not None and KEYFRAME in batch:
            valid = batch[KEYFRAME_VALID].unsqueeze(-1)
            scale = (valid.sum() * keyframe.shape[-1]).clamp_min(1)
            posture = (F.l1_loss(keyframe, batch[KEYFRAME], reduction="none") * valid).sum() / scale
            parts["keyframe_loss"] = float(posture.detach())
            loss = loss + self.config.keyframe_weight * posture
        if self.config.use_vae and mean is not None and log_variance is not None:
            divergence = (-0.5 * (1 + log_variance - mean.square() - log_variance.exp())).sum(-1).mean()
            parts["kld_loss"] = float(divergence.detach())
            loss = loss + self.config.kl_weight * divergence
        return loss, parts
