"""Writing and reading one episode: round trip, refusals, and nothing half-written that passes for whole."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from minidual import durable
from minidual.demos import schema
from minidual.demos.episode import episode_paths, read_episode, read_meta
from minidual.demos.schema import EpisodeMeta
from minidual.demos.writer import EpisodeWriter
from minidual.errors import DataError, EnvironmentMissingError, UsageError
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


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        (
            "qpos",
            np.zeros(13),
            r"observations/qpos at tick 1 has shape \(13,\); it must be \(14,\)",
        ),
        ("action", np.full(14, np.nan), "action at tick 1 is NaN"),
        ("gripper", np.array([np.inf, 0]), "observations/gripper at tick 1"),
        ("action_gripper", None, "action_gripper is missing at tick 1"),
        ("timestamps", 0.5, "timestamps_not_monotonic"),
        ("timestamps", float("nan"), "timestamps at tick 1 is NaN"),
        ("qvel", None, "every tick or on none"),
        ("qpos", "left", "not numeric"),
    ],
)
def test_a_bad_tick_is_refused_where_it_happens(
    tmp_path: Path,
    field: str,
    value: object,
    words: str,
) -> None:
    data = data_samples.arrays(4)
    path = tmp_path / "e.hdf5"
    with EpisodeWriter(path, META) as writer:
        writer.append(**data_samples.tick(data, 0))
        with pytest.raises(DataError, match=words):
            writer.append(**{**data_samples.tick(data, 1), field: value})
        assert len(writer) == 1
        with pytest.raises(UsageError, match="no field 'timestamp'; there are action"):
            writer.append(**data_samples.tick(data, 1), timestamp=0.02)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["missing camera", "float", "grey", "other size"])
def test_bad_pictures_are_refused(tmp_path: Path, kind: str) -> None:
    data = data_samples.arrays(4)
    with EpisodeWriter(tmp_path / "e.hdf5", META) as writer:
        writer.append(**data_samples.tick(data, 0))
        bad = data_samples.tick(data, 1)
        image = bad["images"]["left"]
        if kind == "missing camera":
            del bad["images"]["left"]
        else:
            bad["images"]["left"] = {
                "float": image / 255.0,
                "grey": image[..., 0],
                "other size": image[:10],
            }[kind]
        with pytest.raises(DataError, match="left"):
            writer.append(**bad)


def test_an_action_that_is_the_measured_position_is_named_and_not_written(tmp_path: Path) -> None:
    data = data_samples.arrays()
    data["action"] = data["qpos"].copy()
    with pytest.raises(DataError, match="action_equals_qpos") as caught:
        data_samples.write(tmp_path / "e.hdf5", data)
    assert "command" in (caught.value.remedy or "")
    assert list(tmp_path.iterdir()) == []


def test_an_exception_or_a_missing_commit_leaves_nothing(tmp_path: Path) -> None:
    data = data_samples.arrays(8)
    writer = EpisodeWriter(tmp_path / "e.hdf5", META)

    def record() -> None:
        with writer:
            writer.append(**data_samples.tick(data, 0))
            assert list(tmp_path.iterdir()) != []  # the temporary file
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record()
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(DataError, match="closed"):
        writer.append(**data_samples.tick(data, 1))


def test_an_episode_of_one_tick_is_refused(tmp_path: Path) -> None:
    data = data_samples.arrays(5)
    data["timestamps"] = data["timestamps"][:1]
    with pytest.raises(DataError, match="too_short"):
        data_samples.write(tmp_path / "e.hdf5", data)
    assert list(tmp_path.iterdir()) == []


def test_an_existing_file_is_kept(tmp_path: Path) -> None:
    path = data_samples.write(tmp_path / "e.hdf5", data_samples.arrays(5))
    before = path.read_bytes()
    with pytest.raises(UsageError, match="exists already"):
        EpisodeWriter(path, META)
    assert path.read_bytes() == before


def test_a_disk_that_refuses_leaves_a_clear_error_and_no_file(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(path: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(durable, "sync", refuse)
    with pytest.raises(EnvironmentMissingError, match="No space left") as caught:
        data_samples.write(tmp_path / "e.hdf5", data_samples.arrays(5))
    assert "free some space" in (caught.value.remedy or "")
    assert list(tmp_path.iterdir()) == []


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


@pytest.mark.parametrize("moment", ["appending", "before rename"])
def test_a_killed_recording_loses_only_the_episode_in_progress(tmp_path: Path, moment: str) -> None:
    """SIGKILL between two ticks, and between the finished temporary file and its name."""
    script = f"""
import sys, time
sys.path.insert(0, {str(Path(__file__).parents[2])!r})
from tests.support import data_samples
from pathlib import Path
from minidual import durable
from minidual.demos.schema import EpisodeMeta
from minidual.demos.writer import EpisodeWriter
folder = Path({str(tmp_path)!r})
data = data_samples.arrays(30)
data_samples.write(folder / "episode_000000.hdf5", data)
def wait(*_):
    print("ready", flush=True)
    time.sleep(60)
meta = EpisodeMeta(fps=50.0, task="t", seed=1, cameras=data_samples.CAMERAS)
with EpisodeWriter(folder / "episode_000001.hdf5", meta) as writer:
    for k in range(30):
        writer.append(**data_samples.tick(data, k))
        if {moment!r} == "appending" and k == 20:
            wait()
    durable.publish = wait
    writer.finish(success=True)
    writer.publish()
"""
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline().strip() == "ready"
    names = {path.name for path in tmp_path.iterdir()}
    partial = next(path for path in tmp_path.iterdir() if path.name.endswith(".partial"))
    assert names == {"episode_000000.hdf5", partial.name}
    assert not durable.is_stale(partial)  # its writer lives
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()
    assert len(read_episode(tmp_path / "episode_000000.hdf5")) == 30
    assert not (tmp_path / "episode_000001.hdf5").exists()
    assert durable.is_stale(partial)


def test_a_reused_process_id_does_not_protect_a_dead_writers_file(tmp_path: Path) -> None:
    left = tmp_path / f".e.hdf5.{os.getpid()}.partial"
    left.touch()
    assert not durable.is_stale(left)
    long_ago = time.time() - 10 * 365 * 86400
    os.utime(left, (long_ago, long_ago))
    assert durable.is_stale(left)


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


def test_the_same_episode_gives_the_same_bytes(tmp_path: Path) -> None:
    first, second = (
        data_samples.write(tmp_path / name, data_samples.arrays()) for name in ("a.hdf5", "b.hdf5")
    )
    assert first.read_bytes() == second.read_bytes()


def test_a_disk_that_fills_while_recording_is_named_and_ends_no_process(tmp_path: Path) -> None:
    """HDF5 crashed the process (SIGSEGV, exit 139) at its end; the file limit stands for a full disk."""
    script = f"""
import resource, sys
sys.path.insert(0, {str(Path(__file__).parents[2])!r})
from tests.support import data_samples
from pathlib import Path
from minidual.errors import EnvironmentMissingError
resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, resource.RLIM_INFINITY))
try:
    data_samples.write(Path({str(tmp_path)!r}) / "e.hdf5", data_samples.arrays(20))
except EnvironmentMissingError as error:
    print(error)
"""
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    assert "no space left on the disk" in done.stdout
    assert "File too large" in done.stdout
    assert list(tmp_path.iterdir()) == []
