"""The workspace as a whole, and the command that writes it."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from minidual.cli.app import run_command_line
from minidual.config.root import Config
from minidual.config.scene import RobotConfig
from minidual.errors import UsageError
from minidual.robot.pair import DUAL_PANDA, robot_from
from minidual.ros2.export.markup import NOT_RUN
from minidual.ros2.export.workspace import export_workspace
from minidual.ros2.names import PackageNames
from minidual.stages.registry import STAGES, TOOLS
from tests.support.documents import ROOT

MESHES = {".stl", ".dae", ".obj"}


def text_files(workspace: Path) -> list[Path]:
    files = [path for path in workspace.rglob("*") if path.is_file()]
    return [p for p in files if p.suffix not in MESHES and not p.name.startswith("LICENSE")]


def test_every_file_says_that_it_was_not_run_and_how_it_was_checked(workspace) -> None:
    files = text_files(workspace)
    assert len(files) > 25
    for path in files:
        head = path.read_text(encoding="utf-8")[:700]
        assert NOT_RUN in head, path
        if path.name != "README.md":
            assert re.search(r"Checked: [a-zA-Z]", head), path


def test_the_readme_lists_each_of_them(workspace) -> None:
    readme = (workspace / "README.md").read_text(encoding="utf-8")
    section = readme.split("## Not run under ROS 2")[1]
    listed = set(re.findall(r"^- `([^`]+)`", section, re.MULTILINE))
    files = {path.relative_to(workspace).as_posix() for path in text_files(workspace)}
    assert listed == files - {"README.md"}


def test_the_page_lists_what_was_not_run() -> None:
    page = (ROOT / "docs" / "ros2.md").read_text(encoding="utf-8")
    assert "## Not run under ROS 2" in page


def test_each_package_installs_folders_that_exist_and_names_itself(workspace) -> None:
    names = PackageNames("dual_panda")
    for package in names.packages:
        folder = workspace / "src" / package
        manifest = ET.parse(folder / "package.xml").getroot()
        assert manifest.find("name").text == package
        assert manifest.find("export/build_type").text == "ament_cmake"
        cmake = (folder / "CMakeLists.txt").read_text(encoding="utf-8")
        assert f"project({package})" in cmake
        (installed,) = re.findall(r"DIRECTORY (.+)", cmake)
        for word in installed.split():
            assert (folder / word).is_dir()
        own = {element.text for element in manifest.findall("exec_depend")} & set(names.packages)
        earlier = names.packages[: names.packages.index(package)]
        assert own <= set(earlier)


def test_no_path_of_this_machine_is_in_it(workspace) -> None:
    for path in text_files(workspace):
        text = path.read_text(encoding="utf-8")
        assert "site-packages" not in text, path
        assert str(Path.home()) not in text, path


def test_a_folder_with_files_is_not_overwritten(tmp_path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(UsageError, match="exists and is not empty"):
        export_workspace(DUAL_PANDA, Config(), tmp_path)
    with pytest.raises(UsageError, match="there is no folder"):
        export_workspace(DUAL_PANDA, Config(), tmp_path / "deep" / "ws")
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_the_command_writes_it_and_names_what_it_wrote(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_command_line(["export", "ros2", "--out", "ws", "--json"], STAGES, TOOLS) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["packages"] == list(PackageNames("dual_panda").packages)
    assert all((tmp_path / "ws" / path).is_file() for path in document["files"])
    assert document["allowed_collisions"] > 0


def test_the_command_names_the_arms_that_exist(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["export", "ros2", "--out", "ws", "--arm", "pandas"]
    assert run_command_line(words, STAGES, TOOLS) == 2
    said = capsys.readouterr().err
    assert "no arm 'pandas'" in said
    assert "did you mean 'panda'?" in said
    assert list(tmp_path.glob("ws*")) == []


@pytest.mark.slow
@pytest.mark.parametrize("arm", ["xarm7", "ur5"])
def test_other_arms_are_exported_without_franka_hardware(arm: str, tmp_path) -> None:
    config = Config(robot=RobotConfig(arm=arm))
    export = export_workspace(robot_from(config.robot), config, tmp_path / "ws")
    assert export.packages == PackageNames(f"dual_{arm}").packages
    for path in text_files(export.folder):
        assert "franka_hardware" not in path.read_text(encoding="utf-8")
    assert not list(export.folder.rglob("*_real.yaml"))
