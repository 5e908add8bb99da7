"""Launch files, evaluated against stubs: which processes each would start."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import yaml

from minidual.ros2.export.templates import LAUNCH_FILES
from minidual.ros2.names import PackageNames
from tests.support.ros2_launch import Process, started

NAMES = PackageNames("dual_panda")
EXECUTABLES = {
    ("controller_manager", "ros2_control_node"),
    ("controller_manager", "spawner"),
    ("moveit_ros_move_group", "move_group"),
    ("mujoco_ros2_control", "ros2_control_node"),
    ("robot_state_publisher", "robot_state_publisher"),
    ("ros_gz_bridge", "parameter_bridge"),
    ("ros_gz_sim", "create"),
    ("ros_gz_sim", "gz_sim.launch.py"),
    ("rviz2", "rviz2"),
    ("", "minidual"),
    ("", "ros2"),
}
TUTORIAL_FILES = ("sim", "gazebo", "moveit", "teleop", "full_system")


def launched(workspace: Path, name: str, **arguments: str) -> list[Process]:
    return started(workspace, NAMES.bringup, f"{name}.launch.py", **arguments)


def programs(processes: list[Process]) -> list[tuple[str, str]]:
    return [(process.package, process.executable) for process in processes]


def spawned(processes: list[Process]) -> list[str]:
    """Return the controllers that are loaded; those loaded inactive in brackets."""
    names: list[str] = []
    for process in processes:
        if process.executable != "spawner":
            continue
        end = process.words.index("--controller-manager")
        inactive = "--inactive" in process.words
        names += [f"({word})" if inactive else word for word in process.words[:end]]
    return names


def test_the_tutorial_s_launch_files_are_there() -> None:
    assert set(TUTORIAL_FILES) <= set(LAUNCH_FILES)


@pytest.mark.parametrize("name", LAUNCH_FILES)
def test_it_starts_programs_that_exist_and_are_declared(workspace, name: str) -> None:
    processes = launched(workspace, name)
    assert processes
    assert set(programs(processes)) <= EXECUTABLES
    manifest = ET.parse(workspace / "src" / NAMES.bringup / "package.xml").getroot()
    needs = {element.text for element in manifest.findall("exec_depend")}
    assert {process.package for process in processes if process.package} <= needs


def test_simulation_starts_mujoco_and_all_controllers(workspace) -> None:
    processes = launched(workspace, "sim")
    assert ("mujoco_ros2_control", "ros2_control_node") in programs(processes)
    assert ("controller_manager", "ros2_control_node") not in programs(processes)
    assert spawned(processes) == [
        "joint_state_broadcaster",
        "both_arms_controller",
        "left_gripper_controller",
        "right_gripper_controller",
        "(left_arm_controller)",
        "(right_arm_controller)",
        "(arms_forward_controller)",
    ]


def test_mock_hardware_needs_no_mujoco(workspace) -> None:
    processes = launched(workspace, "sim", hardware="mock")
    assert ("controller_manager", "ros2_control_node") in programs(processes)
    assert all(package != "mujoco_ros2_control" for package, _ in programs(processes))


def test_hardware_that_does_not_exist_is_refused(workspace) -> None:
    with pytest.raises(AssertionError, match="hardware:=isaac is not in"):
        launched(workspace, "control", hardware="isaac")


@pytest.mark.parametrize("name", ["control", "gazebo"])
def test_controllers_that_start_are_configured(workspace, name: str) -> None:
    path = workspace / "src" / NAMES.bringup / "config" / "ros2_controllers.yaml"
    manager = yaml.safe_load(path.read_text(encoding="utf-8"))["controller_manager"]
    configured = {name for name, row in manager["ros__parameters"].items() if isinstance(row, dict)}
    names = [word.strip("()") for word in spawned(launched(workspace, name))]
    assert sorted(names) == sorted(configured)


def test_two_active_controllers_never_claim_one_joint(workspace) -> None:
    path = workspace / "src" / NAMES.bringup / "config" / "ros2_controllers.yaml"
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    claimed: list[str] = []
    for name in spawned(launched(workspace, "sim")):
        parameters = content.get(name, {}).get("ros__parameters", {})
        claimed += parameters.get("joints", [])
        claimed += [parameters["joint"]] if "joint" in parameters else []
    assert len(claimed) == len(set(claimed)) > 0


def test_joint_commands_reach_the_forward_controller(workspace) -> None:
    words = [word for process in launched(workspace, "sim") for word in process.words]
    assert "-r /arms_forward_controller/commands:=/joint_commands" in words


def test_moveit_reads_the_files_of_its_package(workspace) -> None:
    (move_group, rviz) = launched(workspace, "moveit")
    parameters, *_ = move_group.parameters
    assert parameters["robot_description_kinematics"].keys() == {"left_arm", "right_arm"}
    assert "both_arms" in parameters["robot_description_semantic"]
    assert "ompl_planning" in parameters
    assert Path(rviz.words[1]).is_file()
    assert programs(launched(workspace, "moveit", rviz="false")) == [
        ("moveit_ros_move_group", "move_group"),
    ]


def test_teleoperation_starts_the_bridge_and_records(workspace) -> None:
    bridge, bag = launched(workspace, "teleop", task="pot_lift")
    assert bridge.executable == "minidual"
    assert bridge.words[:3] == ("bridge", "--task", "pot_lift")
    assert {"/joint_states", "/teleop/joint_target", "/mode_switch"} <= set(bag.words)
    assert len(launched(workspace, "teleop", record="false")) == 1


def test_the_full_system_has_one_source_of_joint_states(workspace) -> None:
    with_minidual = launched(workspace, "full_system")
    assert ("", "minidual") in programs(with_minidual)
    assert "joint_state_broadcaster" not in spawned(with_minidual)
    with_mujoco = launched(workspace, "full_system", hardware="mujoco")
    assert ("", "minidual") not in programs(with_mujoco)
    assert "joint_state_broadcaster" in spawned(with_mujoco)


def test_hardware_gets_its_own_controllers_file_and_no_grippers(workspace) -> None:
    processes = launched(workspace, "full_system", hardware="franka", left_robot_ip="172.16.0.2")
    (node,) = (process for process in processes if process.executable == "ros2_control_node")
    assert any(
        getattr(item, "name", "") == "ros2_controllers_real.yaml" for item in node.parameters
    )
    assert not [name for name in spawned(processes) if "gripper" in name]
    descriptions = [
        item["robot_description"]
        for process in processes
        if process.executable == "robot_state_publisher"
        for item in process.parameters
        if "robot_description" in item
    ]
    assert any(re.search(r"left_robot_ip:=172\.16\.0\.2\b", text) for text in descriptions)


def test_an_undeclared_argument_is_found(workspace) -> None:
    with pytest.raises(AssertionError, match="declares no argument speed"):
        launched(workspace, "sim", speed="2")
