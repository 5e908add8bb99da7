"""Reading one episode: round trip, and files that are refused."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from minidual.demos.episode import episode_paths, read_episode, read_meta
from minidual.demos.schema import EpisodeMeta
from minidual.demos.writer import EpisodeWriter
from minidual.errors import DataError
from tests.support import data_samples

META = EpisodeMeta(fps=50.0, task="carry", seed=1, cameras=data_samples.CAMERAS)


def test_everything_written_is_read_back_exactly(tmp_path: Path) -> None:
    data = data_samples.arrays()
    data["image_timestamps"] = data["timestamps"] + 0.004
    path = tmp_path / "new" / "episode_000000.hdf5"
    data_samples.write(path, data, seed=7, extra={"failure": "none", "start_m": [0.5, 0.25]})
    episode = read_episode(path)
    for key in (
        "qpos",
        "qvel",
        "gripper",
        "action",
        "action_gripper",
        "timestamps",
        "image_timestamps",
    ):
        np.testing.assert_array_equal(getattr(episode, key), data[key], err_msg=key)
    assert list(episode.images) == list(data_samples.CAMERAS)
    for camera, frames in data["images"].items():
        np.testing.assert_array_equal(episode.images[camera], frames)
    assert episode.meta == EpisodeMeta(
        fps=50.0,
        task="carry the rod",
        seed=7,
        cameras=data_samples.CAMERAS,
        sim=True,
        success=True,
        extra={"failure": "none", "start_m": [0.5, 0.25]},
    )
    assert len(episode) == 40
    assert episode.timestamps[-1] - episode.timestamps[0] == pytest.approx(39 / 50)
    assert list(path.parent.iterdir()) == [path]


def test_pictures_come_back_in_order_and_one_camera_can_be_read(tmp_path: Path) -> None:
    data = data_samples.arrays(23)
    path = tmp_path / "e.hdf5"
    with EpisodeWriter(path, META) as writer:
        for k in range(23):
            writer.append(**data_samples.tick(data, k))
        writer.finish(success=True)
        writer.publish()
    episode = read_episode(path, cameras=["left"])
    assert list(episode.images) == ["left"]
    np.testing.assert_array_equal(episode.images["left"], data["images"]["left"])


def test_optional_fields_may_be_absent_and_no_camera_is_allowed(tmp_path: Path) -> None:
    data = data_samples.arrays(6)
    del data["qvel"]
    data["images"] = {}
    episode = read_episode(data_samples.write(tmp_path / "e.hdf5", data))
    assert episode.qvel is None
    assert episode.image_timestamps is None
    assert episode.images == {}


@pytest.mark.parametrize("kept", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_named(tmp_path: Path, kept: float) -> None:
    path = data_samples.write(tmp_path / "e.hdf5", data_samples.arrays())
    whole = path.read_bytes()
    path.write_bytes(whole[: int(kept * len(whole))])
    for reader in (read_episode, read_meta):
        with pytest.raises(DataError, match=r"e\.hdf5.*truncated or corrupt"):
            reader(path)


def test_wrong_shapes_missing_fields_and_versions_are_named(tmp_path: Path) -> None:
    def spoil(change: object) -> Path:
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}.hdf5"
        data_samples.write(path, data_samples.arrays(6))
        with h5py.File(path, "r+") as file:
            change(file)  # type: ignore[operator]
        return path

    def shrink(file: h5py.File) -> None:
        del file["action"]
        file["action"] = np.zeros((6, 7))

    def drop_field(file: h5py.File) -> None:
        del file["observations/gripper"]

    def drop_attribute(file: h5py.File) -> None:
        del file.attrs["fps"]

    def newer(file: h5py.File) -> None:
        file.attrs["schema_version"] = 99

    for change, words in (
        (shrink, r"action is float64 \(6, 7\); it must be float64 \(6, 14\)"),
        (drop_field, "observations/gripper is missing"),
        (drop_attribute, "missing attributes: fps"),
        (newer, "schema version 99"),
    ):
        with pytest.raises(DataError, match=words):
            read_episode(spoil(change))
    with pytest.raises(DataError, match="no episode file"):
        read_episode(tmp_path / "absent.hdf5")
    with pytest.raises(DataError, match="no camera top; there are high, left, right"):
        read_episode(spoil(lambda file: None), cameras=["top"])


def test_finished_episodes_of_a_folder_come_in_order(tmp_path: Path) -> None:
    for index in (3, 0, 11):
        data_samples.write(
            tmp_path / f"episode_{index:06d}.hdf5",
            data_samples.arrays(3),
            extra={"trial": index},
        )
    (tmp_path / ".episode_000001.hdf5.99.partial").touch()
    (tmp_path / "notes.txt").touch()
    assert [read_meta(path).trial for path in episode_paths(tmp_path)] == [0, 3, 11]
