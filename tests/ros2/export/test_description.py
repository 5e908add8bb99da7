"""The exported URDF is minidual's own model: in Pinocchio, in MuJoCo, and as xacro expands it."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from minidual.config.scene import RobotConfig
from minidual.robot.description import pair_urdf
from minidual.robot.pair import DUAL_PANDA, SIDES, Robot, robot_from
from minidual.ros2.export.description import urdf
from minidual.ros2.export.hardware import hardware_names
from minidual.ros2.export.meshes import MeshFiles
from minidual.ros2.names import PackageNames, workspace_names
from tests.support.ros2_models import (
    Bodies,
    canonical,
    differences,
    expanded,
    in_mujoco,
    in_pinocchio,
    with_mesh_files,
)
from tests.support.ros2_names import TABLE

TOLERANCE = 1e-9
NAMES = PackageNames("dual_panda")
ROBOTS = [robot_from(RobotConfig(arm=name)) for name in ("panda", "xarm7", "ur5")]
ROBOTS.append(robot_from(RobotConfig(arm="panda", right_arm="ur5")))
each_robot = pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name)


def exported(robot: Robot) -> tuple[str, MeshFiles]:
    names = workspace_names(robot)
    meshes = MeshFiles(names.description)
    return ET.tostring(urdf(robot, meshes, names), encoding="unicode"), meshes


def posture(robot: Robot, seed: int) -> dict[str, float]:
    rng = np.random.default_rng(seed)
    q = rng.uniform(robot.q_lower, robot.q_upper)
    fingers = rng.uniform(0.0, robot.hand.travel_m, len(robot.finger_joint_names))
    names = (*robot.joint_names, *robot.finger_joint_names)
    return dict(zip(names, (*q, *fingers), strict=True))


@each_robot
def test_pinocchio_reads_minidual_s_own_bodies(robot: Robot) -> None:
    text, _ = exported(robot)
    for seed in range(3):
        positions = posture(robot, seed)
        own = in_pinocchio(pair_urdf(robot), positions)
        assert len(own.poses) > robot.dof
        assert differences(own, in_pinocchio(text, positions), TOLERANCE) == []


@each_robot
def test_mujoco_and_pinocchio_read_the_same_bodies(robot: Robot, tmp_path) -> None:
    text, meshes = exported(robot)
    package = workspace_names(robot).description
    meshes.copy_to(tmp_path / "src" / package)
    positions = posture(robot, 7)
    read = with_mesh_files(text, tmp_path)
    pieces = in_mujoco(read, positions, by_joint=True)
    pieces.poses.pop("world", None)
    assert differences(in_pinocchio(text, positions), pieces, TOLERANCE) == []
    links = in_mujoco(read, positions)
    assert len(links.masses) > robot.dof
    assert differences(in_mujoco(pair_urdf(robot), positions), links, TOLERANCE) == []


@each_robot
def test_the_limits_are_those_that_the_planner_keeps(robot: Robot) -> None:
    text, _ = exported(robot)
    joints = {joint.get("name"): joint for joint in ET.fromstring(text).iter("joint")}
    for k, name in enumerate(robot.joint_names):
        limit = joints[name].find("limit")
        assert float(limit.get("lower")) == robot.q_lower[k]
        assert float(limit.get("upper")) == robot.q_upper[k]
        assert float(limit.get("velocity")) == robot.v_max[k]
        assert float(limit.get("effort")) == robot.tau_max[k]


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        (r'(<mass value=")([\d.]+)', "masses"),
        (r'(ixx=")([\d.]+)', "inertias"),
        (r'(<origin xyz="0 0 )(0\.\d+)', "poses"),
        (r'(lower=")(-?[\d.]+)', "limits"),
    ],
)
def test_a_number_that_is_off_by_a_millionth_is_found(wrong: str, field: str) -> None:
    text, _ = exported(DUAL_PANDA)
    changed = re.sub(wrong, lambda m: f"{m[1]}{float(m[2]) + 1e-6!r}", text, count=1)
    if field == "poses":
        changed = text.replace('xyz="0.0 0.25 0.0"', 'xyz="0.0 0.250001 0.0"')
    assert changed != text
    positions = posture(DUAL_PANDA, 1)
    found = differences(in_pinocchio(text, positions), in_pinocchio(changed, positions), TOLERANCE)
    assert any(line.startswith(field) for line in found)


def test_a_missing_body_is_found() -> None:
    text, _ = exported(DUAL_PANDA)
    whole = in_pinocchio(text, {})
    short = Bodies(*(dict(list(field.items())[1:]) for field in whole))
    assert any("is in one only" in line for line in differences(whole, short, TOLERANCE))


def test_xacro_expands_to_the_urdf(workspace) -> None:
    folder = workspace / "src" / NAMES.description / "urdf"
    tree = expanded(workspace, folder / "dual_panda.urdf.xacro", hardware="none")
    assert canonical(tree) == canonical(ET.parse(folder / "dual_panda.urdf").getroot())


def test_the_file_that_moveit_reads_is_the_same_robot(workspace) -> None:
    folder = workspace / "src" / NAMES.description / "urdf"
    own = expanded(workspace, folder / "dual_panda.urdf.xacro", hardware="none")
    config = workspace / "src" / NAMES.moveit / "config" / "dual_panda.urdf.xacro"
    assert canonical(expanded(workspace, config, hardware="none")) == canonical(own)


@pytest.mark.parametrize("hardware", hardware_names(DUAL_PANDA))
def test_hardware_has_known_plugins_parameters_and_all_joints(workspace, hardware: str) -> None:
    file = workspace / "src" / NAMES.description / "urdf" / "dual_panda.urdf.xacro"
    tree = expanded(workspace, file, hardware=hardware, left_robot_ip="172.16.0.2")
    systems = tree.findall("ros2_control")
    joints = [joint for system in systems for joint in system.findall("joint")]
    names = [joint.get("name") for joint in joints]
    commanded = [j.get("name") for j in joints if j.find("command_interface") is not None]
    fingers = () if hardware == "franka" else DUAL_PANDA.finger_joint_names
    leading = [name for name in fingers if name.endswith("joint1")]
    assert sorted(names) == sorted((*DUAL_PANDA.joint_names, *fingers))
    assert sorted(commanded) == sorted((*DUAL_PANDA.joint_names, *leading))
    for system in systems:
        known = TABLE["hardware"][system.find("hardware/plugin").text]
        unknown = {p.get("name") for p in system.findall("hardware/param")} - set(known)
        assert unknown == set()
    mimic = {j.get("name") for j in tree.findall("joint") if j.find("mimic") is not None}
    assert mimic.isdisjoint(commanded), "ros2_control refuses a command to a joint that follows"


def test_each_arm_of_a_franka_has_its_own_controller_box(workspace) -> None:
    file = workspace / "src" / NAMES.description / "urdf" / "dual_panda.urdf.xacro"
    tree = expanded(
        workspace,
        file,
        hardware="franka",
        left_robot_ip="172.16.0.2",
        right_robot_ip="172.16.0.3",
    )
    addresses = {}
    for system in tree.findall("ros2_control"):
        parameters = {p.get("name"): p.text for p in system.findall("hardware/param")}
        addresses[parameters["prefix"]] = parameters["robot_ip"]
    assert addresses == {"left_": "172.16.0.2", "right_": "172.16.0.3"}


def test_gazebo_loads_the_controllers_of_the_package(workspace) -> None:
    file = workspace / "src" / NAMES.description / "urdf" / "dual_panda.urdf.xacro"
    plugin = expanded(workspace, file, hardware="gazebo").find("gazebo/plugin")
    known = TABLE["gazebo_plugin"]
    assert (plugin.get("filename"), plugin.get("name")) == (known["filename"], known["name"])
    assert {child.tag for child in plugin} <= set(known["elements"])
    parameters = plugin.find("parameters").text
    assert parameters == f"{workspace}/src/{NAMES.bringup}/config/ros2_controllers.yaml"
    assert (workspace / parameters).is_file()


def test_every_mesh_is_in_the_package(workspace) -> None:
    folder = workspace / "src" / NAMES.description
    text = (folder / "urdf" / "dual_panda.urdf").read_text(encoding="utf-8")
    addresses = re.findall(r'filename="([^"]+)"', text)
    visuals = [address for address in addresses if "/visual/" in address]
    assert len(visuals) == 2 * 11  # eight links, a hand and two fingers an arm
    for address in addresses:
        place = address.removeprefix(f"package://{NAMES.description}/")
        assert place != address
        assert (folder / place).stat().st_size > 0


def test_meshes_of_one_name_stay_apart(tmp_path) -> None:
    meshes = MeshFiles("package")
    for folder in ("hand", "arm"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "link.stl").write_text(folder)
    first = meshes.place("visual", tmp_path / "hand" / "link.stl")
    second = meshes.place("visual", tmp_path / "arm" / "link.stl")
    assert (first, second) == ("meshes/visual/link.stl", "meshes/visual/arm_link.stl")
    assert meshes.place("visual", tmp_path / "hand" / "link.stl") == first
    meshes.copy_to(tmp_path / "out")
    assert (tmp_path / "out" / second).read_text() == "arm"


def test_sides_are_prefixes(workspace) -> None:
    file = workspace / "src" / NAMES.description / "urdf" / "dual_panda.urdf"
    links = [link.get("name") for link in ET.parse(file).getroot().iter("link")]
    named = [link for link in links if link and link != "world" and link.count("panda")]
    prefixes = {link.partition("_")[0] for link in named}
    assert prefixes == set(SIDES)
