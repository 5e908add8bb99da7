"""The checkpoint of a training by reinforcement: what is written is what acts, damage is named."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from minidual.config.seeds import stream
from minidual.errors import DataError
from minidual.policies.rl.network import (
    CONFIG,
    WEIGHTS,
    Description,
    Layers,
    Normalisation,
    RlNetwork,
)

SIZES = (5, 16, 16, 3)


@pytest.fixture
def network() -> RlNetwork:
    rng = stream(3, "network")
    weights = [
        rng.normal(size=(out, into)).astype(np.float32) for into, out in itertools.pairwise(SIZES)
    ]
    biases = [rng.normal(size=out).astype(np.float32) for out in SIZES[1:]]
    normalisation = Normalisation(
        rng.normal(size=5).astype(np.float32),
        rng.uniform(0.5, 2.0, 5).astype(np.float32),
    )
    description = Description("pot_lift", ("joints",), "hands", 10.0)
    return RlNetwork(description, normalisation, Layers(tuple(weights), tuple(biases)))


def test_a_written_network_acts_the_same(network: RlNetwork, tmp_path: Path) -> None:
    observations = stream(4, "observations").normal(size=(7, 5))
    network.write(tmp_path / "checkpoint")
    read = RlNetwork.read(tmp_path / "checkpoint")
    assert np.array_equal(network.act(observations), read.act(observations))
    assert read.description == network.description
    assert read.parameters_n == 5 * 16 + 16 + 16 * 16 + 16 + 16 * 3 + 3


def test_actions_agree_with_the_formula_in_double_precision(network: RlNetwork) -> None:
    """On any machine: single precision may differ in the last digits only."""
    observation = stream(5, "observations").normal(size=5)
    values = (observation - network.normalisation.mean) / network.normalisation.deviation
    values = np.clip(values, -5.0, 5.0).astype(float)
    for number in range(3):
        layer = network.layers.weights[number].astype(float)
        values = layer @ values + network.layers.biases[number]
        if number < 2:
            values = np.tanh(values)
    assert np.allclose(network.act(observation), np.clip(values, -1.0, 1.0), atol=1e-4)


def test_an_observation_of_another_size_or_with_nan_is_refused(network: RlNetwork) -> None:
    with pytest.raises(DataError, match="reads 5 finite numbers; given are 4"):
        network.act(np.zeros(4))
    with pytest.raises(DataError, match="finite"):
        network.act(np.array([0.0, 0.0, np.nan, 0.0, 0.0]))


def test_a_missing_a_damaged_and_a_foreign_checkpoint_are_named(
    network: RlNetwork,
    tmp_path: Path,
) -> None:
    with pytest.raises(DataError, match="there is no policy"):
        RlNetwork.read(tmp_path / "nothing")
    folder = tmp_path / "checkpoint"
    network.write(folder)
    record = json.loads((folder / CONFIG).read_text())
    (folder / CONFIG).write_text(json.dumps({**record, "type": "spatial_act"}))
    with pytest.raises(DataError, match="of the kind 'spatial_act'"):
        RlNetwork.read(folder)
    (folder / CONFIG).write_text(json.dumps({**record, "layers": 2}))
    (folder / WEIGHTS).write_bytes(b"no tensors")
    with pytest.raises(DataError):
        RlNetwork.read(folder)


def test_layers_that_do_not_fit_or_are_not_finite_are_refused(network: RlNetwork) -> None:
    layers = network.layers
    short = layers._replace(weights=layers.weights[1:], biases=layers.biases[1:])
    with pytest.raises(DataError, match="do not fit"):
        RlNetwork(network.description, network.normalisation, short)
    broken = layers.biases[0].copy()
    broken[0] = np.inf
    infinite = layers._replace(biases=(broken, *layers.biases[1:]))
    with pytest.raises(DataError, match="not finite"):
        RlNetwork(network.description, network.normalisation, infinite)
