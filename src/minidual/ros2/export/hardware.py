"""ros2_control blocks: mock, MuJoCo, Gazebo, minidual's own plant over topics, and Franka."""

import xml.etree.ElementTree as ET
from collections.abc import Callable

from minidual.robot.pair import SIDES, Robot
from minidual.ros2.export.markup import number, xacro
from minidual.ros2.names import JOINT_STATES, MOVEIT_COMMANDS, PackageNames

FRANKA_ARMS = ("panda",)
"""Arm models whose controller franka_ros2 speaks with."""
_FRANKA_INTERFACE_VERSION = "1.1.0"
"""Major version 1 is what FrankaHardwareInterface asks for."""
KEYFRAME = "home"
"""Of the MuJoCo scene."""


def hardware_names(robot: Robot) -> tuple[str, ...]:
    """Return the values of the argument `hardware`, default first."""
    are_frankas = all(arm.name in FRANKA_ARMS for arm in robot.arms)
    own = ("franka",) if are_frankas else ()
    return ("mujoco", "mock", "gazebo", "minidual", *own)


def hardware_xacro(robot: Robot, names: PackageNames) -> ET.Element:
    """Return the xacro file with the macro ROBOT_ros2_control(hardware)."""
    builders: dict[str, Callable[[Robot, PackageNames], list[ET.Element]]] = {
        "mujoco": _mujoco,
        "mock": _mock,
        "gazebo": _gazebo,
        "minidual": _minidual,
        "franka": _franka,
    }
    root = ET.Element("robot")
    macro = ET.SubElement(
        root,
        xacro("macro"),
        name=f"{names.robot}_ros2_control",
        params="hardware",
    )
    for name in hardware_names(robot):
        choice = ET.SubElement(macro, xacro("if"), value=f"${{hardware == '{name}'}}")
        choice.extend(builders[name](robot, names))
    return root


def _system(name: str, plugin: str, **parameters: str) -> ET.Element:
    """Return a block without joints."""
    system = ET.Element("ros2_control", name=name, type="system")
    hardware = ET.SubElement(system, "hardware")
    ET.SubElement(hardware, "plugin").text = plugin
    for key, value in parameters.items():
        ET.SubElement(hardware, "param", name=key).text = value
    return system


def _mujoco(robot: Robot, names: PackageNames) -> list[ET.Element]:
    """One block: both arms are in one simulation."""
    system = _system(
        "mujoco",
        "mujoco_ros2_control/MujocoSystemInterface",
        mujoco_model=f"$(find {names.description})/mjcf/scene.xml",
        initial_keyframe=KEYFRAME,
        headless="$(arg headless)",
    )
    for side in SIDES:
        _add_joints(system, robot, side)
    return [system]


def _systems_of_arms(robot: Robot, suffix: str, plugin: str) -> list[ET.Element]:
    """Return one block an arm, with its joints, named by side and suffix."""
    systems: list[ET.Element] = []
    for side in SIDES:
        system = _system(f"{side}_{suffix}", plugin)
        _add_joints(system, robot, side)
        systems.append(system)
    return systems


def _mock(robot: Robot, names: PackageNames) -> list[ET.Element]:
    return _systems_of_arms(robot, "mock", "mock_components/GenericSystem")


def _gazebo(robot: Robot, names: PackageNames) -> list[ET.Element]:
    systems = _systems_of_arms(robot, "gazebo", "gz_ros2_control/GazeboSimSystem")
    gazebo = ET.Element("gazebo")
    plugin = ET.SubElement(
        gazebo,
        "plugin",
        filename="gz_ros2_control-system",
        name="gz_ros2_control::GazeboSimROS2ControlPlugin",
    )
    ET.SubElement(
        plugin,
        "parameters",
    ).text = f"$(find {names.bringup})/config/ros2_controllers.yaml"
    return [*systems, gazebo]


def _minidual(robot: Robot, names: PackageNames) -> list[ET.Element]:
    """The plant of `minidual bridge`: MoveIt's controllers run here, its arbiter decides there."""
    system = _system(
        "minidual",
        "joint_state_topic_hardware_interface/JointStateTopicSystem",
        joint_states_topic=JOINT_STATES,
        joint_commands_topic=MOVEIT_COMMANDS,
        trigger_joint_command_threshold="-1",
    )
    for side in SIDES:
        _add_joints(system, robot, side)
    return [system]


def _franka(robot: Robot, names: PackageNames) -> list[ET.Element]:
    """Two blocks, one a controller box; their hands are nodes of franka_gripper."""
    systems: list[ET.Element] = []
    for side, arm in zip(SIDES, robot.arms, strict=True):
        system = _system(
            f"{side}_franka",
            "franka_hardware/FrankaHardwareInterface",
            version=_FRANKA_INTERFACE_VERSION,
            robot_type=arm.name,
            prefix=f"{side}_",
            arm_prefix=f"{side}_",
            robot_ip=f"$(arg {side}_robot_ip)",
        )
        for name in arm.joints:
            joint = ET.SubElement(system, "joint", name=f"{side}_{name}")
            for interface in ("position", "velocity", "effort"):
                ET.SubElement(joint, "command_interface", name=interface)
            for interface in ("position", "velocity", "effort"):
                ET.SubElement(joint, "state_interface", name=interface)
        systems.append(system)
    return systems


def _add_joints(system: ET.Element, robot: Robot, side: str) -> None:
    """Add an arm's joints and its fingers, which take positions.

    The second finger follows the first, as the URDF says (`mimic`).
    """
    arm = robot.arms[SIDES.index(side)]
    for name, position_rad in zip(arm.joints, arm.home, strict=True):
        _add_joint(system, f"{side}_{name}", position_rad, commanded=True)
    leading, following = robot.hand.finger_joints
    _add_joint(system, f"{side}_{leading}", robot.hand.travel_m, commanded=True)
    _add_joint(system, f"{side}_{following}", robot.hand.travel_m, commanded=False)


def _add_joint(system: ET.Element, name: str, position: float, *, commanded: bool) -> None:
    joint = ET.SubElement(system, "joint", name=name)
    if commanded:
        ET.SubElement(joint, "command_interface", name="position")
    state = ET.SubElement(joint, "state_interface", name="position")
    ET.SubElement(state, "param", name="initial_value").text = number(position)
    ET.SubElement(joint, "state_interface", name="velocity")
    ET.SubElement(joint, "state_interface", name="effort")
