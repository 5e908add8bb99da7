"""Names, limits and poses of the default robot.

Storage order is fixed everywhere: `q` is (14,), left joints 1-7 then right joints 1-7, in radians;
the two grippers are kept apart as (2,), left then right. `tests/test_robot_description.py` holds the
limits below to the compiled MuJoCo and Pinocchio models.

Frames. `T_world_tcp` is the pose of the tool centre point in the world, so inner names cancel:
`T_world_rod = T_world_tcp @ T_tcp_rod`. A pose is a (4, 4) homogeneous matrix. Twists and wrenches are
[linear; angular] (6,), expressed in world-aligned axes unless a name says otherwise. Quaternions are wxyz.
The world's origin lies on the table top (z = 0) between the bases; x points away from the bases, left is +y.
"""

from __future__ import annotations

from minidual.robot.arms import DUAL_PANDA
from minidual.robot.pair import SIDES, Array

__all__ = ["Array"]

# To go: these names hold the default robot's values while modules move to `Robot`.
ARMS = SIDES
DOF_PER_ARM, DOF = DUAL_PANDA.dof_per_arm, DUAL_PANDA.dof
JOINT_NAMES, FINGER_JOINT_NAMES, TCP_NAMES = DUAL_PANDA.joint_names, DUAL_PANDA.finger_joint_names, DUAL_PANDA.tcp_names
GROUPS = DUAL_PANDA.groups
HOME, Q_LOWER, Q_UPPER = DUAL_PANDA.home, DUAL_PANDA.q_lower, DUAL_PANDA.q_upper
V_MAX, TAU_MAX, A_MAX, JERK_MAX = DUAL_PANDA.v_max, DUAL_PANDA.tau_max, DUAL_PANDA.a_max, DUAL_PANDA.jerk_max
TAU_RATE_MAX = DUAL_PANDA.arm.tau_rate_max
FINGER_TRAVEL_M, FINGER_FORCE_MAX_N = DUAL_PANDA.arm.hand.travel_m, DUAL_PANDA.arm.hand.force_max_n
FINGER_ARMATURE_KG = DUAL_PANDA.arm.hand.finger_armature_kg
BASE_POSITIONS_M = dict(zip(SIDES, DUAL_PANDA.base_positions_m, strict=True))
JOINT_ARMATURE, JOINT_DAMPING = DUAL_PANDA.arm.armature, DUAL_PANDA.arm.damping
JOINT_FRICTION = DUAL_PANDA.arm.friction
