"""Names, limits and poses of the two arms, each once, with its source.

Storage order is fixed everywhere: `q` is (14,), left joints 1-7 then right joints 1-7, in radians;
the two grippers are kept apart as (2,), left then right. `tests/test_robot_description.py` holds the
limits below to the compiled MuJoCo and Pinocchio models.

Frames. `T_world_tcp` is the pose of the tool centre point in the world, so inner names cancel:
`T_world_rod = T_world_tcp @ T_tcp_rod`. A pose is a (4, 4) homogeneous matrix. Twists and wrenches are
[linear; angular] (6,), expressed in world-aligned axes unless a name says otherwise. Quaternions are wxyz.
The world's origin lies on the table top (z = 0) between the bases; x points away from the bases, left is +y.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

ARMS: tuple[str, str] = ("left", "right")
DOF_PER_ARM = 7
DOF = 14

JOINT_NAMES: tuple[str, ...] = tuple(f"{arm}_panda_joint{i}" for arm in ARMS for i in range(1, 8))
FINGER_JOINT_NAMES: tuple[str, ...] = tuple(f"{arm}_panda_finger_joint{i}" for arm in ARMS for i in (1, 2))
TCP_NAMES: tuple[str, str] = ("left_panda_hand_tcp", "right_panda_hand_tcp")

GROUPS: dict[str, slice] = {
    "left_arm": slice(0, 7),
    "right_arm": slice(7, 14),
    "both_arms": slice(0, 14),
}
"""Planning and control groups: the joints each one owns, as a slice of `q`."""


def _both(one_arm: list[float]) -> Array:
    values = np.array(one_arm + one_arm, dtype=float)
    values.setflags(write=False)
    return values


HOME: Array = _both([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
"""Home posture, (14,) [rad]."""

# Position, velocity and torque limits: the URDF of panda_description (Franka Emika, Apache-2.0).
Q_LOWER: Array = _both([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973])
Q_UPPER: Array = _both([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])
V_MAX: Array = _both([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])
TAU_MAX: Array = _both([87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0])
# Acceleration, jerk and torque-rate limits: Franka Control Interface documentation, "Robot and interface
# specifications", Panda.
A_MAX: Array = _both([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0])
JERK_MAX: Array = _both([7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0])
TAU_RATE_MAX = 1000.0
"""Torque rate limit of every joint [Nm/s]."""

FINGER_TRAVEL_M = 0.04
"""Travel of one finger from the hand's middle plane [m]; the hand opens to twice that."""
FINGER_FORCE_MAX_N = 70.0
"""Continuous force of the Franka Hand [N] (Franka Hand data sheet)."""

BASE_POSITIONS_M: dict[str, tuple[float, float, float]] = {
    "left": (0.0, 0.25, 0.0),
    "right": (0.0, -0.25, 0.0),
}
"""Where each `panda_link0` stands in the world [m]; both face +x."""

JOINT_ARMATURE = 0.1
"""Reflected rotor inertia of each arm joint [kg m^2]: the value MuJoCo Menagerie identified for the Panda."""
FINGER_ARMATURE_KG = 0.2
"""Reflected rotor inertia of each finger [kg]. The URDF's bare finger weighs 15 g, and a 15 g mass between a
position servo and a stiff contact chatters at 1 kHz: the measured pinch jumps between 0 and 70 N. Menagerie
gives fingers 0.1 as well; the pinch is steady from 0.1 up and chatters at 0.05, so this keeps a margin."""
JOINT_DAMPING = 0.1
"""Viscous friction of each arm joint [Nm s/rad]."""
JOINT_FRICTION = 0.0
"""Dry friction of each arm joint [Nm]."""
