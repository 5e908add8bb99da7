"""Arm and hand models as data, with their sources.

Another arm is one more `ArmModel`, added by an entry point of the group `minidual.arms`
(docs/howto-arm.md).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from minidual.registry import Registry

Posture = tuple[float, ...]
"""Joint positions of one arm [rad], base first."""

_POSITIVE = ("v_max", "a_max", "jerk_max", "tau_max")
_QUARTER_TURN_RAD = 1.5707963267948966
_HALF_TURN_RAD = 3.141592653589793
_WHOLE_TURN_RAD = 6.283185307179586


class HandModel(NamedTuple):
    """A parallel gripper; names have no side prefix.

    Attributes:
        urdf: As in ArmModel; used from `palm_link` outwards.
        srdf: As in ArmModel.
        travel_m: Travel of one finger; the hand opens by twice that.
        finger_armature_kg: Reflected rotor inertia.
        pad_height_m: z of the soft pad in the finger's frame.
        camera_position_m: In the palm's frame.
        camera_tilt_rad: From the palm's z axis, about its y axis.
    """

    name: str
    urdf: str
    srdf: str | None
    finger_joints: tuple[str, str]
    finger_links: tuple[str, str]
    palm_link: str
    tcp_link: str
    travel_m: float
    finger_armature_kg: float
    pad_height_m: float
    camera_position_m: tuple[float, float, float]
    camera_tilt_rad: float


@dataclass(frozen=True, kw_only=True)
class ArmModel:
    """One arm with its hand; names without side prefix, limits one number a joint.

    Attributes:
        urdf: Absolute path, file:// or package://NAME/path; see `files.file_at`.
        srdf: The same, of a file with pairs of links that never collide.
        packages: Folder of each package of package:// that is no installed distribution.
        never_touch: More such pairs.
        drawn_apart: Links whose maker draws them beside what collides.
        joints: Joint names, base first.
        mount_rpy_rad: Orientation of the palm in the flange's frame.
        mount_xyz_m: Position of the palm in the flange's frame, of an adapter.
        base_xy_m: Position of the left base; the right one mirrors y. Both face +x.
        base_height_m: Of the base above the table.
        base_rpy_rad: Orientation of the left base; the right one mirrors roll and yaw.
        home: Posture at the start of a trial [rad].
        q_lower: Least joint positions [rad].
        q_upper: Largest joint positions [rad].
        v_max: Joint velocities [rad/s].
        a_max: Joint accelerations [rad/s^2].
        jerk_max: Joint jerks [rad/s^3].
        tau_max: Motor torques [Nm].
        tau_rate_max: Rate of a motor torque [Nm/s].
        armature: Reflected rotor inertia [kg m^2].
        damping: Viscous friction [Nm s/rad].
        friction: Dry friction [Nm].
        postures: Named (left, right) postures [rad].

    Raises:
        ValueError: The limits are not as many as the joints, no numbers, or no ranges.
    """

    name: str
    urdf: str
    srdf: str | None
    never_touch: tuple[tuple[str, str], ...] = ()
    drawn_apart: tuple[str, ...] = ()
    joints: tuple[str, ...]
    base_link: str
    flange_link: str
    mount_rpy_rad: tuple[float, float, float]
    base_xy_m: tuple[float, float]
    mount_xyz_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    base_height_m: float = 0.0
    base_rpy_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    home: Posture
    q_lower: tuple[float, ...]
    q_upper: tuple[float, ...]
    v_max: tuple[float, ...]
    a_max: tuple[float, ...]
    jerk_max: tuple[float, ...]
    tau_max: tuple[float, ...]
    tau_rate_max: float = 1000.0  # the Panda's (Franka Control Interface documentation)
    armature: float = 0.1  # MuJoCo Menagerie's value for the Panda, the xArm7 and the UR5e
    damping: float = 0.1
    friction: float = 0.0
    hand: HandModel
    postures: Mapping[str, tuple[Posture, ...]] = field(default_factory=dict, hash=False)
    packages: Mapping[str, str] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        """Check the limits and home."""
        joints_n = len(self.joints)
        if joints_n == 0:
            raise ValueError(f"arm '{self.name}': it has no joints")
        for name in ("home", "q_lower", "q_upper", *_POSITIVE):
            values = getattr(self, name)
            if len(values) != joints_n:
                raise ValueError(
                    f"arm '{self.name}': {name} has {len(values)} of {joints_n} entries",
                )
            if not all(map(math.isfinite, values)):
                raise ValueError(f"arm '{self.name}': {name} is not finite: {values}")
        for name in _POSITIVE:
            if not min(getattr(self, name)) > 0.0:
                raise ValueError(f"arm '{self.name}': {name} must be above 0 for every joint")
        ranges = zip(self.joints, self.q_lower, self.home, self.q_upper, strict=True)
        for joint, lower, home, upper in ranges:
            if not lower < home < upper:
                raise ValueError(
                    f"arm '{self.name}', joint '{joint}': home {home:g} rad must lie between "
                    f"q_lower {lower:g} and q_upper {upper:g}",
                )


PANDA_HAND = HandModel(
    name="panda_hand",
    urdf="package://example-robot-data/robots/panda_description/urdf/panda.urdf",
    srdf="package://example-robot-data/robots/panda_description/srdf/panda.srdf",
    finger_joints=("panda_finger_joint1", "panda_finger_joint2"),
    finger_links=("panda_leftfinger", "panda_rightfinger"),
    palm_link="panda_hand",
    tcp_link="panda_hand_tcp",
    travel_m=0.04,
    # The URDF's bare finger weighs 15 g. At 1 kHz that mass chatters between a position servo and
    # a stiff contact: the pinch jumps between 0 and 70 N. It is steady from 0.1 kg up and chatters
    # at 0.05 kg.
    finger_armature_kg=0.2,
    pad_height_m=0.04525,  # the URDF's "rubber tip" box
    camera_position_m=(0.08, 0.0, 0.03),  # in front of the hand
    camera_tilt_rad=2.600540585471551,  # 149 degrees: both fingertips are in view
)

PANDA = ArmModel(
    name="panda",
    urdf="package://example-robot-data/robots/panda_description/urdf/panda.urdf",
    srdf="package://example-robot-data/robots/panda_description/srdf/panda.srdf",
    joints=(
        "panda_joint1",
        "panda_joint2",
        "panda_joint3",
        "panda_joint4",
        "panda_joint5",
        "panda_joint6",
        "panda_joint7",
    ),
    base_link="panda_link0",
    flange_link="panda_link8",
    mount_rpy_rad=(0.0, 0.0, -0.5 * _QUARTER_TURN_RAD),
    base_xy_m=(0.0, 0.25),
    home=(0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785),
    # Position, velocity and torque: the URDF of panda_description (Franka Emika, Apache-2.0).
    q_lower=(-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973),
    q_upper=(2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973),
    v_max=(2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61),
    tau_max=(87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0),
    # Acceleration, jerk and torque rate: Franka Control Interface documentation, "Robot and
    # interface specifications".
    a_max=(15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0),
    jerk_max=(7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0),
    hand=PANDA_HAND,
    postures={
        # Hands down, 25 cm above the table.
        "ready": (
            (0.0, -0.1848, 0.0, -2.4967, 0.0, 2.3119, 0.7854),
            (0.0, -0.1848, 0.0, -2.4967, 0.0, 2.3119, 0.7854),
        ),
        # Hands 24 cm apart in the middle, 20 cm above the table, as they hold the rod.
        "carry": (
            (-0.216, 0.0891, -0.0384, -2.3191, 0.0051, 2.4081, -1.0434),
            (0.0716, 0.0905, 0.1829, -2.319, -0.0246, 2.4079, -0.5134),
        ),
        # Hands 60 cm above the table, out of the way of what stands on it.
        "raised": (
            (0.0242, -0.3986, 0.0716, -1.7764, 0.0283, 1.3788, 0.8811),
            (-0.0244, -0.3986, -0.0715, -1.7764, -0.0283, 1.3788, 0.6897),
        ),
        # Arms drawn back over their bases, the table free.
        "folded": (
            (0.0, -1.4, 0.0, -2.9, 0.0, 1.6, 0.785),
            (0.0, -1.4, 0.0, -2.9, 0.0, 1.6, 0.785),
        ),
    },
)

XARM7 = ArmModel(
    name="xarm7",
    urdf="package://example-robot-data/robots/xarm_description/urdf/xarm7.urdf",
    srdf="package://example-robot-data/robots/xarm_description/srdf/xarm7.srdf",
    joints=("joint1", "joint2", "joint3", "joint4", "joint5", "joint6", "joint7"),
    base_link="link_base",
    flange_link="link7",
    mount_rpy_rad=(0.0, 0.0, 0.0),
    # Nearer to the table's middle than the Panda: the reach is 0.69 m instead of 0.86 m.
    base_xy_m=(0.08, 0.22),
    home=(0.0, -0.6, 0.0, 0.9, 0.0, 1.5, 0.0),
    # Position, velocity and torque: the URDF of xarm_description (UFACTORY, BSD-3-Clause).
    q_lower=(
        -_WHOLE_TURN_RAD,
        -2.059,
        -_WHOLE_TURN_RAD,
        -0.19198,
        -_WHOLE_TURN_RAD,
        -1.69297,
        -_WHOLE_TURN_RAD,
    ),
    q_upper=(
        _WHOLE_TURN_RAD,
        2.0944,
        _WHOLE_TURN_RAD,
        3.927,
        _WHOLE_TURN_RAD,
        _HALF_TURN_RAD,
        _WHOLE_TURN_RAD,
    ),
    v_max=(3.14, 3.14, 3.14, 3.14, 3.14, 3.14, 3.14),
    tau_max=(50.0, 50.0, 30.0, 30.0, 30.0, 20.0, 20.0),
    # 1146 deg/s^2 and 28647 deg/s^3: UFACTORY documentation, "Guide to run robotic arm at the
    # maximum speed". Of 20 rad/s^2, 15 are used: a stop during a descent must end above the table.
    a_max=(15.0, 15.0, 15.0, 15.0, 15.0, 15.0, 15.0),
    jerk_max=(500.0, 500.0, 500.0, 500.0, 500.0, 500.0, 500.0),
    # The URDF's friction (10, 5 and 2 Nms/rad, 1 Nm) stabilises a simulator; the drives are
    # assumed to compensate theirs down to the Panda's, and the torque rate is assumed equal.
    hand=PANDA_HAND,
    postures={
        "ready": (
            (0.0, -0.3087, 0.0, 0.719, 0.0, 1.0277, 0.0),
            (0.0, -0.3087, 0.0, 0.719, 0.0, 1.0277, 0.0),
        ),
        "carry": (
            (0.4765, -0.0394, -0.7065, 0.8419, -0.0334, 0.8722, -1.7789),
            (0.4542, -0.0308, -0.2194, 0.8419, -0.0088, 0.8719, -1.3303),
        ),
        "raised": (
            (0.0328, -0.2021, 0.1595, 1.886, 0.0366, 2.0852, 0.2073),
            (-0.0328, -0.2021, -0.1595, 1.886, -0.0366, 2.0852, -0.2073),
        ),
        "folded": (
            (0.0, -1.4, 0.0, 0.55, 0.0, 1.9, 0.0),
            (0.0, -1.4, 0.0, 0.55, 0.0, 1.9, 0.0),
        ),
    },
)

UR5 = ArmModel(
    name="ur5",
    urdf="package://example-robot-data/robots/ur_description/urdf/ur5_robot.urdf",
    srdf="package://example-robot-data/robots/ur_description/srdf/ur5.srdf",
    # As in the SRDF. Their hulls come within 15 mm in every posture, so planning would check them.
    never_touch=(("base_link", "upper_arm_link"), ("forearm_link", "wrist_2_link")),
    joints=(
        "shoulder_pan_joint",
        "shoulder_lift_joint",
        "elbow_joint",
        "wrist_1_joint",
        "wrist_2_joint",
        "wrist_3_joint",
    ),
    base_link="base_link",
    flange_link="tool0",
    mount_rpy_rad=(0.0, 0.0, -_QUARTER_TURN_RAD),
    base_xy_m=(0.0, 0.3),
    home=(-0.308, -1.8884, 1.6495, -1.332, -1.5708, -0.308),
    # Position, velocity and torque: the URDF of ur_description (Universal Robots, BSD).
    q_lower=(
        -_WHOLE_TURN_RAD,
        -_WHOLE_TURN_RAD,
        -_HALF_TURN_RAD,
        -_WHOLE_TURN_RAD,
        -_WHOLE_TURN_RAD,
        -_WHOLE_TURN_RAD,
    ),
    q_upper=(
        _WHOLE_TURN_RAD,
        _WHOLE_TURN_RAD,
        _HALF_TURN_RAD,
        _WHOLE_TURN_RAD,
        _WHOLE_TURN_RAD,
        _WHOLE_TURN_RAD,
    ),
    v_max=(3.15, 3.15, 3.15, 3.2, 3.2, 3.2),
    tau_max=(150.0, 150.0, 150.0, 28.0, 28.0, 28.0),
    # The manufacturer gives none; MoveIt's configuration of the arm uses 10 rad/s^2. Jerk and
    # torque rate are assumed.
    a_max=(10.0, 10.0, 10.0, 10.0, 10.0, 10.0),
    jerk_max=(5000.0, 5000.0, 5000.0, 5000.0, 5000.0, 5000.0),
    hand=PANDA_HAND,
)

ARM_MODELS = Registry[ArmModel](
    "arm",
    {model.name: model for model in (PANDA, XARM7, UR5)},
    group="minidual.arms",
)
"""Arms by name."""
