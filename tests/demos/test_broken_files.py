"""Broken episodes, datasets and checkpoints are refused by name: no other error, no hang, no silent pass."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.config.learning import TrainConfig
from minidual.demos.episode import inspect_episode, read_episode
from minidual.errors import DataError
from minidual.policies.demonstrations import load_demonstrations
from minidual.policies.kinds import POLICIES, Training, load_policy
from minidual.robot.pair import DUAL_PANDA
from tests.support import broken_files, data_samples
from tests.support.broken_files import Break
from tests.support.late import late
from tests.support.training_samples import SMALL, tiny

lerobot_adapter = late("minidual.demos.lerobot_adapter")
pytestmark = pytest.mark.torch


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("sound")
    episode = data_samples.write(
        folder / "e.hdf5",
        data_samples.arrays(12, cameras=("high",), size=(32, 48)),
    )
    lerobot_adapter.convert([episode], folder / "dataset", DUAL_PANDA)
    POLICIES["spatial_act"].train(
        Training(tiny(), TrainConfig(**{**SMALL, "steps": 1}), 0),
        folder / "checkpoint",
    )
    return {"episode": episode, "dataset": folder / "dataset", "checkpoint": folder / "checkpoint"}


def refuse_episode(path: Path) -> None:
    """An inspection finds a fault, and a reader refuses the file."""
    _, faults = inspect_episode(path)
    assert faults
    read_episode(path)


READERS: dict[str, Callable[[Path], object]] = {
    "episode": refuse_episode,
    "dataset": lambda path: load_demonstrations(path, ()),
    "checkpoint": lambda path: load_policy(path, threads=1),
}
BREAKS = {
    "episode": broken_files.EPISODE,
    "dataset": broken_files.DATASET,
    "checkpoint": broken_files.CHECKPOINT,
}


def refused(kind: str, sound: Path, folder: Path, change: Break, seed: Sequence[int]) -> DataError:
    copy = folder / sound.name
    if sound.is_dir():
        shutil.copytree(sound, copy)
    else:
        shutil.copy(sound, copy)
    change(copy, np.random.default_rng(seed))
    with pytest.raises(DataError) as caught:
        READERS[kind](copy)
    return caught.value


def cases() -> Iterator[Any]:
    """Yield (kind, name); strange files in place of any but the first of a folder are slow."""
    strange = {change.__name__ for change in broken_files.FILES}
    for kind, breaks in BREAKS.items():
        for name in breaks:
            first = kind == "episode" or name.startswith(("info", "config.json"))
            slow = name.split()[-1] in strange and not first
            yield pytest.param(kind, name, marks=pytest.mark.slow if slow else ())


@pytest.mark.parametrize(("kind", "name"), list(cases()))
def test_a_broken_file_is_refused(
    sound: dict[str, Path],
    tmp_path: Path,
    kind: str,
    name: str,
) -> None:
    error = refused(kind, sound[kind], tmp_path, BREAKS[kind][name], (12, len(name)))
    assert sound[kind].name in error.message
    assert error.remedy or kind == "checkpoint"


@pytest.mark.parametrize("kind", BREAKS)
def test_the_same_files_unbroken_are_read(sound: dict[str, Path], kind: str) -> None:
    if kind == "episode":
        assert inspect_episode(sound[kind])[1] == []
    else:
        READERS[kind](sound[kind])
        assert sound[kind].is_dir()
