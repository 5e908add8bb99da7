"""The table of arms."""

import functools
import math

from minidual.config.robot import RobotConfig
from minidual.registry import Registry
from minidual.robot.pair import ArmModel, HandModel, Robot

_ROBOTS = "package://example-robot-data/robots"

PANDA_HAND = HandModel(
    name="panda_hand",
    urdf=f"{_ROBOTS}/panda_description/urdf/panda.urdf",
    srdf=f"{_ROBOTS}/panda_description/srdf/panda.srdf",
    finger_joints=("panda_finger_joint1", "panda_finger_joint2"),
    finger_links=("panda_leftfinger", "panda_rightfinger"),
    palm_link="panda_hand",
    tcp_link="panda_hand_tcp",
    travel_m=0.04,
    force_max_n=70.0,  # Franka Hand data sheet
    # The URDF's bare finger weighs 15 g. At 1 kHz that mass chatters between a position servo and a stiff contact: the
    # pinch jumps between 0 and 70 N. It is steady from 0.1 kg up and chatters at 0.05 kg.
    finger_armature_kg=0.2,
    pad_height_m=0.04525,  # the URDF's "rubber tip" box
    camera_position_m=(0.08, 0.0, 0.03),  # in front of the hand
    camera_tilt_rad=math.radians(180.0 - 31.0),  # sees both fingertips
)


PANDA = ArmModel(
    name="panda",
    urdf=f"{_ROBOTS}/panda_description/urdf/panda.urdf",
    srdf=f"{_ROBOTS}/panda_description/srdf/panda.srdf",
    joints=tuple(f"panda_joint{i}" for i in range(1, 8)),
    base_link="panda_link0",
    flange_link="panda_link8",
    mount_rpy_rad=(0.0, 0.0, -0.7853981633974483),
    base_xy_m=(0.0, 0.25),
    home=(0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785),
    # Position, velocity and torque: the URDF of panda_description (Franka Emika, Apache-2.0).
    q_lower=(-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973),
    q_upper=(2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973),
    v_max=(2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61),
    tau_max=(87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0),
    # Acceleration, jerk and torque rate: Franka Control Interface documentation, "Robot and interface specifications".
    a_max=(15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0),
    jerk_max=(7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0),
    hand=PANDA_HAND,
    postures={
        # hands down, 25 cm over the table
        "ready": ((0.0, -0.1848, 0.0, -2.4967, 0.0, 2.3119, 0.7854),) * 2,
        # hands 24 cm apart at the middle, 20 cm over the table, as they hold the rod
        "carry": (
            (-0.216, 0.0891, -0.0384, -2.3191, 0.0051, 2.4081, -1.0434),
            (0.0716, 0.0905, 0.1829, -2.319, -0.0246, 2.4079, -0.5134),
        ),
        # hands 60 cm over the table, out of the way of what stands on it
        "raised": (
            (0.0242, -0.3986, 0.0716, -1.7764, 0.0283, 1.3788, 0.8811),
            (-0.0244, -0.3986, -0.0715, -1.7764, -0.0283, 1.3788, 0.6897),
        ),
        # arms drawn back over their bases, the table free
        "folded": ((0.0, -1.4, 0.0, -2.9, 0.0, 1.6, 0.785),) * 2,
    },
)

_TURN = 2.0 * math.pi

XARM7 = ArmModel(
    name="xarm7",
    urdf=f"{_ROBOTS}/xarm_description/urdf/xarm7.urdf",
    srdf=f"{_ROBOTS}/xarm_description/srdf/xarm7.srdf",
    joints=tuple(f"joint{i}" for i in range(1, 8)),
    base_link="link_base",
    flange_link="link7",
    mount_rpy_rad=(0.0, 0.0, 0.0),
    # Nearer to the table's middle than the Panda: the reach is 0.69 m instead of 0.86 m.
    base_xy_m=(0.08, 0.22),
    home=(0.0, -0.6, 0.0, 0.9, 0.0, 1.5, 0.0),
    # Position, velocity and torque: the URDF of xarm_description (UFACTORY, BSD-3-Clause).
    q_lower=(-_TURN, -2.059, -_TURN, -0.19198, -_TURN, -1.69297, -_TURN),
    q_upper=(_TURN, 2.0944, _TURN, 3.927, _TURN, math.pi, _TURN),
    v_max=(3.14,) * 7,
    tau_max=(50.0, 50.0, 30.0, 30.0, 30.0, 20.0, 20.0),
    # 1146 deg/s^2 and 28647 deg/s^3: UFACTORY documentation, "Guide to run robotic arm at the maximum speed".
    a_max=(15.0,) * 7,  # of 20: a stop out of a descent must end above the table
    jerk_max=(500.0,) * 7,
    # The URDF's friction (10, 5 and 2 Nms/rad, 1 Nm) stabilises a simulator; the drives are assumed to compensate theirs
    # down to the Panda's, and torque rate is assumed equal.
    hand=PANDA_HAND,
    postures={
        "ready": ((0.0, -0.3087, 0.0, 0.719, 0.0, 1.0277, 0.0),) * 2,
        "carry": (
            (0.4765, -0.0394, -0.7065, 0.8419, -0.0334, 0.8722, -1.7789),
            (0.4542, -0.0308, -0.2194, 0.8419, -0.0088, 0.8719, -1.3303),
        ),
        "raised": (
            (0.0328, -0.2021, 0.1595, 1.886, 0.0366, 2.0852, 0.2073),
            (-0.0328, -0.2021, -0.1595, 1.886, -0.0366, 2.0852, -0.2073),
        ),
        "folded": ((0.0, -1.4, 0.0, 0.55, 0.0, 1.9, 0.0),) * 2,
    },
)

UR5 = ArmModel(
    name="ur5",
    urdf=f"{_ROBOTS}/ur_description/urdf/ur5_robot.urdf",
    srdf=f"{_ROBOTS}/ur_description/srdf/ur5.srdf",
    # As in the SRDF. Their hulls come within 15 mm in every posture, so planning would examine them.
    never_touch=(("base_link", "upper_arm_link"), ("forearm_link", "wrist_2_link")),
    joints=tuple(
        f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    ),
    base_link="base_link",
    flange_link="tool0",
    mount_rpy_rad=(0.0, 0.0, -0.5 * math.pi),
    base_xy_m=(0.0, 0.3),
    home=(-0.308, -1.8884, 1.6495, -1.332, -1.5708, -0.308),
    # Position, velocity and torque: the URDF of ur_description (Universal Robots, BSD).
    q_lower=(-_TURN, -_TURN, -math.pi, -_TURN, -_TURN, -_TURN),
    q_upper=(_TURN, _TURN, math.pi, _TURN, _TURN, _TURN),
    v_max=(3.15, 3.15, 3.15, 3.2, 3.2, 3.2),
    tau_max=(150.0, 150.0, 150.0, 28.0, 28.0, 28.0),
    # The maker gives none; MoveIt's configuration of the arm uses 10 rad/s^2. Jerk and torque rate are assumed.
    a_max=(10.0,) * 6,
    jerk_max=(5000.0,) * 6,
    hand=PANDA_HAND,
)

ARM_MODELS: Registry[ArmModel] = Registry("arm", {"panda": PANDA, "xarm7": XARM7, "ur5": UR5}, group="minidual.arms")


DUAL_PANDA = Robot(PANDA)


def robot_from(config: RobotConfig) -> Robot:
    """Return the configured robot; UsageError for unknown arms."""
    return _robot(config.arm)


@functools.cache
def _robot(arm: str) -> Robot:
    return DUAL_PANDA if arm == "panda" else Robot(ARM_MODELS[arm])
