"""Quality of demonstrations against motions whose answers are known."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from minidual.demos import quality
from minidual.demos.episode import read_episode
from minidual.errors import DataError
from minidual.robot.kinematics import Kinematics, path_length
from minidual.robot.pair import DUAL_PANDA
from tests.support import data_samples


def path_through(*points: tuple[float, float, float], ticks: int = 50) -> np.ndarray:
    legs = [np.linspace(a, b, ticks, endpoint=False) for a, b in itertools.pairwise(points)]
    return np.concatenate([*legs, np.array([points[-1]])])


def hands(left: np.ndarray, right: np.ndarray | None = None) -> np.ndarray:
    return np.stack([left, np.tile(left[0], (len(left), 1)) if right is None else right], axis=1)


def test_path_length_is_that_of_each_hand() -> None:
    positions = hands(path_through((0, 0, 0), (0.3, 0, 0), (0.3, 0.4, 0)))
    np.testing.assert_allclose(path_length(positions), [0.7, 0.0])


def test_efficiency_is_one_for_straight_legs_between_changes_of_grip_and_less_for_detours() -> None:
    legs = path_through((0, 0, 0), (0.3, 0, 0), (0.3, 0.4, 0))
    grip = np.zeros((len(legs), 2))
    assert quality.path_efficiency(hands(legs), grip) == pytest.approx(0.5 / 0.7)
    grip[50:, 0] = 1.0  # it grips at the corner, so the corner was where it had to go
    assert quality.path_efficiency(hands(legs), grip) == pytest.approx(1.0)
    there_and_back = path_through((0, 0, 0), (0.5, 0, 0), (0, 0, 0))
    assert quality.path_efficiency(hands(there_and_back), np.zeros((101, 2))) == pytest.approx(0.0)
    still = np.zeros((10, 2, 3))
    assert quality.path_efficiency(still, np.zeros((10, 2))) == 1.0


def test_grip_changes_are_the_crossings_of_the_middle() -> None:
    assert quality.grip_changes(np.array([0.0, 0.1, 0.9, 1.0, 1.0, 0.2, 0.0])) == [2, 5]
    assert quality.grip_changes(np.array([0.04, 0.04, 0.0, 0.0])) == [2]
    assert quality.grip_changes(np.full(5, 0.3)) == []


def test_tool_centres_of_the_home_posture_mirror_each_other() -> None:
    positions = quality.tcp_positions(np.tile(DUAL_PANDA.home, (3, 1)), Kinematics())
    assert positions.shape == (3, 2, 3)
    np.testing.assert_allclose(positions[0, 0] * [1, -1, 1], positions[0, 1], atol=1e-9)
    np.testing.assert_allclose(
        positions[0, 0, :2],
        [0.3068, 0.25],
        atol=0.01,
    )  # the Panda's ready posture


def test_the_measures_of_an_episode(tmp_path: Path) -> None:
    smooth = data_samples.arrays(100)
    rough = data_samples.arrays(100, seed=1)
    rough["qpos"] = rough["qpos"] + 0.02 * np.sin(2 * np.pi * 8 * rough["timestamps"])[:, None]
    paths = [
        data_samples.write(tmp_path / f"{i}.hdf5", data) for i, data in enumerate((smooth, rough))
    ]
    records = [quality.episode_quality(read_episode(path), Kinematics()) for path in paths]
    assert records[0].ticks == 100
    assert records[0].duration_s == pytest.approx(1.98)
    # Fourteen joints, 0.3 rad at 0.5 Hz; the record spans one period, so the mean of cos^2 is near a half.
    assert records[0].rms_jerk_rad_s3 == pytest.approx(
        np.sqrt(14) * 0.3 * np.pi**3 / np.sqrt(2),
        rel=0.1,
    )
    assert records[0].path_length_m > 0.1
    assert 0.0 < records[0].path_efficiency < 1.0
    assert records[0].cells_n > 1
    assert records[1].rms_jerk_rad_s3 > 2 * records[0].rms_jerk_rad_s3


def test_an_episode_too_short_for_a_jerk_is_refused(tmp_path: Path) -> None:
    path = data_samples.write(tmp_path / "e.hdf5", data_samples.arrays(10))
    with pytest.raises(DataError, match=r"at least 0.50 s"):
        quality.episode_quality(read_episode(path), Kinematics())
