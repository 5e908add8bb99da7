"""Text of the files that are filled in from templates: launch files, package files, README."""

import functools
from collections.abc import Sequence
from importlib import resources
from typing import Any, NamedTuple

import jinja2

import minidual
from minidual.plant.cameras import CAMERAS
from minidual.robot.pair import SIDES, Robot
from minidual.ros2 import names as topics
from minidual.ros2.export.hardware import hardware_names
from minidual.ros2.export.markup import note
from minidual.ros2.names import PackageNames

LAUNCH_FILES = ("control", "sim", "gazebo", "moveit", "teleop", "full_system")
"""Names of the launch files, without `.launch.py`."""
_LAUNCH_CHECK = "imported and evaluated against stubs of launch and launch_ros"
PACKAGE_CHECK = "names and dependencies against the files of the package"


class Package(NamedTuple):
    """Fields of package.xml.

    Attributes:
        text: One sentence.
        licence: Of its content.
        needs: Packages that it needs to run.
        folders: What is installed.
    """

    name: str
    text: str
    licence: str
    needs: Sequence[str]
    folders: Sequence[str]


@functools.cache
def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.FunctionLoader(_template),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )


def _template(name: str) -> str:
    folder = resources.files("minidual.ros2.export").joinpath("templates")
    return folder.joinpath(f"{name}.jinja").read_text(encoding="utf-8")


def _filled(name: str, **values: Any) -> str:
    return _environment().get_template(name).render(version=minidual.__version__, **values)


def packages(robot: Robot, names: PackageNames) -> tuple[Package, Package, Package]:
    """Return the packages, in the order of building."""
    arms = f"two arms: {' and '.join(arm.name for arm in robot.arms)}"
    simulators = [
        "mujoco_ros2_control",
        "mujoco_ros2_control_plugins",
        "gz_ros2_control",
        "ros_gz_sim",
        "ros_gz_bridge",
        "joint_state_topic_hardware_interface",
    ]
    return (
        Package(
            names.description,
            f"Description of {arms}: URDF, meshes, MuJoCo scene.",
            "Apache-2.0 and BSD-3-Clause",
            ["robot_state_publisher", "xacro"],
            ["meshes", "mjcf", "urdf"],
        ),
        Package(
            names.moveit,
            f"Configuration of MoveIt 2 for {arms}.",
            "Apache-2.0",
            [
                names.description,
                "moveit_configs_utils",
                "moveit_kinematics",
                "moveit_planners_ompl",
                "moveit_ros_control_interface",
                "moveit_ros_move_group",
                "moveit_ros_visualization",
                "moveit_simple_controller_manager",
                "pilz_industrial_motion_planner",
                "rviz2",
                "xacro",
            ],
            ["config"],
        ),
        Package(
            names.bringup,
            f"Controllers and launch files for {arms}.",
            "Apache-2.0",
            [
                names.description,
                names.moveit,
                "controller_manager",
                "forward_command_controller",
                "joint_state_broadcaster",
                "joint_trajectory_controller",
                "launch_ros",
                "moveit_configs_utils",
                "moveit_ros_move_group",
                "parallel_gripper_controller",
                "robot_state_publisher",
                "ros2bag",
                "rosbag2_storage_mcap",
                "rviz2",
                *simulators,
            ],
            ["config", "launch"],
        ),
    )


def package_xml(package: Package) -> str:
    """Return package.xml."""
    return _filled(
        "package.xml",
        note=note(PACKAGE_CHECK),
        package=package.name,
        text=package.text,
        licence=package.licence,
        needs=package.needs,
    )


def cmake_lists(package: Package) -> str:
    """Return CMakeLists.txt."""
    return _filled(
        "CMakeLists.txt",
        note=note(PACKAGE_CHECK),
        package=package.name,
        folders=" ".join(package.folders),
    )


def launch_file(name: str, robot: Robot, names: PackageNames) -> str:
    """Return a launch file, one of LAUNCH_FILES."""
    arm_controllers = [topics.arm_controller(side) for side in SIDES]
    return _filled(
        f"launch/{name}.launch.py",
        note=note(_LAUNCH_CHECK),
        names=names,
        topics=topics,
        arms=[arm.name for arm in robot.arms],
        sides=SIDES,
        hardware=hardware_names(robot),
        broadcaster=topics.STATE_BROADCASTER,
        forward=topics.FORWARD_CONTROLLER,
        active=_python_list([topics.BOTH_ARMS_CONTROLLER]),
        inactive=_python_list([*arm_controllers, topics.FORWARD_CONTROLLER]),
        grippers=_python_list([topics.gripper_controller(side) for side in SIDES]),
        recorded=_python_list(
            [
                topics.JOINT_STATES,
                topics.JOINT_COMMANDS,
                topics.TELEOP_TARGET,
                topics.POLICY_ACTION,
                topics.MODE_SWITCH,
                *(topics.image_topic(camera) for camera in CAMERAS),
            ],
        ),
    )


def launch_check() -> str:
    """Return how a launch file was checked."""
    return _LAUNCH_CHECK


def readme(**values: Any) -> str:
    """Return the workspace's README; `values` are those that the template names."""
    return _filled("README.md", **values)


def _python_list(words: Sequence[str]) -> str:
    quoted = ", ".join(f'"{word}"' for word in words)
    return f"[{quoted}]"
