"""A folder of episodes counts what is on the disk, and its repair deletes no recording."""

from __future__ import annotations

import os
from pathlib import Path

import data_samples
import pytest

from minidual.demos.episode import EpisodeWriter
from minidual.demos.schema import EpisodeMeta
from minidual.demos.store import QUARANTINE, EpisodeStore
from minidual.errors import DataError, UsageError

META = EpisodeMeta(fps=50.0, task="carry", seed=1, cameras=data_samples.CAMERAS)


@pytest.fixture
def store(tmp_path: Path) -> EpisodeStore:
    store = EpisodeStore(tmp_path / "episodes")
    for index, success in ((0, True), (1, False), (3, True)):
        data_samples.write(store.path(index), data_samples.arrays(6, seed=index), success=success)
    return store


def test_it_counts_what_is_on_the_disk(store: EpisodeStore) -> None:
    (store.folder / "notes.txt").touch()
    assert len(store) == 3
    assert store.indices() == [0, 1, 3]
    assert store.next_index() == 4
    assert store.missing(6) == [2, 4, 5]
    assert [path.name for path in store.paths()] == [f"episode_{i:06d}.hdf5" for i in (0, 1, 3)]
    assert store.paths(success=True) == [store.path(0), store.path(3)]
    assert store.paths(success=False) == [store.path(1)]
    assert [meta.success for meta in store.metas()] == [True, False, True]
    assert EpisodeStore(store.folder / "new").next_index() == 0


def test_a_writer_takes_the_next_index_or_a_free_one(store: EpisodeStore) -> None:
    data = data_samples.arrays(3)
    for index, expected in ((None, 4), (2, 2)):
        with store.writer(META, index) as writer:
            for k in range(3):
                writer.append(**data_samples.tick(data, k))
            assert writer.commit(success=True) == store.path(expected)
    with pytest.raises(UsageError, match="exists already"):
        store.writer(META, 0)


def test_repair_sets_broken_files_aside_and_removes_what_dead_writers_left(store: EpisodeStore) -> None:
    content = store.path(1).read_bytes()[:5000]
    store.path(1).write_bytes(content)
    dead = store.folder / ".episode_000009.hdf5.999999999.partial"
    dead.write_bytes(b"half")
    with pytest.raises(DataError, match=r"episode_000001\.hdf5"):
        store.paths(success=True)
    with EpisodeWriter(store.path(7), META, image_buffer_bytes=1) as writer:
        writer.append(**data_samples.tick(data_samples.arrays(3), 0))
        living = [path for path in store.folder.iterdir() if str(os.getpid()) in path.name]
        report = store.repair()
        assert living[0].exists()
    assert report.changed
    assert report.removed == (dead,)
    ((aside, reason),) = report.quarantined
    assert aside == store.folder / QUARANTINE / "episode_000001.hdf5"
    assert aside.read_bytes() == content
    assert "file_corrupt" in reason
    assert "file_corrupt" in (aside.parent / "episode_000001.hdf5.reason.txt").read_text()
    assert store.indices() == [0, 3]
    assert store.missing(4) == [1, 2]
    assert not store.repair().changed  # again: nothing left to do


def test_a_second_broken_file_of_the_same_name_is_kept_beside_the_first(store: EpisodeStore) -> None:
    for content in (b"one", b"two"):
        store.path(5).write_bytes(content)
        store.repair()
    folder = store.folder / QUARANTINE
    assert (folder / "episode_000005.hdf5").read_bytes() == b"one"
    assert (folder / "episode_000005.1.hdf5").read_bytes() == b"two"
    assert store.next_index() == 6


def test_repair_sets_aside_episodes_of_other_cameras(store: EpisodeStore) -> None:
    assert not store.repair(cameras=data_samples.CAMERAS).changed
    assert len(store.repair(cameras=("high",)).quarantined) == 3
    assert len(store) == 0
