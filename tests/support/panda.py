"""Names, limits and postures of two Pandas, the default robot, for tests that are about them."""

from __future__ import annotations

from minidual.robot.models import PANDA
from minidual.robot.pair import DUAL_PANDA, SIDES

ARMS = SIDES
DOF = DUAL_PANDA.dof
JOINT_NAMES = DUAL_PANDA.joint_names
FINGER_JOINT_NAMES = DUAL_PANDA.finger_joint_names
GROUPS = DUAL_PANDA.groups
HOME = DUAL_PANDA.home
Q_LOWER = DUAL_PANDA.q_lower
Q_UPPER = DUAL_PANDA.q_upper
V_MAX = DUAL_PANDA.v_max
TAU_MAX = DUAL_PANDA.tau_max
A_MAX = DUAL_PANDA.a_max
JERK_MAX = DUAL_PANDA.jerk_max
TAU_RATE_MAX = PANDA.tau_rate_max
JOINT_ARMATURE = PANDA.armature
JOINT_DAMPING = PANDA.damping
FINGER_TRAVEL_M = PANDA.hand.travel_m
BASE_POSITIONS_M = dict(zip(SIDES, DUAL_PANDA.base_positions_m, strict=True))
