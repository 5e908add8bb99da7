"""A policy of other names is refused by name, before anything moves."""

from __future__ import annotations

from pathlib import Path

import pytest

from minidual.demos.lerobot_features import state_names
from minidual.errors import DataError, UsageError
from minidual.plant.cameras import CAMERAS
from minidual.policies.takes import (
    FILE,
    Takes,
    gripper_columns,
    read_takes,
    require_arms,
    require_scene,
    write_takes,
)
from minidual.robot.pair import DUAL_PANDA

NAMES = state_names(DUAL_PANDA)
OWN = Takes(
    state=NAMES,
    action=NAMES,
    cameras={"observation.images.cam_high": (96, 128)},
    rate_hz=50.0,
)
FOLDER = Path("checkpoint")


def test_a_policy_of_these_arms_and_cameras_is_taken() -> None:
    require_arms(OWN, FOLDER, DUAL_PANDA, CAMERAS)
    require_scene(OWN, FOLDER, (96, 128), 50.0)
    assert gripper_columns(NAMES) == [14, 15]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"state": ("shoulder_pan", "gripper")}, r"another state .*shoulder_pan, gripper \(2\)"),
        ({"action": ("x", "y")}, r"another action .*x, y \(2\), not left_panda_joint1"),
        ({"action": NAMES[::-1]}, "another action .*in another order"),
        (
            {"cameras": {"observation.images.top": (96, 128)}},
            r"camera 'observation\.images\.top'; there are high, left, right",
        ),
    ],
)
def test_other_joints_and_cameras_are_refused_by_name(changes: dict, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        require_arms(OWN.model_copy(update=changes), FOLDER, DUAL_PANDA, CAMERAS)


def test_other_pictures_and_another_rate_are_refused_with_both_numbers() -> None:
    with pytest.raises(UsageError, match=r"pictures of 96 x 128 .*here they are 480 x 640"):
        require_scene(OWN, FOLDER, (480, 640), 50.0)
    with pytest.raises(UsageError, match=r"at 50 Hz; the arms are commanded at 60 Hz"):
        require_scene(OWN, FOLDER, (96, 128), 60.0)


def test_what_is_written_is_read_and_damage_is_named(tmp_path: Path) -> None:
    assert read_takes(tmp_path) is None
    write_takes(OWN, tmp_path)
    assert read_takes(tmp_path) == OWN
    (tmp_path / FILE).write_text('{"state": []}')
    with pytest.raises(DataError, match=FILE):
        read_takes(tmp_path)
