"""ACT policies through LeRobot."""

import dataclasses
from pathlib import Path

import draccus
import numpy as np
import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors
from lerobot.policies.pretrained import PreTrainedPolicy

from minidual import durable
from minidual.config.learning import TrainConfig
from minidual.demos.lerobot_reader import ACTION, STATE, camera_key
from minidual.errors import DataError, EnvironmentMissingError
from minidual.policies.architectures import (
    KEYFRAME_ACT,
    KEYPOINT_ACT,
    STOCK_ACT,
    Architecture,
)
from minidual.policies.batches import Stats
from minidual.policies.checkpoint import CONFIG, WEIGHTS, check_files, check_sizes, read_tensors
from minidual.policies.chunk_policy import ChunkPolicy
from minidual.policies.demonstrations import Demonstrations
from minidual.policies.facts import read_facts
from minidual.policies.kinds import REMEDY, PolicyKind, Training, TrainResult
from minidual.policies.lerobot_policy import TorchChunkPolicy, Trained
from minidual.policies.spatial_act.configuration_spatial_act import SpatialActConfig
from minidual.policies.spatial_act.modeling_spatial_act import SpatialActPolicy
from minidual.policies.takes import write_takes
from minidual.policies.train import train


class ActKind(PolicyKind):
    """Stock ACT with a resnet18."""

    config_class: type[PreTrainedConfig] = ACTConfig
    policy_class: type[PreTrainedPolicy] = ACTPolicy
    draws_in_forward: bool = False
    """Whether the network draws random numbers that are no dropout and no VAE."""

    def make(self, config: TrainConfig, demos: Demonstrations) -> PreTrainedPolicy:
        """Return a new policy; torch's generator draws the weights."""
        return ACTPolicy(_policy_config(ACTConfig, config, demos))

    def architecture(self, policy_config: PreTrainedConfig) -> Architecture:
        """Return the description of this configuration's network."""
        return STOCK_ACT

    def require(self, device: str) -> None:
        """Raise EnvironmentMissingError for a missing device."""
        if device == "cuda" and not torch.cuda.is_available():
            raise EnvironmentMissingError(
                "the configuration asks for device 'cuda', but torch finds no CUDA device; "
                "devices here: cpu",
                remedy=(
                    "use --profile standard, or --set train.device=cpu --set deploy.device=cpu"
                ),
            )

    def train(self, job: Training, folder: Path) -> TrainResult:
        """See `PolicyKind.train`."""
        config = job.config
        self.require(config.device)
        if folder.exists():
            raise DataError(
                f"the checkpoint folder {folder} exists already",
                remedy=f"{REMEDY} --force",
            )

        def build(stats: Stats) -> Trained:
            policy = self.make(config, job.demos).to(config.device)
            return Trained(policy, *make_pre_post_processors(policy.config, dataset_stats=stats))

        result, trained = train(build, job, draws_in_forward=self.draws_in_forward)
        result.architecture = self.architecture(trained.policy.config).name
        with durable.replacing(folder) as partial:
            partial.mkdir(parents=True)
            for part in trained:
                part.save_pretrained(partial)
            if job.demos.takes is not None:
                write_takes(job.demos.takes, partial)
        return result

    def load(self, folder: Path, device: str, threads: int | None) -> ChunkPolicy:
        """See `PolicyKind.load`."""
        self.require(device)
        with durable.reading(f"checkpoint {folder}", f"{REMEDY} --force"):
            policy = TorchChunkPolicy(self.read(folder, device), threads)
            policy.facts = read_facts(folder)
            _try_out(policy)
        return policy

    def read(self, folder: Path, device: str = "cpu") -> Trained:
        """Read policy (in evaluation mode) and processors."""
        check_files(folder)
        config = self._read_config(folder, device)
        policy = self.policy_class(config)
        policy.load_state_dict(read_tensors(folder / WEIGHTS))
        policy.to(device)
        policy.eval()
        if isinstance(policy, SpatialActPolicy):
            policy.fast_on_cpu()
        preprocessor, postprocessor = make_pre_post_processors(
            policy.config,
            pretrained_path=str(folder),
            preprocessor_overrides={"device_processor": {"device": device}},
        )
        return Trained(policy, preprocessor, postprocessor)

    def _read_config(self, folder: Path, device: str) -> PreTrainedConfig:
        record = durable.read_json(folder / CONFIG)
        if record.pop("type") != self.config_class.get_choice_name(self.config_class):
            raise ValueError(f"{CONFIG} describes a policy of another type")
        record["device"] = device
        # Weights to start training from would be downloaded; those of the checkpoint replace them.
        record["pretrained_backbone_weights"] = None
        config = draccus.decode(self.config_class, record)
        check_sizes(config)
        if isinstance(config, SpatialActConfig) and config.bf16 and not native_bf16(device):
            config.bf16 = False
        return config


class SpatialActKind(ActKind):
    """Keypoints of each picture, then keyframes, then ACT's transformer."""

    config_class: type[SpatialActConfig] = SpatialActConfig
    policy_class: type[SpatialActPolicy] = SpatialActPolicy

    def architecture(self, policy_config: PreTrainedConfig) -> Architecture:
        """See `ActKind.architecture`; without keyframes the transformer gets the keypoints."""
        assert isinstance(policy_config, SpatialActConfig)
        return KEYFRAME_ACT if policy_config.keyframes else KEYPOINT_ACT

    def make(self, config: TrainConfig, demos: Demonstrations) -> PreTrainedPolicy:
        """See `ActKind.make`."""
        policy = self.policy_class(self.configuration(config, demos))
        policy.fast_on_cpu()
        return policy

    def configuration(self, config: TrainConfig, demos: Demonstrations) -> SpatialActConfig:
        """Return the network's configuration; convolutions use bfloat16 where the device has it."""
        return dataclasses.replace(
            _policy_config(self.config_class, config, demos),
            keypoints=config.keypoints,
            octaves=config.octaves,
            head_width=config.head_width,
            keyframes=demos.keyframe_ticks.shape[1],
            grippers=demos.state_grippers,
            commanded_grippers=demos.commanded_grippers,
            bf16=native_bf16(config.device),
        )


ACT_KIND = ActKind()
SPATIAL_ACT = SpatialActKind()


def native_bf16(device: str) -> bool:
    """Whether `device` computes in bfloat16; emulated, it is several times slower than float32."""
    if device == "cuda":
        return torch.cuda.is_bf16_supported()
    capabilities = torch.cpu.get_capabilities()
    return bool(capabilities.get("avx512_bf16") or capabilities.get("amx_tile"))


def _try_out(policy: TorchChunkPolicy) -> None:
    """Raise unless the policy emits a chunk of its shape: statistics may not fit the network."""
    images = {
        camera: np.zeros((height, width, 3), np.uint8)
        for camera, (height, width) in policy.cameras.items()
    }
    chunk = policy.predict(images, np.zeros(policy.state_dim, np.float32))
    expected = (policy.chunk_size, policy.dim)
    if chunk.shape != expected:
        raise ValueError(f"it emits {chunk.shape}, not {expected}")


def input_features(demos: Demonstrations) -> dict[str, PolicyFeature]:
    """Return what a policy of the demonstrations reads, as LeRobot names it."""
    inputs = {STATE: PolicyFeature(type=FeatureType.STATE, shape=(demos.state_dim,))}
    for camera in demos.cameras:
        height, width = demos.images[camera].shape[1:3]
        inputs[camera_key(camera)] = PolicyFeature(
            type=FeatureType.VISUAL,
            shape=(3, height, width),
        )
    return inputs


def output_features(demos: Demonstrations) -> dict[str, PolicyFeature]:
    """Return what a policy of the demonstrations commands, as LeRobot names it."""
    return {ACTION: PolicyFeature(type=FeatureType.ACTION, shape=(demos.dim,))}


def _policy_config[Config: ACTConfig](
    config_class: type[Config],
    config: TrainConfig,
    demos: Demonstrations,
) -> Config:
    """Return the configuration of ACT's transformer for the demonstrations."""
    return config_class(
        input_features=input_features(demos),
        output_features=output_features(demos),
        device=config.device,
        push_to_hub=False,
        chunk_size=config.chunk_size,
        n_action_steps=config.chunk_size,
        vision_backbone="resnet18",
        pretrained_backbone_weights=None,
        dim_model=config.dim_model,
        dim_feedforward=config.dim_feedforward,
        n_heads=config.heads,
        n_encoder_layers=config.encoder_layers,
        n_decoder_layers=config.decoder_layers,
        dropout=config.dropout,
        use_vae=config.use_vae,
        kl_weight=config.kl_weight,
        optimizer_lr=config.learning_rate,
        optimizer_lr_backbone=config.backbone_learning_rate,
        optimizer_weight_decay=config.weight_decay,
    )
