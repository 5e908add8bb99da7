"""Checks of a checkpoint's files before LeRobot, which imports what a processor file names, reads them."""

from pathlib import Path

import torch
from lerobot.configs import PreTrainedConfig
from safetensors.torch import load_file
from torch import Tensor

from minidual.durable import read_json, regular_file
from minidual.errors import DataError

STEPS = (
    "rename_observations_processor",
    "to_batch_processor",
    "device_processor",
    "normalizer_processor",
    "unnormalizer_processor",
)
"""Steps of ACT in LeRobot's registry. None of them runs code, opens a file or connects to a server."""
STATE_BYTES_MAX, WEIGHTS_BYTES_MAX = 2**24, 2**32
SIZE_MAX, LAYERS_MAX = 4096, 16


def check_processor(path: Path) -> None:
    """Raise DataError unless a processor file names only STEPS, and finite statistics beside it."""
    for number, step in enumerate(read_json(path)["steps"]):
        unknown = sorted(step.keys() - {"registry_name", "config", "state_file"})
        if unknown or step["registry_name"] not in STEPS:
            named = ", ".join(f"{key} {step[key]!r:.60}" for key in (unknown or ["registry_name"]))
            raise DataError(f"{path}: step {number} names {named}; minidual runs only {', '.join(STEPS)}")
        if "state_file" in step:
            read_tensors(path.with_name(step["state_file"]), STATE_BYTES_MAX)


def check_sizes(config: PreTrainedConfig) -> None:
    """Raise ValueError if the network would not fit a common memory."""
    sizes = {name: [value] for name, value in vars(config).items() if isinstance(value, int)}
    sizes |= {
        name: feature.shape
        for name, feature in {**(config.input_features or {}), **(config.output_features or {})}.items()
    }
    for name, values in sizes.items():
        limit = LAYERS_MAX if name.endswith("_layers") else SIZE_MAX
        if not all(0 <= value <= limit for value in values):
            raise ValueError(f"{name} in config.json is {list(values)}; sizes here are 0 to {limit}")


def read_tensors(path: Path, bytes_max: int = WEIGHTS_BYTES_MAX) -> dict[str, Tensor]:
    """Read a safetensors file; DataError unless every value is a finite floating-point number."""
    tensors = load_file(regular_file(path, bytes_max))
    for name, values in tensors.items():
        if not values.is_floating_point() or not bool(torch.isfinite(values).all()):
            raise DataError(f"{path}: '{name}' ({values.dtype}) must hold finite floating-point numbers")
    return tensors
