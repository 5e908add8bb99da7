"""The published layout of an episode, and the metadata that fits it."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from minidual.demos import schema
from minidual.demos.schema import EpisodeMeta
from minidual.errors import DataError
from tests.support import data_samples

META = EpisodeMeta(fps=50.0, task="carry", seed=1, cameras=data_samples.CAMERAS)


def test_the_file_has_the_published_keys_and_attributes(tmp_path: Path) -> None:
    path = data_samples.write(tmp_path / "e.hdf5", data_samples.arrays(5), success=False)
    with h5py.File(path) as file:
        assert file["observations/qpos"].shape == (5, 14)
        assert file["observations/gripper"].shape == (5, 2)
        assert file["observations/images/high"].dtype == np.uint8
        assert file["action"].shape == (5, 14)
        assert file["action_gripper"].shape == (5, 2)
        assert file["timestamps"].shape == (5,)
        assert file.attrs["num_timesteps"] == 5
        assert not file.attrs["success"]
        assert file.attrs["sim"]


def test_episode_facts_that_could_not_be_stored_are_refused() -> None:
    for bad in (
        {"fps": 0.0},
        {"fps": float("nan")},
        {"cameras": ("a", "a")},
        {"cameras": ("a/b",)},
    ):
        with pytest.raises(DataError):
            EpisodeMeta(**{"fps": 50.0, "task": "t", "seed": 0, "cameras": ("high",), **bad})
    for extra in ({"x": float("nan")}, {"x": np.float32(1)}, {"x": Path()}):
        with pytest.raises(DataError, match="plain JSON"):
            EpisodeMeta(fps=50.0, task="t", seed=0, cameras=("high",), extra=extra)
    assert EpisodeMeta(fps=50.0, task="t", seed=0, cameras=(), extra={"trial": 7}).trial == 7
    with pytest.raises(DataError, match="names no trial"):
        _ = META.trial
    assert schema.MAX_SYNC_S == 0.02
