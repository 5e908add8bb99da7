"""Builds the LeRobot policy and its processors that a TrainConfig describes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors

from minidual.config.learning import TrainConfig
from minidual.errors import EnvironmentMissingError
from minidual.policies.demonstrations import STATE_DIM
from minidual.policies.normalisation import Stats, image_key
from minidual.policies.spatial_act.configuration_spatial_act import SpatialActConfig
from minidual.policies.spatial_act.modeling_spatial_act import SpatialActPolicy


def policy_config(config: TrainConfig, image_sizes: Mapping[str, tuple[int, int]]) -> ACTConfig:
    """Return the LeRobot configuration: cameras by name, sizes (H, W), 16 numbers of state and of action."""
    inputs = {"observation.state": PolicyFeature(type=FeatureType.STATE, shape=(STATE_DIM,))}
    for camera in sorted(image_sizes):
        inputs[image_key(camera)] = PolicyFeature(type=FeatureType.VISUAL, shape=(3, *image_sizes[camera]))
    common: dict[str, Any] = {
        "input_features": inputs,
        "output_features": {"action": PolicyFeature(type=FeatureType.ACTION, shape=(STATE_DIM,))},
        "device": config.device,
        "push_to_hub": False,
        "chunk_size": config.chunk_size,
        "n_action_steps": config.chunk_size,
        "pretrained_backbone_weights": None,
        "dim_model": config.dim_model,
        "n_heads": config.heads,
        "dim_feedforward": config.dim_feedforward,
        "n_encoder_layers": config.encoder_layers,
        "n_decoder_layers": config.decoder_layers,
        "use_vae": config.use_vae,
        "kl_weight": config.kl_weight,
        "dropout": config.dropout,
        "optimizer_lr": config.learning_rate,
        "optimizer_lr_backbone": config.learning_rate,
        "optimizer_weight_decay": config.weight_decay,
    }
    if config.backbone == "spatial_softmax":
        return SpatialActConfig(keypoints=config.keypoints, keyframe_weight=config.keyframe_weight, **common)
    return ACTConfig(vision_backbone=config.backbone, **common)


def build_policy(
    config: TrainConfig, image_sizes: Mapping[str, tuple[int, int]], stats: Stats
) -> tuple[ACTPolicy, Any, Any]:
    """Return (policy on its device, pre-processor, post-processor); weights from the torch generator as it stands.

    Raises:
        EnvironmentMissingError: `device` is cuda and there is none.
    """
    require_device(config.device)
    described = policy_config(config, image_sizes)
    policy: ACTPolicy
    if isinstance(described, SpatialActConfig):
        policy = SpatialActPolicy(described)
        for encoder in policy.model.backbone:
            encoder.bf16 = use_bf16(config)
    else:
        policy = ACTPolicy(described)
    policy.to(config.device)
    if config.backbone == "spatial_softmax":
        policy.model.backbone.to(memory_format=torch.channels_last)
    preprocessor, postprocessor = make_pre_post_processors(described, dataset_stats=stats)
    return policy, preprocessor, postprocessor


def require_device(device: str) -> None:
    """Raise EnvironmentMissingError if `device` is cuda and torch sees none."""
    if device == "cuda" and not torch.cuda.is_available():
        raise EnvironmentMissingError(
            "the configuration asks for device 'cuda', but torch finds no CUDA device; devices here: cpu",
            remedy="use --profile standard, or --set train.device=cpu --set deploy.device=cpu",
        )


def use_bf16(config: TrainConfig) -> bool:
    """Return whether the convolutions compute in bfloat16: as configured, or natively supported under 'auto'."""
    if config.precision != "auto":
        return config.precision == "bf16"
    if config.device == "cuda":
        return torch.cuda.is_bf16_supported()
    # Without native instructions bfloat16 is emulated and several times slower than float32.
    return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())


def parameters_n(policy: torch.nn.Module) -> int:
    """Return the number of trainable parameters."""
    return sum(p.numel() for p in policy.parameters() if p.requires_grad)
