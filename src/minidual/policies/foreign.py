"""Checkpoints of LeRobot's other policies, and of policies of its plug-ins."""

from pathlib import Path
from typing import Any

import draccus
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.utils.import_utils import register_third_party_plugins
from safetensors.torch import load_file, load_model

from minidual import durable
from minidual.errors import DataError, EnvironmentMissingError, UsageError, unknown_name
from minidual.policies.act import ACT_KIND
from minidual.policies.checkpoint import (
    CONFIG,
    WEIGHTS,
    WEIGHTS_BYTES_MAX,
    check_files,
    check_sizes,
)
from minidual.policies.chunk_policy import ChunkPolicy
from minidual.policies.facts import read_facts
from minidual.policies.kinds import POLICIES, PolicyKind, Training, TrainResult
from minidual.policies.lerobot_policy import (
    DenoisedChunkPolicy,
    TorchChunkPolicy,
    TorchTickPolicy,
    Trained,
)

_REMEDY = "train it again with lerobot-train, or name another folder"
_DOWNLOADS = ("pretrained_backbone_weights",)
"""Settings that would fetch weights to start a training from; those of the checkpoint replace them."""


class ForeignKind(PolicyKind):
    """Loads a checkpoint by the type in its config.json."""

    def train(self, job: Training, folder: Path) -> TrainResult:
        """Refuse: `lerobot-train` trains them.

        Raises:
            UsageError: Always.
        """
        raise UsageError("policies of LeRobot are trained by lerobot-train", remedy=_REMEDY)

    def load(self, folder: Path, device: str, threads: int | None) -> ChunkPolicy:
        """See `PolicyKind.load`.

        A policy that looks back over several ticks, such as most of diffusion, keeps its own queues.
        """
        ACT_KIND.require(device)
        with durable.reading(f"checkpoint {folder}", _REMEDY):
            config = _config(folder, device)
            trained = _trained(folder, config, device)
            policy = _driving_class(config)(trained, threads)
            policy.facts = read_facts(folder)
            return policy


FOREIGN = ForeignKind()


def _driving_class(config: Any) -> type[TorchChunkPolicy]:
    """Return how a policy is driven: in chunks, or at every tick."""
    looks_back = int(getattr(config, "n_obs_steps", 1)) > 1
    if config.type == "diffusion" and not looks_back:
        return DenoisedChunkPolicy
    if looks_back or not hasattr(config, "chunk_size"):
        return TorchTickPolicy
    return TorchChunkPolicy


def _config(folder: Path, device: str) -> Any:
    record = durable.read_json(folder / CONFIG)
    name = record.pop("type")
    register_third_party_plugins()
    choices = PreTrainedConfig.get_known_choices()
    if name not in choices:
        unknown = unknown_name("policy", name, {*POLICIES, *choices})
        raise DataError(
            f"checkpoint {folder}: {unknown.message}",
            remedy=unknown.remedy or "install the distribution lerobot_policy_... that has it",
        )
    check_files(folder)
    record["device"] = device
    for key in _DOWNLOADS:
        if key in record:
            record[key] = None
    config = draccus.decode(choices[name], record)
    check_sizes(config)
    return config


def _trained(folder: Path, config: Any, device: str) -> Trained:
    path = durable.regular_file(folder / WEIGHTS, WEIGHTS_BYTES_MAX)
    for name, values in load_file(path).items():
        if values.is_floating_point() and not bool(torch.isfinite(values).all()):
            raise DataError(f"{path}: '{name}' must hold finite numbers")
    try:
        policy: Any = get_policy_class(config.type)(config)
    except ImportError as error:
        raise EnvironmentMissingError(
            f"the policy '{config.type}' needs a library that is not installed: {error}",
            remedy=f"pip install 'lerobot[{config.type}]'",
        ) from error
    load_model(policy, path, strict=True, device=device)
    policy.to(device)
    policy.eval()
    processors = make_pre_post_processors(
        config,
        pretrained_path=str(folder),
        preprocessor_overrides={"device_processor": {"device": device}},
    )
    return Trained(policy, *processors)
