"""Broken goal, scene and mesh files of `plan --to`: each is refused by name, at once, with exit code 2."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from minidual.cli.app import run_command_line
from minidual.collision.scene_file import load_scene
from minidual.errors import MinidualError
from minidual.motion.goal import goal_of
from minidual.motion.goal_plan import GoalPlanner
from minidual.robot.pair import DUAL_PANDA
from minidual.stages.registry import STAGES, TOOLS
from tests.support.panda import HOME

NAMES = list(DUAL_PANDA.joint_names)
GOOD = json.dumps({"joint_names": NAMES, "q_rad": [HOME.tolist()]})


def text(content: str) -> Callable[[Path], None]:
    return lambda path: path.write_text(content) and None


def huge(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(3 * 1024**3)


FILES = [
    (
        "goal.json",
        text(GOOD.replace(repr(HOME[0]), "NaN", 1).replace("[[0.0", "[[NaN", 1)),
        "finite",
    ),
    (
        "goal.json",
        text(json.dumps({"joint_names": NAMES, "q_rad": [[1e300] * 14]})),
        "= 1e+300|e+30|rad; its limits",
    ),
    (
        "goal.json",
        text(json.dumps({"joint_names": NAMES, "q_rad": [[0.0] * 13]})),
        "is no trajectory",
    ),
    ("goal.json", text(json.dumps({"joint_names": NAMES, "q_rad": []})), "is no trajectory"),
    ("goal.json", text(json.dumps({"joint_names": [[]], "q_rad": [[0.0]]})), "is no trajectory"),
    ("goal.json", text(json.dumps({"joint_names": ["elbow"], "q_rad": [[0.0]]})), "elbow"),
    ("goal.json", text("[" * 100_000), "is not JSON"),
    ("goal.json", text(""), "is not JSON"),
    ("goal.json", os.mkfifo, "is a FIFO, not a file"),
    ("goal.json", os.mkdir, "is a folder, not a file"),
    ("goal.json", lambda path: path.symlink_to("/dev/zero"), "is a device, not a file"),
    ("goal.json", huge, "holds 3,221,225,472 bytes; at most"),
    ("goal.yaml", huge, "holds 3,221,225,472 bytes; at most"),
    ("goal.yaml", os.mkfifo, "is a FIFO, not a file"),
    ("goal.yaml", text("joints_rad: [0, 0]"), "14"),
    ("goal.yaml", text("joints_rad: [1.0e+300, 0, 0, 0, 0, 0, 0]"), "out of range"),
    (
        "goal.yaml",
        text("joints_rad: [1.0e+18, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]"),
        "its limits are",
    ),
    (
        "goal.yaml",
        text("poses: {left: {position_m: [1.0e+9, 0, 0]}}"),
        "goal.yaml:1: poses.left.position_m.0: must be",
    ),
    ("goal.yaml", text("poses: {left: {position_m: [0.5, 0.2]}}"), "position_m"),
    (
        "goal.yaml",
        text("move: {left: {rotation_rad: [180, 0, 0]}}"),
        "goal.yaml:1: move.left.rotation_rad.0: must be",
    ),
    ("goal.yaml", text("&a [*a]"), "aliases are not read here"),
    (f"{'x' * 5000}.yaml", lambda path: None, "File name too long"),
]


@pytest.mark.parametrize(("name", "make", "says"), FILES)
def test_a_broken_goal_is_named(
    tmp_path: Path,
    name: str,
    make: Callable[[Path], object],
    says: str,
) -> None:
    make(tmp_path / name)
    began = time.process_time()
    with pytest.raises(MinidualError) as caught:
        _planner().start_joints("both_arms", HOME, goal_of(str(tmp_path / name), ()))
    assert caught.value.exit_code == 2
    assert any(part in str(caught.value) for part in says.split("|")), str(caught.value)
    assert len(str(caught.value)) < 6000
    assert time.process_time() - began < 5.0


def _planner(found: list[GoalPlanner] = []) -> GoalPlanner:  # noqa: B006 - one for all
    found or found.append(GoalPlanner())
    return found[0]


MESH = "obstacles: [{name: part, shape: mesh, file: %s, position_m: [0.5, 0, 0.2]}]"
SCENES = [
    (
        text(
            "obstacles: [{name: post, shape: box, position_m: [0.4, 0, 1.0e+12], size_m: [1, 1, 1]}]",
        ),
        "less than or equal",
    ),
    (
        text("obstacles: [{name: post, shape: box, position_m: [0.4, 0, 0.1], size_m: [1, 1]}]"),
        "size_m",
    ),
    (text("allowed: [{pair: [a], reason: b}]"), "allowed.0.pair"),
    (text(MESH % "pipe.stl"), "pipe.stl is a FIFO, not a file"),
    (text(MESH % "huge.stl"), "huge.stl holds 3,221,225,472 bytes"),
    (text(MESH % "zero.stl"), "zero.stl is a device, not a file"),
    (os.mkfifo, "is a FIFO, not a file"),
    (huge, "holds 3,221,225,472 bytes"),
    (os.mkdir, "is a folder, not a file"),
]


@pytest.mark.parametrize(("make", "says"), SCENES)
def test_a_broken_scene_is_named(tmp_path: Path, make: Callable[[Path], object], says: str) -> None:
    os.mkfifo(tmp_path / "pipe.stl")
    huge(tmp_path / "huge.stl")
    (tmp_path / "zero.stl").symlink_to("/dev/zero")
    make(tmp_path / "scene.yaml")
    with pytest.raises(MinidualError) as caught:
        load_scene(tmp_path / "scene.yaml")
    assert caught.value.exit_code == 2
    assert says in str(caught.value)


def test_the_good_goal_is_read(tmp_path: Path) -> None:
    (tmp_path / "goal.json").write_text(GOOD)
    goal = goal_of(str(tmp_path / "goal.json"), ())
    assert np.allclose(_planner().start_joints("both_arms", HOME, goal), HOME)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--profile", "~nobody-here/mine.yaml"), "no profile file"),
        (("--profile", "x" * 5000 + ".yaml"), "File name too long"),
    ],
)
def test_a_strange_profile_name_is_named(
    words: tuple[str, ...],
    says: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run_command_line(["config", "show", *words], STAGES, TOOLS) == 2
    assert says in capsys.readouterr().err


def test_an_unknown_home_is_a_folder_of_that_name(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINIDUAL_RUNS", "~nobody-here/runs")
    assert run_command_line(["status"], STAGES, TOOLS) == 0
    assert "~nobody-here/runs" in capsys.readouterr().out.replace("\n", "")
