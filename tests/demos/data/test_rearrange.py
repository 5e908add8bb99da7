"""Demonstrations are joined and divided, and each result is read again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from minidual.demos.data.check import check_data
from minidual.demos.data.lerobot_source import LeRobotSource
from minidual.demos.data.places import open_data
from minidual.demos.data.rearrange import drawn_parts, merge, parsed_shares, split
from minidual.demos.episode import read_episode
from minidual.demos.lerobot_features import is_own
from minidual.demos.lerobot_reader import read_dataset
from minidual.errors import UsageError
from minidual.robot.pair import DUAL_PANDA
from tests.support import aloha_files, data_samples, foreign_datasets
from tests.support.foreign_datasets import TICKS, TOP

TICKS_OWN = 8


def record(folder: Path, count: int, first_seed: int = 0, **options: object) -> Path:
    for k in range(count):
        data = data_samples.arrays(
            TICKS_OWN,
            seed=first_seed + k,
            size=(32, 32),
            cameras=("high",),
            **options,  # type: ignore[arg-type]
        )
        data_samples.write(folder / "episodes" / f"episode_{k:06d}.hdf5", data, **options)
    return folder


@pytest.mark.torch
def test_recordings_become_one_recording_and_parts_of_it(tmp_path: Path) -> None:
    sources = [
        open_data(str(record(tmp_path / name, count, seed)), DUAL_PANDA)
        for name, count, seed in (("a", 2, 0), ("b", 1, 9))
    ]
    assert merge(sources, tmp_path / "both", DUAL_PANDA) == 3
    whole = open_data(str(tmp_path / "both"), DUAL_PANDA)
    assert len(whole) == 3
    assert len(read_dataset(tmp_path / "both" / "lerobot")) == 3 * TICKS_OWN
    last = read_episode(tmp_path / "both" / "episodes" / "episode_000002.hdf5", cameras=())
    first = read_episode(tmp_path / "b" / "episodes" / "episode_000000.hdf5", cameras=())
    np.testing.assert_array_equal(last.qpos, first.qpos)
    split(whole, {"train": [0, 2], "test": [1]}, tmp_path / "parts", DUAL_PANDA)
    assert len(read_dataset(tmp_path / "parts" / "train" / "lerobot")) == 2 * TICKS_OWN
    assert len(open_data(str(tmp_path / "parts" / "test"), DUAL_PANDA)) == 1
    with pytest.raises(UsageError, match="parts exists already"):
        split(whole, {"train": [0]}, tmp_path / "parts", DUAL_PANDA)


@pytest.mark.torch
def test_datasets_of_others_become_one_and_parts_of_it(tmp_path: Path) -> None:
    root = foreign_datasets.make(tmp_path / "cups", foreign_datasets.one_arm())
    source = LeRobotSource(root)
    assert check_data(source) == []
    assert merge([source, source], tmp_path / "twice", DUAL_PANDA) == 4
    twice = read_dataset(tmp_path / "twice")
    assert (len(twice.starts), len(twice)) == (4, 4 * TICKS)
    assert not is_own(tmp_path / "twice")
    np.testing.assert_array_equal(twice.state[: 2 * TICKS], twice.state[2 * TICKS :])
    images = twice.images(TOP)
    assert np.abs(images[:TICKS].astype(int) - images[2 * TICKS : 3 * TICKS]).max() <= 1
    whole = LeRobotSource(tmp_path / "twice")
    split(whole, {"one": [3], "rest": [0, 1, 2]}, tmp_path / "parts", DUAL_PANDA)
    part = LeRobotSource(tmp_path / "parts" / "one")
    np.testing.assert_array_equal(part.tables.state, twice.state[3 * TICKS :])
    assert check_data(part) == []
    texts = [found.episode.task for found in part.episodes() if found.episode is not None]
    assert texts == ["stack the cups"]


@pytest.mark.torch
def test_files_of_aloha_become_a_dataset(tmp_path: Path) -> None:
    (tmp_path / "aloha").mkdir()
    for k in range(2):
        aloha_files.write(tmp_path / "aloha" / f"episode_{k}.hdf5", seed=k, jpeg=bool(k))
    source = open_data(str(tmp_path / "aloha"), DUAL_PANDA)
    assert merge([source], tmp_path / "new", DUAL_PANDA) == 2
    tables = read_dataset(tmp_path / "new" / "lerobot")
    assert tables.names[:2] == ("left_waist", "left_shoulder")
    assert sorted(tables.cameras) == ["high", "left_wrist"]
    assert tables.info.unread == ("observation.effort (float32 [14])",)
    found = next(iter(source.episodes())).episode
    assert found is not None
    np.testing.assert_array_equal(tables.state[: len(found)], found.state.astype(np.float32))


def test_other_formats_are_refused_with_what_differs(tmp_path: Path) -> None:
    slow = open_data(str(record(tmp_path / "slow", 1, fps=25.0)), DUAL_PANDA)
    fast = open_data(str(record(tmp_path / "fast", 1)), DUAL_PANDA)
    with pytest.raises(UsageError, match=r"has 50 Hz, .* has 25 Hz; one dataset has one format"):
        merge([fast, slow], tmp_path / "out", DUAL_PANDA)
    assert not (tmp_path / "out").exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fast", "slow"]


def test_parts_are_drawn_by_the_seed_and_never_overlap() -> None:
    parts = drawn_parts(parsed_shares("train=0.8,test=0.2"), 10, seed=4)
    assert {name: len(of) for name, of in parts.items()} == {"train": 8, "test": 2}
    assert sorted(parts["train"] + parts["test"]) == list(range(10))
    assert parts == drawn_parts({"train": 0.8, "test": 0.2}, 10, seed=4)
    assert parts != drawn_parts({"train": 0.8, "test": 0.2}, 10, seed=5)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("train", "type NAME=SHARE"),
        ("train=1,train=0.1", "no name of its own"),
        ("../x=0.5", "no name of its own"),
        ("train=0.9,test=0.2", "together at most 1"),
        ("train=-0.1", "above 0"),
        ("train=0.99,test=0.01", "'test' of 0.01 has no episode"),
    ],
)
def test_parts_that_cannot_be_drawn_are_refused(text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        drawn_parts(parsed_shares(text), 10, seed=0)
