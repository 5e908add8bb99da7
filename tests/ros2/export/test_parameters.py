"""YAML files: each name is one that a program of ROS 2 reads, each value minidual's own."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from minidual.config.root import Config
from minidual.robot.pair import DUAL_PANDA, SIDES
from minidual.ros2.names import PackageNames
from tests.support.ros2_names import TABLE, plugin_names, wrong_names

NAMES = PackageNames("dual_panda")
MOVEIT_FILES = {
    "kinematics.yaml": "kinematics",
    "joint_limits.yaml": "joint_limits",
    "ompl_planning.yaml": "ompl",
    "pilz_industrial_motion_planner_planning.yaml": "pilz",
    "pilz_cartesian_limits.yaml": "pilz_limits",
    "moveit_controllers.yaml": "moveit_controllers",
    "moveit_simple_controllers.yaml": "moveit_controllers",
}
CONTROLLER_FILES = ("ros2_controllers.yaml", "ros2_controllers_real.yaml")


def document(workspace: Path, package: str, file: str) -> dict:
    path = workspace / "src" / package / "config" / file
    return yaml.safe_load(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize(("file", "table"), MOVEIT_FILES.items())
def test_moveit_reads_every_name(workspace, file: str, table: str) -> None:
    content = document(workspace, NAMES.moveit, file)
    assert content
    assert wrong_names(content, TABLE[table]) == []
    assert plugin_names(content) <= set(TABLE["plugins"])


@pytest.mark.parametrize("file", CONTROLLER_FILES)
def test_ros2_control_reads_every_name(workspace, file: str) -> None:
    content = document(workspace, NAMES.bringup, file)
    manager = content.pop("controller_manager")["ros__parameters"]
    assert wrong_names(manager, TABLE["controller_manager"]) == []
    for name, section in content.items():
        assert (
            wrong_names(section["ros__parameters"], TABLE["controllers"][manager[name]["type"]])
            == []
        )
    types = {name: row["type"] for name, row in manager.items() if isinstance(row, dict)}
    assert set(types) == set(content)
    assert set(types.values()) <= set(TABLE["plugins"])


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("joint_limits.left_panda_joint1.max_jerks", 1.0, "max_jerks"),
        ("joint_limits.left_panda_joint1.max_jerk", 1, "max_jerk"),
        ("default_velocity_scaling_factor", "0.1", "default_velocity_scaling_factor"),
    ],
)
def test_a_misspelt_name_and_a_wrong_type_are_found(
    workspace,
    path: str,
    value: object,
    said: str,
) -> None:
    content = document(workspace, NAMES.moveit, "joint_limits.yaml")
    *folders, last = path.split(".")
    section = content
    for folder in folders:
        section = section[folder]
    section[last] = value
    (line,) = wrong_names(content, TABLE["joint_limits"])
    assert said in line


def test_an_unknown_plugin_is_found(workspace) -> None:
    content = document(workspace, NAMES.moveit, "ompl_planning.yaml")
    content["planning_plugins"] = ["ompl_interface/OmplPlanner"]
    assert plugin_names(content) - set(TABLE["plugins"]) == {"ompl_interface/OmplPlanner"}


def test_limits_are_the_arm_model_s(workspace) -> None:
    limits = document(workspace, NAMES.moveit, "joint_limits.yaml")["joint_limits"]
    for k, name in enumerate(DUAL_PANDA.joint_names):
        assert limits[name]["max_velocity"] == DUAL_PANDA.v_max[k]
        assert limits[name]["max_acceleration"] == DUAL_PANDA.a_max[k]
        assert limits[name]["max_jerk"] == DUAL_PANDA.jerk_max[k]
    assert set(limits) == {*DUAL_PANDA.joint_names, *DUAL_PANDA.finger_joint_names}


def test_every_group_has_planners_that_are_configured(workspace) -> None:
    content = document(workspace, NAMES.moveit, "ompl_planning.yaml")
    for group in ("left_arm", "right_arm", "both_arms", "left_hand", "right_hand"):
        assert set(content[group]["planner_configs"]) <= set(content["planner_configs"])


@pytest.mark.parametrize("file", CONTROLLER_FILES)
def test_controllers_have_the_tutorial_s_names_and_joints(workspace, file: str) -> None:
    content = document(workspace, NAMES.bringup, file)
    joints = list(DUAL_PANDA.joint_names)
    both = content["both_arms_controller"]["ros__parameters"]
    assert both["joints"] == joints
    for side in SIDES:
        own = content[f"{side}_arm_controller"]["ros__parameters"]["joints"]
        assert own == [joint for joint in joints if joint.startswith(f"{side}_")]
    assert content["controller_manager"]["ros__parameters"]["update_rate"] == 1000
    assert content["joint_state_broadcaster"]["ros__parameters"]["update_rate"] == 100
    assert content["arms_forward_controller"]["ros__parameters"]["joints"] == joints


def test_hardware_stops_what_does_not_follow(workspace) -> None:
    content = document(workspace, NAMES.bringup, "ros2_controllers_real.yaml")
    constraints = content["both_arms_controller"]["ros__parameters"]["constraints"]
    for k, joint in enumerate(DUAL_PANDA.joint_names):
        assert 0.0 < constraints[joint]["trajectory"] <= 0.1
        assert 0.0 < constraints[joint]["max_deceleration_on_cancel"] < DUAL_PANDA.a_max[k]


def test_fixed_controllers_have_disjoint_joints(workspace) -> None:
    content = document(workspace, NAMES.moveit, "moveit_simple_controllers.yaml")
    section = content["moveit_simple_controller_manager"]
    joints = [joint for name in section["controller_names"] for joint in section[name]["joints"]]
    assert len(joints) == len(set(joints))
    assert set(DUAL_PANDA.joint_names) <= set(joints)


def test_the_cameras_have_the_tutorial_s_topics(workspace) -> None:
    content = document(workspace, NAMES.bringup, "mujoco_plugins.yaml")
    plugin = content["/**"]["ros__parameters"]["mujoco_plugins"]["camera_plugin"]
    assert wrong_names(plugin, TABLE["camera_plugin"]) == []
    topics = [row["image_topic"] for row in plugin.values() if isinstance(row, dict)]
    assert topics == [f"/camera_{camera}/image_raw" for camera in ("high", "left", "right")]
    assert plugin["type"] in TABLE["plugins"]
    assert plugin["camera_publish_rate"] == 30.0


def test_impedance_parameters_are_the_configured_ones(workspace) -> None:
    gains = Config().carry.impedance
    content = document(workspace, NAMES.bringup, "impedance_params.yaml")
    section = content["/**"]["ros__parameters"]["object_impedance"]
    assert section["stiffness"] == [gains.stiffness_n_per_m] * 3 + [gains.stiffness_nm_per_rad] * 3
    assert section["internal_force"] == gains.internal_force_n


def test_rviz_shows_displays_that_exist(workspace) -> None:
    path = workspace / "src" / NAMES.moveit / "config" / "moveit.rviz"
    content = yaml.safe_load(path.read_text(encoding="utf-8"))["Visualization Manager"]
    for display in content["Displays"]:
        package, _, name = display["Class"].partition("/")
        if package == "rviz_default_plugins":
            assert name in TABLE["rviz_displays"]
        else:
            assert display["Class"] in TABLE["plugins"]
    assert content["Global Options"]["Fixed Frame"] == "world"
