"""Writing one episode: bad ticks are refused, and nothing half-written passes for whole."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from minidual import durable
from minidual.demos.episode import read_episode
from minidual.demos.schema import EpisodeMeta
from minidual.demos.writer import EpisodeWriter
from minidual.errors import DataError, EnvironmentMissingError, UsageError
from tests.support import data_samples

META = EpisodeMeta(fps=50.0, task="carry", seed=1, cameras=data_samples.CAMERAS)


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


def test_the_same_episode_gives_the_same_bytes(tmp_path: Path) -> None:
    first, second = (
        data_samples.write(tmp_path / name, data_samples.arrays()) for name in ("a.hdf5", "b.hdf5")
    )
    assert first.read_bytes() == second.read_bytes()


def test_a_disk_that_fills_while_recording_is_named_and_ends_no_process(tmp_path: Path) -> None:
    """HDF5 would crash the process at its end; the limit of a file stands for a full disk."""
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
