"""The network that a training by reinforcement leaves: a file, and its inference in numpy.

Numpy suffices for two layers of 256 units: an inference takes 0.1 ms, and a control process need
not import PyTorch.
"""

import json
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt
from safetensors.numpy import load_file, save_file

from minidual import durable
from minidual.errors import DataError

CONFIG = "config.json"
WEIGHTS = "model.safetensors"
TYPE = "rl"
"""Of `config.json`."""
BYTES_MAX = 2**26
CLIPPED = 5.0
"""Normalised observations are clipped to this, in training as well."""

type Array32 = npt.NDArray[np.float32]


class Description(NamedTuple):
    """Task, inputs and outputs of a network.

    Attributes:
        task: Row of TASKS.
        observation: Names of the terms of its observation, in order.
        action: Name of its action space.
        rate_hz: Actions a second.
    """

    task: str
    observation: tuple[str, ...]
    action: str
    rate_hz: float


class Layers(NamedTuple):
    """Weights (out, in) and biases (out,) of the linear layers; tanh lies between them."""

    weights: tuple[Array32, ...]
    biases: tuple[Array32, ...]


class Normalisation(NamedTuple):
    """Mean and standard deviation (n,) of the observations."""

    mean: Array32
    deviation: Array32


class RlNetwork:
    """Maps an observation to the mean of the action's distribution.

    Args:
        description: What it was trained for.
        normalisation: Of observations (n,).
        layers: From n observations to m actions.

    Raises:
        DataError: Shapes do not fit each other, or a value is not finite.
    """

    def __init__(
        self,
        description: Description,
        normalisation: Normalisation,
        layers: Layers,
    ) -> None:
        self.description = description
        self.normalisation = normalisation
        self.layers = layers
        _check_shapes(normalisation, layers)

    @property
    def observation_size(self) -> int:
        """Numbers of an observation."""
        return len(self.normalisation.mean)

    @property
    def action_size(self) -> int:
        """Numbers of an action."""
        return len(self.layers.biases[-1])

    @property
    def parameters_n(self) -> int:
        """Weights and biases."""
        return sum(array.size for array in (*self.layers.weights, *self.layers.biases))

    def act(self, observations: npt.NDArray[np.floating[Any]]) -> Array32:
        """Return actions (..., m) in -1..1 for observations (..., n).

        Raises:
            DataError: The size is another one, or a value is not finite.
        """
        values = np.asarray(observations, dtype=np.float32)
        if values.shape[-1] != self.observation_size or not np.isfinite(values).all():
            raise DataError(
                f"the policy reads {self.observation_size} finite numbers; "
                f"given are {values.shape[-1]}",
            )
        centred = (values - self.normalisation.mean) / self.normalisation.deviation
        hidden = np.clip(centred, -CLIPPED, CLIPPED)
        last = len(self.layers.weights) - 1
        for number, (weights, biases) in enumerate(zip(*self.layers, strict=True)):
            hidden = hidden @ weights.T + biases
            if number < last:
                hidden = np.tanh(hidden)
        return np.clip(hidden, -1.0, 1.0)

    def write(self, folder: Path) -> None:
        """Write the checkpoint into a new folder, which appears whole or not at all."""
        temporary = folder.with_name(f"{folder.name}.tmp")
        durable.remove(temporary)
        temporary.mkdir(parents=True)
        tensors = {
            "observation.mean": self.normalisation.mean,
            "observation.deviation": self.normalisation.deviation,
        }
        for number, (weights, biases) in enumerate(zip(*self.layers, strict=True)):
            tensors[f"layer{number}.weight"] = np.ascontiguousarray(weights)
            tensors[f"layer{number}.bias"] = np.ascontiguousarray(biases)
        save_file(tensors, temporary / WEIGHTS)
        record = {
            "type": TYPE,
            "task": self.description.task,
            "observation": list(self.description.observation),
            "action": self.description.action,
            "rate_hz": self.description.rate_hz,
            "observation_size": self.observation_size,
            "action_size": self.action_size,
            "layers": len(self.layers.weights),
        }
        durable.write_text(temporary / CONFIG, json.dumps(record, indent=2) + "\n")
        temporary.rename(folder)

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read a checkpoint.

        Raises:
            DataError: It is missing, damaged, or of another kind.
        """
        if not (folder / CONFIG).is_file():
            raise DataError(
                f"there is no policy in {folder}: it has no {CONFIG}",
                remedy="minidual train rl --task TASK",
            )
        with durable.reading(f"checkpoint {folder}", "train it again"):
            record = durable.read_json(folder / CONFIG)
            if record["type"] != TYPE:
                raise DataError(
                    f"the policy in {folder} is of the kind '{record['type']}'; "
                    f"the method rl drives '{TYPE}'",
                )
            tensors = load_file(durable.regular_file(folder / WEIGHTS, BYTES_MAX))
            numbers = range(int(record["layers"]))
            description = Description(
                str(record["task"]),
                tuple(record["observation"]),
                str(record["action"]),
                float(record["rate_hz"]),
            )
            normalisation = Normalisation(
                tensors["observation.mean"].astype(np.float32),
                tensors["observation.deviation"].astype(np.float32),
            )
            layers = Layers(
                tuple(tensors[f"layer{number}.weight"].astype(np.float32) for number in numbers),
                tuple(tensors[f"layer{number}.bias"].astype(np.float32) for number in numbers),
            )
        return cls(description, normalisation, layers)


def _check_shapes(normalisation: Normalisation, layers: Layers) -> None:
    """Raise DataError unless each layer reads what the one before gives, and all is finite."""
    width = len(normalisation.mean)
    fits = len(layers.weights) > 0 and normalisation.deviation.shape == (width,)
    for weights, biases in zip(*layers, strict=True):
        fits = fits and weights.shape == (len(biases), width)
        width = len(biases)
    arrays = (*normalisation, *layers.weights, *layers.biases)
    finite = all(bool(np.isfinite(array).all()) for array in arrays)
    positive = bool((normalisation.deviation > 0.0).all())
    if not (fits and finite and positive):
        raise DataError(
            "the network's layers do not fit each other, or hold values that are not finite",
            remedy="train it again",
        )
