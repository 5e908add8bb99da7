"""Names in ROS 2: topics, controllers, groups and packages.

Topics and controllers have the names of the Mini-DualArm tutorial (docs/ros2.md).
"""

from dataclasses import dataclass

from minidual.robot.pair import Robot

JOINT_STATES = "/joint_states"
JOINT_COMMANDS = "/joint_commands"
"""What the arbiter lets through."""
TELEOP_TARGET = "/teleop/joint_target"
POLICY_ACTION = "/policy/action"
MODE_SWITCH = "/mode_switch"
MOVEIT_COMMANDS = "/moveit/joint_commands"
"""Set-points of MoveIt's trajectory controllers, if minidual drives the arms."""
CLOCK = "/clock"

BOTH_ARMS_CONTROLLER = "both_arms_controller"
FORWARD_CONTROLLER = "arms_forward_controller"
"""Follows JOINT_COMMANDS."""
STATE_BROADCASTER = "joint_state_broadcaster"


def image_topic(camera: str) -> str:
    """Return the topic of a camera's pictures."""
    return f"/camera_{camera}/image_raw"


def camera_info_topic(camera: str) -> str:
    """Return the topic of a camera's intrinsics."""
    return f"/camera_{camera}/camera_info"


def arm_group(side: str) -> str:
    """Return the planning group of one arm."""
    return f"{side}_arm"


def hand_group(side: str) -> str:
    """Return the planning group of one hand."""
    return f"{side}_hand"


def arm_controller(side: str) -> str:
    """Return the trajectory controller of one arm."""
    return f"{side}_arm_controller"


def gripper_controller(side: str) -> str:
    """Return the controller of one gripper."""
    return f"{side}_gripper_controller"


@dataclass(frozen=True)
class PackageNames:
    """Names of an exported workspace.

    Attributes:
        robot: Of URDF and SRDF, such as "dual_panda".
    """

    robot: str

    @property
    def description(self) -> str:
        """Package with URDF, xacro, meshes and the MuJoCo scene."""
        return f"{self.robot}_description"

    @property
    def moveit(self) -> str:
        """Package with the configuration of MoveIt 2."""
        return f"{self.robot}_moveit_config"

    @property
    def bringup(self) -> str:
        """Package with controllers and launch files."""
        return f"{self.robot}_bringup"

    @property
    def packages(self) -> tuple[str, str, str]:
        """All packages, in the order of building."""
        return self.description, self.moveit, self.bringup


def workspace_names(robot: Robot) -> PackageNames:
    """Return the names for a pair of arms: dual_panda, or dual_panda_ur5 for two models."""
    return PackageNames(f"dual_{robot.name.replace('+', '_')}")
