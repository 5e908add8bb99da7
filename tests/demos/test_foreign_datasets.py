"""LeRobot v3 datasets that others made are read, or refused for what they are."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.demos.lerobot_features import camera_key, camera_name, entry_names, picture_shape
from minidual.demos.lerobot_reader import read_dataset
from minidual.demos.lerobot_video import colour_difference
from minidual.errors import DataError
from minidual.policies.demonstrations import load_demonstrations
from tests.support import foreign_datasets as foreign
from tests.support.foreign_datasets import ARM, EPISODES, TICKS, TOP

pytestmark = pytest.mark.torch


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One arm, joints named {"motors": [...]}, and a camera of another name."""
    return foreign.make(tmp_path_factory.mktemp("foreign") / "cups", foreign.one_arm())


@pytest.fixture
def copy(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "cups"))


def test_cameras_of_other_names_and_joints_in_groups_are_read(made: Path) -> None:
    tables = read_dataset(made)
    assert tables.cameras == {TOP: foreign.SIZE}
    assert tables.names == tables.action_names == ARM
    assert (len(tables), tables.fps, tables.info.robot) == (
        EPISODES * TICKS,
        20.0,
        "so100_follower",
    )
    images = tables.images(TOP)
    recorded = np.concatenate([foreign.pictures(episode, 0) for episode in range(EPISODES)])
    assert np.abs(images.astype(int) - recorded).mean() < 6.0


def test_actions_of_another_size_than_states_are_read(tmp_path: Path) -> None:
    features = foreign.one_arm()
    features["observation.state"] = foreign.vector(None, 9)
    features["action"] = foreign.vector({"x": 0, "y": 1, "gripper": 2}, 3)
    demos = load_demonstrations(foreign.make(tmp_path / "set", features), ())
    assert (demos.state_dim, demos.dim) == (9, 3)
    assert demos.takes is not None
    assert demos.takes.state[:2] == ("state_0", "state_1")
    assert demos.takes.action == ("x", "y", "gripper")
    assert demos.switching == [], "the opening is commanded and not measured"


def test_pictures_in_the_tables_are_read_as_they_were_recorded(tmp_path: Path) -> None:
    features = foreign.one_arm(**{TOP: foreign.camera(stored="image")})
    root = foreign.make(tmp_path / "set", features)
    assert not (root / "videos").exists()
    images = read_dataset(root).images(TOP)
    recorded = np.concatenate([foreign.pictures(episode, 0) for episode in range(EPISODES)])
    np.testing.assert_array_equal(images, recorded)


def test_shapes_with_channels_first_are_read(tmp_path: Path) -> None:
    front = "observation.images.front"
    cameras = {
        TOP: foreign.camera(channels_first=True),
        front: foreign.camera(stored="image", channels_first=True),
    }
    tables = read_dataset(foreign.make(tmp_path / "set", foreign.one_arm(**cameras)))
    assert tables.cameras == {TOP: foreign.SIZE, front: foreign.SIZE}
    assert tables.images(TOP).shape == tables.images(front).shape == (48, *foreign.SIZE, 3)


def test_flickering_light_is_no_other_picture(tmp_path: Path) -> None:
    root = foreign.make(tmp_path / "set", foreign.one_arm(), flicker=True)
    assert read_dataset(root).images(TOP).shape[0] == EPISODES * TICKS
    pictures = np.zeros((400, 4, 4, 3), np.uint8)
    pictures[::2] = 200
    every_other = np.full(3, 200 / 255)
    assert colour_difference(pictures, every_other) < 1e-9
    assert colour_difference(pictures, np.full(3, 0.9)) > 0.1, "no sample gives a brighter mean"
    assert colour_difference(pictures[::2], np.full(3, 0.3)) > 0.4, "steady light must agree"


def test_higher_pictures_are_scaled_down(made: Path) -> None:
    demos = load_demonstrations(made, (TOP,), height=16)
    assert demos.images[TOP].shape == (48, 16, 24, 3)
    assert demos.takes is not None
    assert demos.takes.cameras == {TOP: (16, 24)}


def test_what_is_not_read_is_named_and_the_rest_is_read(tmp_path: Path) -> None:
    features = foreign.one_arm()
    features["observation.effort"] = foreign.vector(None, 4)
    root = foreign.make(tmp_path / "set", features)
    foreign.change_info(
        root,
        lambda record: record["features"].update(
            {"observation.images.depth": {"dtype": "image", "shape": [32, 48, 1], "names": None}},
        ),
    )
    tables = read_dataset(root)
    assert list(tables.cameras) == [TOP]
    assert tables.info.unread == (
        "observation.effort (float32 [4])",
        "observation.images.depth (pictures without colour)",
    )


def _older(record: dict[str, Any]) -> None:
    record["codebase_version"] = "v2.1"


def _no_action(record: dict[str, Any]) -> None:
    del record["features"]["action"]


def _flat_state(record: dict[str, Any]) -> None:
    record["features"]["observation.state"]["shape"] = [2, 3]


def _elsewhere(record: dict[str, Any]) -> None:
    record["video_path"] = "films/{video_key}.mp4"


@pytest.mark.parametrize(
    ("change", "message", "remedy"),
    [
        (_older, r"version v2\.1; this program reads v3", "convert_dataset_v21_to_v30"),
        (_no_action, r"no feature 'action'; there are .*observation\.state", "rename a feature"),
        (_flat_state, r"'observation\.state' has the shape \[2, 3\]", "flatten it"),
        (_elsewhere, r"video_path is 'films/", "LeRobot's own layout"),
    ],
)
def test_what_no_policy_takes_is_refused_for_what_it_is(
    copy: Path,
    change: Any,
    message: str,
    remedy: str,
) -> None:
    foreign.change_info(copy, change)
    with pytest.raises(DataError, match=message) as caught:
        read_dataset(copy)
    assert "corrupt" not in caught.value.message
    assert remedy in str(caught.value.remedy)


def test_a_dataset_without_pictures_is_refused_for_that(tmp_path: Path) -> None:
    features = foreign.one_arm()
    del features[TOP]
    root = foreign.make(tmp_path / "set", features)
    with pytest.raises(DataError, match="no camera images") as caught:
        load_demonstrations(root, ())
    assert "--force" not in str(caught.value.remedy)


def test_the_remedy_of_a_damaged_dataset_of_others_is_not_to_teleoperate(copy: Path) -> None:
    film = next(copy.rglob("*.mp4"))
    film.write_bytes(film.read_bytes()[:200])
    with pytest.raises(DataError, match=r"\.mp4") as caught:
        read_dataset(copy).images(TOP)
    assert "data check" in str(caught.value.remedy)
    assert "teleop-record" not in str(caught.value.remedy)


def test_a_camera_has_one_name_and_one_feature() -> None:
    for key in ("observation.images.cam_high", TOP, "observation.image"):
        assert camera_key(camera_name(key)) == key
    assert camera_name("observation.images.cam_high") == "high"


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["a", "b"], ("a", "b")),
        ({"motors": ["a", "b"]}, ("a", "b")),
        ({"b": 1, "a": 0}, ("a", "b")),
        ({"left": ["j"], "right": ["j"]}, ("left.j", "right.j")),
        (None, ("state_0", "state_1")),
        (["state"], ("state_0", "state_1")),
        (["same", "same"], ("state_0", "state_1")),
    ],
)
def test_every_form_of_names_gives_one_name_an_entry(names: Any, expected: tuple[str, str]) -> None:
    assert entry_names("state", {"shape": [2], "names": names}) == expected


def test_the_sides_of_a_picture_are_told_by_its_channels() -> None:
    assert picture_shape({"shape": [3, 96, 128], "names": None}) == (96, 128, 3)
    assert picture_shape({"shape": [96, 128, 3], "names": ["channels", "height", "width"]}) == (
        96,
        128,
        3,
    )
    assert picture_shape({"shape": [3, 3, 3], "names": ["height", "width", "channels"]}) == (
        3,
        3,
        3,
    )
