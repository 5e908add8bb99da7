"""Write a checkpoint with weights of half the size."""

import shutil
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file

from minidual.durable import regular_file, replacing
from minidual.errors import DataError
from minidual.policies.checkpoint import WEIGHTS, WEIGHTS_BYTES_MAX, check_files


def halve(checkpoint: Path, folder: Path) -> None:
    """Copy a checkpoint to a new folder, its weights as float16; `load_policy` reads both.

    Statistics of the processors stay float32.

    Raises:
        DataError: The checkpoint is incomplete, or a weight is too large for float16.
    """
    check_files(checkpoint)
    weights = load_file(regular_file(checkpoint / WEIGHTS, WEIGHTS_BYTES_MAX))
    halved = {name: values.to(torch.float16) for name, values in weights.items()}
    for name, values in halved.items():
        if not bool(torch.isfinite(values).all()):
            largest = float(weights[name].abs().max())
            raise DataError(f"{checkpoint}: '{name}' has {largest:g}; float16 ends at 65504")
    with replacing(folder) as partial:
        partial.mkdir(parents=True)
        for path in sorted(checkpoint.iterdir()):
            if path.name != WEIGHTS:
                shutil.copyfile(path, partial / path.name)
        save_file(halved, partial / WEIGHTS)
