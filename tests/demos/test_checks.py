"""Each fault of an episode file is found by name, and a sound file has none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from minidual.demos.checks import Thumbnails, camera_references, check_swapped, thumbnails
from minidual.demos.episode import inspect_episode, read_episode
from minidual.errors import DataError
from minidual.robot.pair import DUAL_PANDA, Robot
from tests.support import data_samples

PER_JOINT = ("joints", "home", "q_lower", "q_upper", "v_max", "a_max", "jerk_max", "tau_max")
Spoil = Callable[[h5py.File], Any]


def posed(data: dict[str, Any]) -> dict[str, Any]:
    """Bring the sample motion inside the joint limits."""
    middle = (DUAL_PANDA.q_lower + DUAL_PANDA.q_upper) / 2
    return {**data, "qpos": data["qpos"] + middle, "action": data["action"] + middle}


def names(path: Path, **options: Any) -> list[str]:
    faults = inspect_episode(path, **options)[1]
    assert all(fault.detail and fault.remedy for fault in faults)
    return [fault.name for fault in faults]


def references(paths: list[Path]) -> Thumbnails:
    return camera_references([thumbnails(read_episode(path).images) for path in paths])


def spoiled(tmp_path: Path, change: Spoil) -> Path:
    path = data_samples.write(tmp_path / "e.hdf5", data_samples.arrays())
    with h5py.File(path, "r+") as file:
        change(file)
    return path


def replaced(key: str, values: Any) -> Spoil:
    def change(file: h5py.File) -> None:
        if key in file:
            del file[key]
        file[key] = values

    return change


def test_a_sound_episode_has_no_fault(tmp_path: Path) -> None:
    data = posed(data_samples.arrays())
    data["image_timestamps"] = data["timestamps"] + 0.019
    path = data_samples.write(tmp_path / "e.hdf5", data)
    assert names(path, cameras=data_samples.CAMERAS, robot=DUAL_PANDA) == []
    assert list(check_swapped(thumbnails(data["images"]), references([path]))) == []


def test_a_missing_or_truncated_file(tmp_path: Path) -> None:
    assert names(tmp_path / "absent.hdf5") == ["file_missing"]
    path = data_samples.write(tmp_path / "e.hdf5", data_samples.arrays())
    whole = path.read_bytes()
    for kept in (0, 100, len(whole) // 2, len(whole) - 100):
        path.write_bytes(whole[:kept])
        (fault,) = inspect_episode(path)[1]
        assert fault.name == "file_corrupt"
        assert "e.hdf5" in fault.detail


@pytest.mark.parametrize("key", ["observations/qpos", "observations/images/left"])
def test_a_flipped_bit_is_noticed(tmp_path: Path, key: str) -> None:
    path = data_samples.write(tmp_path / "e.hdf5", data_samples.arrays())
    with h5py.File(path) as file:
        chunk = file[key].id.get_chunk_info(0)
    content = bytearray(path.read_bytes())
    content[chunk.byte_offset + chunk.size // 2] ^= 0x10
    path.write_bytes(content)
    assert names(path) == ["file_corrupt"]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda f: f.attrs.__delitem__("task"), ["attributes_wrong"]),
        (lambda f: f.attrs.__setitem__("schema_version", 2), ["attributes_wrong"]),
        (lambda f: f.attrs.__setitem__("cameras", "high,left"), ["attributes_wrong"]),
        (lambda f: f.__delitem__("action"), ["field_missing"]),
        (lambda f: f.__delitem__("timestamps"), ["field_missing"]),
        (replaced("observations/qpos", np.zeros((40, 7))), ["field_wrong"] * 2),
        (replaced("action_gripper", np.zeros((39, 2))), ["field_wrong"]),
        (replaced("observations/gripper", np.array([[b"a", b"b"]] * 40)), ["field_wrong"]),
        (replaced("observations/images/left", np.zeros((40, 8, 8), np.uint8)), ["field_wrong"]),
        (
            replaced("observations/images/left", np.zeros((40, 8, 8, 3), np.float32)),
            ["field_wrong"],
        ),
        (lambda f: f.__delitem__("observations/images/left"), ["cameras_wrong"]),
        (lambda f: f.attrs.__setitem__("num_timesteps", "many"), ["attributes_wrong"]),
        (lambda f: (f.__delitem__("action"), f.create_group("action")), ["field_wrong"]),
        (
            lambda f: (
                f.__delitem__("observations/images/left"),
                f.create_group("observations/images/left"),
            ),
            ["field_wrong"],
        ),
        (
            lambda f: f.move("observations/images/left", "observations/images/top"),
            ["cameras_wrong"],
        ),
        (lambda f: f.attrs.__setitem__("num_timesteps", 39), ["field_wrong"] * 9),
        (lambda f: f["observations/qvel"].__setitem__((7, 3), np.nan), ["not_finite"]),
        (lambda f: f["timestamps"].__setitem__(9, 0.5), ["timestamps_not_monotonic"]),
        (
            lambda f: f["action"].__setitem__(..., f["observations/qpos"][()]),
            ["action_equals_qpos"],
        ),
    ],
)
def test_structural_faults(tmp_path: Path, change: Spoil, expected: list[str]) -> None:
    path = spoiled(tmp_path, change)
    assert names(path) == expected
    if expected[0] not in ("not_finite", "timestamps_not_monotonic", "action_equals_qpos"):
        with pytest.raises(DataError, match=r"e\.hdf5"):
            read_episode(path)


def test_an_action_that_equals_the_reading_now_and_then_is_sound(tmp_path: Path) -> None:
    data = data_samples.arrays()
    data["action"][:20] = data["qpos"][:20]
    assert names(data_samples.write(tmp_path / "e.hdf5", data)) == []


def test_camera_names_and_order_are_held_to_the_expected_ones(tmp_path: Path) -> None:
    path = data_samples.write(tmp_path / "e.hdf5", data_samples.arrays())
    assert names(path, cameras=("high", "right", "left")) == ["cameras_wrong"]
    assert names(path, cameras=("high",)) == ["cameras_wrong"]


def test_swapped_and_identical_cameras(tmp_path: Path) -> None:
    sound = [
        data_samples.write(tmp_path / f"{i}.hdf5", data_samples.arrays(seed=i)) for i in range(3)
    ]
    seen = references(sound)
    data = data_samples.arrays(seed=9)
    images = data["images"]
    data["images"] = {"high": images["high"], "left": images["right"], "right": images["left"]}
    path = data_samples.write(tmp_path / "swapped.hdf5", data)
    assert names(path) == []  # nothing inside one file can tell
    faults = list(check_swapped(thumbnails(data["images"]), seen))
    assert [fault.name for fault in faults] == ["cameras_swapped", "cameras_swapped"]
    assert "camera 'left' shows what 'right' shows" in faults[0].detail
    data["images"] = {**images, "left": images["right"]}
    assert names(data_samples.write(tmp_path / "same.hdf5", data)) == ["cameras_identical"]
    assert list(check_swapped(thumbnails(images), seen)) == []


def test_jitter_and_wrong_rate(tmp_path: Path) -> None:
    data = data_samples.arrays()
    late = {**data, "timestamps": data["timestamps"].copy()}
    late["timestamps"][20:] += 0.011
    (fault,) = inspect_episode(data_samples.write(tmp_path / "late.hdf5", late))[1]
    assert fault.name == "timestamps_jitter"
    assert "31.0 ms at tick 19" in fault.detail
    slight = {**data, "timestamps": data["timestamps"].copy()}
    slight["timestamps"][20:] += 0.009
    assert names(data_samples.write(tmp_path / "slight.hdf5", slight)) == []
    slow = {**data, "timestamps": data["timestamps"] * 1.05}
    assert names(data_samples.write(tmp_path / "slow.hdf5", slow)) == ["rate_wrong"]


def test_pictures_more_than_20_ms_from_the_joints(tmp_path: Path) -> None:
    data = data_samples.arrays()
    data["image_timestamps"] = data["timestamps"] + np.where(np.arange(40) == 13, 0.0195, 0.005)
    assert names(data_samples.write(tmp_path / "near.hdf5", data)) == []
    data["image_timestamps"] = data["timestamps"] + np.where(np.arange(40) == 13, 0.0215, 0.005)
    (fault,) = inspect_episode(data_samples.write(tmp_path / "far.hdf5", data))[1]
    assert fault.name == "out_of_sync"
    assert "21.5 ms from the joints (tick 13)" in fault.detail


def test_a_joint_outside_its_limits(tmp_path: Path) -> None:
    data = posed(data_samples.arrays())
    data["qpos"][11, 10] = DUAL_PANDA.q_upper[10] + 0.01
    path = data_samples.write(tmp_path / "e.hdf5", data)
    (fault,) = inspect_episode(path, robot=DUAL_PANDA)[1]
    assert fault.name == "outside_joint_limits"
    assert "joint index 10 is at -0.0598 rad at tick 11" in fault.detail
    arm = replace(DUAL_PANDA.arm, **{name: getattr(DUAL_PANDA.arm, name)[:6] for name in PER_JOINT})
    (fault,) = inspect_episode(path, robot=Robot(arm))[1]
    assert fault.name == "joints_wrong"
    assert "holds 14 joints; the arms panda have 12" in fault.detail


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (lambda frames: frames[5].fill(3), "images_black"),
        (lambda frames: frames[5].fill(90), "images_constant"),
        (lambda frames: frames.__setitem__(slice(None), frames[0].copy()), "images_frozen"),
    ],
)
def test_pictures_that_carry_nothing(
    tmp_path: Path,
    spoil: Callable[[np.ndarray], None],
    expected: str,
) -> None:
    data = data_samples.arrays()
    spoil(data["images"]["left"])
    (fault,) = inspect_episode(data_samples.write(tmp_path / "e.hdf5", data))[1]
    assert fault.name == expected
    assert "camera 'left'" in fault.detail


def test_a_still_picture_of_still_arms_is_sound(tmp_path: Path) -> None:
    data = data_samples.arrays()
    data["qpos"] = np.tile(data["qpos"][0], (40, 1))
    for frames in data["images"].values():
        frames[:] = frames[0]
    assert names(data_samples.write(tmp_path / "e.hdf5", data)) == []
