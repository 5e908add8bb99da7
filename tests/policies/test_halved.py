"""A checkpoint of half the size drives the arms as the whole one does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from minidual.config.learning import TrainConfig
from minidual.errors import DataError
from minidual.policies.kinds import load_policy
from tests.support.late import late
from tests.support.training_samples import SMALL, tiny, train, weights

pytestmark = pytest.mark.torch

halved = late("minidual.policies.halved")
tensor_files = late("safetensors.torch")


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("halved") / "checkpoint"
    train(tiny(), TrainConfig(**SMALL), 0, folder)
    return folder


def test_it_acts_alike_and_its_weights_take_half_the_bytes(
    checkpoint: Path,
    tmp_path: Path,
) -> None:
    folder = tmp_path / "half"
    halved.halve(checkpoint, folder)
    whole_bytes = (checkpoint / "model.safetensors").stat().st_size
    assert (folder / "model.safetensors").stat().st_size < 0.6 * whole_bytes
    rng = np.random.default_rng(0)
    whole, half = load_policy(checkpoint), load_policy(folder)
    for _ in range(3):
        images = {"high": rng.integers(0, 256, (12, 16, 3), dtype=np.uint8)}
        state = rng.normal(0.0, 1.0, 16).astype(np.float32)
        np.testing.assert_allclose(
            half.predict(images, state),
            whole.predict(images, state),
            atol=0.02,
        )


def test_a_weight_beyond_float16_is_refused(checkpoint: Path, tmp_path: Path) -> None:
    tensors = weights(checkpoint)
    name = sorted(tensors)[0]
    tensors[name] = tensors[name] * 0.0 + 1e6
    large = tmp_path / "large"
    large.mkdir()
    for path in checkpoint.iterdir():
        (large / path.name).write_bytes(path.read_bytes())
    tensor_files.save_file(tensors, large / "model.safetensors")
    with pytest.raises(DataError, match=f"'{name}' has 1e\\+06; float16 ends at 65504"):
        halved.halve(large, tmp_path / "half")
    assert not (tmp_path / "half").exists()
