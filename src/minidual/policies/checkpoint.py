"""Checks of a LeRobot checkpoint's files, before LeRobot or torch acts on them."""

from pathlib import Path

import torch
from lerobot.configs import PreTrainedConfig
from safetensors.torch import load_file

from minidual import durable
from minidual.errors import DataError
from minidual.policies.kinds import REMEDY

CONFIG = "config.json"
WEIGHTS = "model.safetensors"
PROCESSORS = ("policy_preprocessor.json", "policy_postprocessor.json")
STEPS = (
    "rename_observations_processor",
    "to_batch_processor",
    "device_processor",
    "normalizer_processor",
    "unnormalizer_processor",
)
"""Steps of ACT in LeRobot's registry. None of them runs code, opens a file or connects to a server.
"""
_OF_TRAINING = ("training", "warmup", "decay", "seed")
"""Parts of the names of settings that are no sizes of a network."""
_STEP_KEYS = {"registry_name", "config", "state_file"}
STATE_BYTES_MAX = 2**24
WEIGHTS_BYTES_MAX = 2**32
SIZE_MAX = 4096
LAYERS_MAX = 16


def check_files(folder: Path) -> None:
    """Raise DataError unless the files exist and the processors are safe."""
    required = (CONFIG, WEIGHTS, *PROCESSORS)
    missing = [name for name in required if not (folder / name).is_file()]
    if missing:
        raise DataError(
            f"checkpoint {folder} lacks {', '.join(missing)}",
            remedy=f"{REMEDY} --force",
        )
    for name in PROCESSORS:
        check_processor(folder / name)


def check_processor(path: Path) -> None:
    """Raise DataError unless a processor file names only STEPS, and finite statistics beside it.

    To be called before LeRobot, which imports what the file names.
    """
    for number, step in enumerate(durable.read_json(path)["steps"]):
        unknown_keys = sorted(step.keys() - _STEP_KEYS)
        if unknown_keys or step["registry_name"] not in STEPS:
            refused_keys = unknown_keys or ["registry_name"]
            named = ", ".join(f"{key} {step[key]!r:.60}" for key in refused_keys)
            raise DataError(
                f"{path}: step {number} names {named}; minidual runs only {', '.join(STEPS)}",
            )
        if "state_file" in step:
            read_tensors(path.with_name(step["state_file"]), STATE_BYTES_MAX)


def check_sizes(config: PreTrainedConfig) -> None:
    """Raise ValueError if the network would not fit a common memory."""
    sizes: dict[str, tuple[int, ...]] = {}
    for name, value in vars(config).items():
        if isinstance(value, int) and not any(part in name for part in _OF_TRAINING):
            sizes[name] = (value,)
    for features in (config.input_features, config.output_features):
        for name, feature in (features or {}).items():
            sizes[name] = feature.shape
    for name, values in sizes.items():
        limit = LAYERS_MAX if name.endswith("_layers") else SIZE_MAX
        if not all(0 <= value <= limit for value in values):
            raise ValueError(
                f"{name} in config.json is {list(values)}; sizes here are 0 to {limit}",
            )


def read_tensors(path: Path, bytes_max: int = WEIGHTS_BYTES_MAX) -> dict[str, torch.Tensor]:
    """Read a safetensors file; DataError unless every value is a finite floating-point number."""
    tensors = load_file(durable.regular_file(path, bytes_max))
    for name, values in tensors.items():
        if not values.is_floating_point() or not bool(torch.isfinite(values).all()):
            raise DataError(
                f"{path}: '{name}' ({values.dtype}) must hold finite floating-point numbers",
            )
    return tensors
