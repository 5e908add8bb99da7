"""Arms of example-robot-data, and pairs of them, pass env-check or are refused by name."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from minidual.cli.app import run_command_line
from minidual.config.scene import SceneConfig
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.models import ARM_MODELS
from minidual.robot.pair import Robot
from minidual.stages.env_check.model import model_agreement
from minidual.stages.env_check.shapes import compare_shapes
from minidual.stages.registry import STAGES, TOOLS
from tests.support.real_arms import ARMS, Mounted, arm_model, model_of
from tests.support.urdf_files import add_to_table

PAIRS = (
    *((name, name) for name in ARMS if not name.endswith(("_left", "_right"))),
    ("baxter_left", "baxter_right"),
    ("tiago_pro_left", "tiago_pro_right"),
    ("g1_left", "g1_right"),
    ("panda", "ur5"),
    ("ur5", "panda"),
    ("panda", "xarm7"),
    ("xarm7", "ur5"),
    ("kinova", "ur10"),
)
"""Left and right arm: of one model, of one robot, and of different makers."""

UNFIT = {
    "icub": (
        Mounted("icub_description/robots/icub.urdf", "chest", "l_hand", (0.0, 0.2), ()),
        r"'l_wrist_pitch' moves link 'l_wrist_1', which has no mass or no inertia",
    ),
    "human": (
        Mounted("human_description/robots/human.urdf", "middle_thorax", "left_hand", (0, 0.2), ()),
        r"'left_shoulder_Z' moves link 'left_upperarm_virtual', which has no mass",
    ),
    "pr2": (
        Mounted(
            "pr2_description/urdf/pr2.urdf",
            "torso_lift_link",
            "l_wrist_roll_link",
            (0.0, 0.2),
            (),
            0.6,
        ),
        r"needs [0-9.]+ Nm to hold the arm and its hand 'panda_hand' at home; tau_max is",
    ),
    "torso_with_slide": (
        Mounted("pr2_description/urdf/pr2.urdf", "base_link", "l_wrist_roll_link", (0.0, 0.2), ()),
        r"joint 'torso_lift_joint' is of type 'prismatic'",
    ),
    "finger": (
        Mounted(
            "kinova_description/robots/kinova.urdf",
            "j2s6s200_link_base",
            "j2s6s200_link_finger_7",
            (0.0, 0.3),
            (),
        ),
        r"no link 'j2s6s200_link_finger_7'.*did you mean 'j2s6s200_link_finger_",
    ),
}
"""Arms that cannot be used, and what the message says."""


REFUSALS = r"leaves the (joint|velocity) limits: \w+|at home \w+ with \w+ are|\w+ needs [0-9.]+ Nm"
"""What env-check says of arms that are too slow, too near or too weak for it."""


def robot_of(left: str, right: str) -> Robot:
    models = [arm_model(name) if name in ARMS else ARM_MODELS[name] for name in (left, right)]
    return Robot(models[0], None if left == right else models[1])


def env_check(tmp_path: Path, left: str, right: str | None = None) -> int:
    words = ["env-check", "--profile", "smoke", "--json", "--runs-dir", str(tmp_path)]
    words += ["--set", f"robot.arm={left}", "--set", "env_check.sine_duration_s=2"]
    if right is not None:
        words += ["--set", f"robot.right_arm={right}"]
    return run_command_line(words, STAGES, TOOLS)


@pytest.mark.parametrize(("left", "right"), PAIRS, ids="+".join)
def test_both_engines_hold_one_description_of_a_pair(left: str, right: str) -> None:
    robot = robot_of(left, right)
    world = World(SceneConfig(), robot)
    kinematics = Kinematics(robot)
    assert tuple(kinematics.model.names)[1:] == robot.joint_names
    agreement = model_agreement(world, kinematics, np.random.default_rng(0), 2)
    assert max(agreement.values()) < 1e-10
    assert compare_shapes(world.model, robot).engines_max_m < 1e-5
    arms = [pair for pair in world.contact_pairs() if "rod" not in pair]
    assert arms == []


@pytest.mark.slow
@pytest.mark.parametrize(("left", "right"), PAIRS, ids="+".join)
def test_a_pair_passes_env_check_or_is_refused_by_name(
    left: str,
    right: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    add_to_table(monkeypatch, *(arm_model(name) for name in {left, right} & set(ARMS)))
    status = env_check(tmp_path, left, None if left == right else right)
    printed = capsys.readouterr()
    if status == 2:
        assert re.search(REFUSALS, " ".join(printed.err.split())), printed.err
        return
    checks = json.loads(printed.out)["verdict"]["checks"]
    assert [check["name"] for check in checks if check["passed"] is False] == []
    assert status == 0, printed.err


@pytest.mark.parametrize("name", UNFIT)
def test_an_arm_that_cannot_be_used_is_refused_by_name(
    name: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mounted, pattern = UNFIT[name]
    row = f"tests.support.unfit:{name}"
    monkeypatch.setattr(ARM_MODELS, "_rows", {**ARM_MODELS, name: row})
    monkeypatch.setattr(
        "minidual.registry.load_target",
        lambda _target: model_of(name, mounted),
    )
    assert env_check(tmp_path, name) == 2
    message = " ".join(capsys.readouterr().err.split())
    assert re.search(pattern, message), message
