"""Demonstrations of any origin are found, read, checked and counted."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from minidual.demos.data.aloha import NAMES
from minidual.demos.data.check import check_data
from minidual.demos.data.places import open_data
from minidual.demos.data.stats import data_stats, entry_rows, stats_lines
from minidual.errors import NothingEvaluatedError, UsageError
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA
from tests.support import aloha_files, data_samples

SIZE = (24, 32)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """A recording of two episodes, the arms at home, swaying."""
    for k in range(2):
        write(tmp_path / "recording" / "episodes" / f"episode_{k:06d}.hdf5", k)
    return tmp_path / "recording"


def write(path: Path, seed: int, **changes: Any) -> Path:
    data = data_samples.arrays(seed=seed, cameras=("high", "left"))
    for key in ("qpos", "action"):
        data[key] = DUAL_PANDA.home + 0.3 * data[key]
    data |= changes
    extra = {"start_x_y_yaw": [0.4 + 0.1 * seed, -0.1, 0.2 * seed]}
    return data_samples.write(path, data, extra=extra)


@pytest.fixture
def aloha(tmp_path: Path) -> Path:
    (tmp_path / "aloha").mkdir()
    aloha_files.write(tmp_path / "aloha" / "episode_0.hdf5")
    aloha_files.write(tmp_path / "aloha" / "episode_1.hdf5", seed=1, jpeg=True)
    return tmp_path / "aloha"


def faults_of(path: Path) -> list[str]:
    findings = check_data(open_data(str(path), DUAL_PANDA))
    return [f"{finding.episode} {finding.fault.name}" for finding in findings]


def test_a_sound_recording_has_no_fault_and_is_found_by_each_of_its_names(recording: Path) -> None:
    for place in (recording, recording / "episodes"):
        source = open_data(str(place), DUAL_PANDA)
        assert (source.kind, len(source), source.cameras()) == (
            "HDF5 episodes",
            2,
            ("high", "left"),
        )
        assert check_data(source) == []
    assert len(open_data(str(recording / "episodes" / "episode_000001.hdf5"), DUAL_PANDA)) == 1


def test_what_is_no_demonstration_is_said(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="there is nothing at"):
        open_data(str(tmp_path / "nowhere"), DUAL_PANDA)
    with pytest.raises(UsageError, match="holds no demonstrations"):
        open_data(str(tmp_path), DUAL_PANDA)


def test_damaged_and_swapped_episodes_are_named(recording: Path) -> None:
    episodes = recording / "episodes"
    broken = episodes / "episode_000002.hdf5"
    broken.write_bytes((episodes / "episode_000000.hdf5").read_bytes()[:3000])
    data = data_samples.arrays(seed=3, cameras=("high", "left"))
    images = {"high": data["images"]["left"], "left": data["images"]["high"]}
    for k in (3, 4):
        write(episodes / f"episode_{k:06d}.hdf5", k)
    write(episodes / "episode_000005.hdf5", 5, images=images)
    assert faults_of(recording) == [
        "episode_000002.hdf5 file_corrupt",
        "episode_000005.hdf5 cameras_swapped",
        "episode_000005.hdf5 cameras_swapped",
    ]


def test_files_of_aloha_are_read_with_pictures_as_arrays_or_as_jpeg(aloha: Path) -> None:
    source = open_data(str(aloha), DUAL_PANDA)
    assert source.kind == "ALOHA HDF5 episodes"
    found = [each.episode for each in source.episodes()]
    assert all(episode is not None for episode in found)
    first = found[0]
    assert first is not None
    assert first.state_names == NAMES
    assert (first.rate_hz, first.state.shape, first.duration_s) == (50.0, (30, 14), 0.58)
    pictures = dict(source.pictures("cam_high"))
    expected = np.stack([aloha_files.picture(k, 0) for k in range(aloha_files.TICKS)])
    np.testing.assert_array_equal(pictures[0], expected)
    assert np.abs(pictures[1].astype(int) - expected).mean() < 10.0, "JPEG, in the same colours"
    assert check_data(source) == []


def _nan(file: h5py.File) -> None:
    file["observations/qpos"][3, 2] = np.nan


def _still(file: h5py.File) -> None:
    file["action"][:] = 0.5


def _same(file: h5py.File) -> None:
    file["action"][:] = file["observations/qpos"][()]


def _jump(file: h5py.File) -> None:
    file["observations/qpos"][20:, 3] += 6.28


def _short(file: h5py.File) -> None:
    for key in ("action", "observations/qpos"):
        rows = file[key][:1]
        del file[key]
        file[key] = rows
    del file["observations/images"]


def _fewer(file: h5py.File) -> None:
    rows = file["action"][:10]
    del file["action"]
    file["action"] = rows


def _black(file: h5py.File) -> None:
    file["observations/images/cam_high"][5] = 0


def _twice(file: h5py.File) -> None:
    file["observations/images/cam_left_wrist"][:] = file["observations/images/cam_high"][()]


def _frozen(file: h5py.File) -> None:
    pictures = file["observations/images/cam_high"]
    pictures[:] = np.repeat(pictures[:1], len(pictures), axis=0)


def _text(file: h5py.File) -> None:
    del file["observations/qpos"]
    file["observations/qpos"] = np.array([[b"no"]])


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (_nan, "not_finite"),
        (_still, "nothing_moves"),
        (_same, "action_equals_qpos"),
        (_jump, "state_jumps"),
        (_short, "too_short"),
        (_fewer, "field_wrong"),
        (_black, "images_black"),
        (_twice, "cameras_identical"),
        (_frozen, "images_frozen"),
        (_text, "field_wrong"),
    ],
)
def test_each_fault_of_a_file_of_aloha_has_its_name(
    aloha: Path,
    change: Callable[[h5py.File], None],
    fault: str,
) -> None:
    with h5py.File(aloha / "episode_0.hdf5", "r+") as file:
        change(file)
    (aloha / "episode_1.hdf5").unlink()
    assert faults_of(aloha) == [f"episode_0.hdf5 {fault}"]


def test_the_numbers_of_a_recording_are_those_of_its_episodes(recording: Path) -> None:
    stats, rows = data_stats(open_data(str(recording), DUAL_PANDA), Kinematics(DUAL_PANDA))
    assert (stats.episodes_n, stats.ticks_n, stats.rates_hz) == (2, 80, (50.0,))
    assert stats.durations_s == pytest.approx((0.78, 0.78, 0.78))
    assert stats.successes_n == 2
    assert stats.cells_n is not None
    assert stats.cells_n >= 2
    np.testing.assert_allclose(stats.starts, [(0.4, 0.5), (-0.1, -0.1), (0.0, 0.2)])
    assert [row["episode"] for row in rows] == ["episode_000000.hdf5", "episode_000001.hdf5"]
    text = "\n".join(stats_lines(stats))
    assert "duration: 0.8 to 0.8 s" in text
    assert "recorded as a success: 2 of 2" in text
    first = stats.entries[0]
    assert first.low < DUAL_PANDA.home[0] < first.high
    assert entry_rows(stats)[0]["effort peak"] == "not recorded"


def test_efforts_and_other_arms_are_counted_as_what_they_are(aloha: Path) -> None:
    stats, rows = data_stats(open_data(str(aloha), DUAL_PANDA), Kinematics(DUAL_PANDA))
    assert stats.cells_n is None, "the hands of other arms are not followed"
    assert stats.successes_n is None
    assert max(entry.effort_peak for entry in stats.entries) == pytest.approx(10.0, rel=0.02)
    assert rows[0]["effort_peak"] == pytest.approx(10.0, rel=0.02)


def test_efforts_and_forces_of_this_program_are_kept(tmp_path: Path) -> None:
    effort = np.full((40, 14), -7.0)
    data = data_samples.arrays(cameras=("high",))
    from minidual.demos.schema import EpisodeMeta
    from minidual.demos.writer import EpisodeWriter

    wrench = np.zeros((40, 2, 6))
    wrench[7, 1] = (3.0, 0.0, 4.0, 90.0, 0.0, 0.0)
    meta = EpisodeMeta(fps=50.0, task="carry", seed=1, cameras=("high",))
    with EpisodeWriter(tmp_path / "e.hdf5", meta) as writer:
        for k in range(40):
            writer.append(**data_samples.tick(data, k), effort=effort[k], hand_wrench=wrench[k])
        writer.finish(success=True)
        writer.publish()
    stats, rows = data_stats(
        open_data(str(tmp_path / "e.hdf5"), DUAL_PANDA),
        Kinematics(DUAL_PANDA),
    )
    assert stats.entries[0].effort_peak == 7.0
    assert stats.force_peaks_n == {"left hand": 0.0, "right hand": 5.0}
    assert "force peaks: left hand 0.0 N, right hand 5.0 N" in stats_lines(stats)
    assert np.isnan(stats.entries[15].effort_peak), "an opening has no torque"
    assert (rows[0]["effort_peak"], rows[0]["force_peak_n"]) == (7.0, 5.0)


def test_nothing_readable_has_no_numbers(recording: Path) -> None:
    for path in (recording / "episodes").iterdir():
        path.write_bytes(b"")
    with pytest.raises(NothingEvaluatedError, match="none of 2 episodes"):
        data_stats(open_data(str(recording), DUAL_PANDA), Kinematics(DUAL_PANDA))
    shutil.rmtree(recording)
