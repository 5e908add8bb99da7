"""Names, limits and postures of two Pandas, the default robot, for tests that are about them."""

from __future__ import annotations

from minidual.robot.pair import DUAL_PANDA, PANDA, SIDES

ARMS = SIDES
DOF = DUAL_PANDA.dof
JOINT_NAMES, FINGER_JOINT_NAMES = DUAL_PANDA.joint_names, DUAL_PANDA.finger_joint_names
GROUPS = DUAL_PANDA.groups
HOME, Q_LOWER, Q_UPPER = DUAL_PANDA.home, DUAL_PANDA.q_lower, DUAL_PANDA.q_upper
V_MAX, TAU_MAX, A_MAX, JERK_MAX = DUAL_PANDA.v_max, DUAL_PANDA.tau_max, DUAL_PANDA.a_max, DUAL_PANDA.jerk_max
TAU_RATE_MAX, JOINT_ARMATURE, JOINT_DAMPING = PANDA.tau_rate_max, PANDA.armature, PANDA.damping
FINGER_TRAVEL_M = PANDA.hand.travel_m
BASE_POSITIONS_M = dict(zip(SIDES, DUAL_PANDA.base_positions_m, strict=True))
