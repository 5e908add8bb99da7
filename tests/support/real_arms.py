"""Arms of example-robot-data with the Panda's hand, as a user would add them."""

from __future__ import annotations

import math
from typing import NamedTuple

from minidual.robot.models import PANDA_HAND, ArmModel
from minidual.robot.urdf_limits import joint_limits

ROBOTS = "package://example-robot-data/robots"


class Mounted(NamedTuple):
    """An arm's part of a URDF, and how it stands.

    Attributes:
        urdf: Below the folder of robots.
        base, flange: Links between which the arm is.
        base_xy_m, base_height_m, base_rpy_rad: See ArmModel.
        home: See ArmModel.
        mount_rpy_rad, mount_xyz_m, never_touch, drawn_apart: See ArmModel.
    """

    urdf: str
    base: str
    flange: str
    base_xy_m: tuple[float, float]
    home: tuple[float, ...]
    base_height_m: float = 0.0
    base_rpy_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mount_rpy_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mount_xyz_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    never_touch: tuple[tuple[str, str], ...] = ()
    drawn_apart: tuple[str, ...] = ()


_UR = "ur_description/urdf"
_KINOVA = ("j2s6s200_link_base", "j2s6s200_end_effector", (0.0, 0.3))
_KINOVA_HOME = (0.45, 2.368, 2.07, -0.702, 1.637, -0.688)
_UR5_HOME = (-0.71, -1.088, 0.225, -1.389, -1.329, -2.336)
_UR10_HOME = (-1.77, -1.602, 0.3, 0.119, -0.843, 0.872)
_UR3_HOME = (-2.181, -0.67, -0.5, 0.068, -0.773, 1.22)
_Z1_HOME = (0.989, 1.593, -1.61, 0.992, 0.722, -1.374)
_ALONG_X = (0.0, 0.5 * math.pi, 0.0)
_BAXTER = "baxter_description/urdf/baxter.urdf"
_TIAGO_PRO = "tiago_pro_description/robots/tiago_pro.urdf"
_G1 = "g1_description/urdf/g1_29dof_rev_1_0.urdf"
_CENTAURO = "centauro_description/urdf/centauro.urdf"

ARMS = {
    "ur3": Mounted(f"{_UR}/ur3_robot.urdf", "base_link", "tool0", (0.15, 0.25), _UR3_HOME),
    "ur10": Mounted(f"{_UR}/ur10_robot.urdf", "base_link", "tool0", (-0.1, 0.4), _UR10_HOME),
    "ur3_limited": Mounted(
        f"{_UR}/ur3_joint_limited_robot.urdf", "base_link", "tool0", (0.15, 0.25), _UR3_HOME
    ),
    "ur5_limited": Mounted(
        f"{_UR}/ur5_joint_limited_robot.urdf", "base_link", "tool0", (0.0, 0.3), _UR5_HOME
    ),
    "ur10_limited": Mounted(
        f"{_UR}/ur10_joint_limited_robot.urdf", "base_link", "tool0", (-0.1, 0.4), _UR10_HOME
    ),
    "ur5_gripper": Mounted(f"{_UR}/ur5_gripper.urdf", "base_link", "tool0", (0.0, 0.3), _UR5_HOME),
    "kinova": Mounted("kinova_description/robots/kinova.urdf", *_KINOVA, _KINOVA_HOME),
    "anymal_kinova": Mounted(
        "anymal_b_simple_description/robots/anymal-kinova.urdf", *_KINOVA, _KINOVA_HOME
    ),
    "z1": Mounted(
        "z1_description/urdf/z1.urdf",
        "link00",
        "link06",
        (0.1, 0.25),
        _Z1_HOME,
        mount_rpy_rad=_ALONG_X,
        mount_xyz_m=(0.051, 0.0, 0.0),
    ),
    "baxter_left": Mounted(
        _BAXTER,
        "left_arm_mount",
        "left_hand_link",
        (0.0, 0.3),
        (-0.286, -0.331, -1.236, 2.222, -1.904, -0.39, -0.815),
        0.5,
        (0.0, 0.0, 0.785),
        never_touch=(("left_upper_elbow", "left_upper_shoulder"),),
        drawn_apart=("left_upper_elbow",),
    ),
    "baxter_right": Mounted(
        _BAXTER,
        "right_arm_mount",
        "right_hand_link",
        (0.0, 0.3),
        (-1.202, -0.347, 0.77, 2.286, -0.056, 0.317, -1.696),
        0.5,
        (0.0, 0.0, 0.785),
        never_touch=(("right_upper_elbow", "right_upper_shoulder"),),
        drawn_apart=("right_upper_elbow",),
    ),
    "tiago_pro_left": Mounted(
        _TIAGO_PRO,
        "torso_lift_link",
        "arm_left_7_link",
        (-0.1, 0.3),
        (1.142, 0.574, -1.128, -1.45, 1.186, 2.203, 0.148),
        0.5,
    ),
    "tiago_pro_right": Mounted(
        _TIAGO_PRO,
        "torso_lift_link",
        "arm_right_7_link",
        (-0.1, 0.3),
        (-1.316, -0.493, 0.295, -2.025, 1.729, 1.445, -0.929),
        0.5,
    ),
    "g1_left": Mounted(
        _G1,
        "torso_link",
        "left_wrist_yaw_link",
        (0.0, 0.2),
        (-1.566, 1.619, -2.211, 0.036, 1.639, -0.611, 0.897),
        0.3,
        mount_rpy_rad=_ALONG_X,
        mount_xyz_m=(0.05, 0.0, 0.0),
    ),
    "g1_right": Mounted(
        _G1,
        "torso_link",
        "right_wrist_yaw_link",
        (0.0, 0.2),
        (-1.621, -0.346, 2.0, 1.322, 0.826, 1.137, 1.083),
        0.3,
        mount_rpy_rad=_ALONG_X,
        mount_xyz_m=(0.05, 0.0, 0.0),
    ),
}
"""Arms that hold their hands over the table."""


def arm_model(name: str) -> ArmModel:
    """Return the model of a row of `ARMS`."""
    mounted = ARMS[name]
    return model_of(name, mounted)


def model_of(name: str, mounted: Mounted) -> ArmModel:
    """Return the model of an arm; its limits are those of the URDF."""
    urdf = f"{ROBOTS}/{mounted.urdf}"
    limits = joint_limits(urdf, mounted.base, mounted.flange)
    joints_n = len(limits.joints)
    home = mounted.home or tuple(
        0.5 * (lower + upper) for lower, upper in zip(limits.q_lower, limits.q_upper, strict=True)
    )
    return ArmModel(
        name=name,
        urdf=urdf,
        srdf=None,
        joints=limits.joints,
        base_link=mounted.base,
        flange_link=mounted.flange,
        mount_rpy_rad=mounted.mount_rpy_rad,
        mount_xyz_m=mounted.mount_xyz_m,
        base_xy_m=mounted.base_xy_m,
        never_touch=mounted.never_touch,
        drawn_apart=mounted.drawn_apart,
        base_height_m=mounted.base_height_m,
        base_rpy_rad=mounted.base_rpy_rad,
        home=home,
        q_lower=limits.q_lower,
        q_upper=limits.q_upper,
        v_max=limits.v_max,
        a_max=(10.0,) * joints_n,
        jerk_max=(5000.0,) * joints_n,
        tau_max=limits.tau_max,
        hand=PANDA_HAND,
    )
