"""Constants of the control law and of the supervisor, for the kernels of batched worlds."""

import math

import numpy as np

from minidual.config.control import SupervisorConfig
from minidual.control.gripper import JOINT_PINCH_N, advance_constants
from minidual.control.joint_control import RAMP_S, REFERENCE_RAD_S, SERVO_RAD_S, reference_bounds
from minidual.control.observer import CONTACT_MODES, FILTER_S, LEAST_NM
from minidual.environments.kernels import Bounds, Law
from minidual.robot.pair import Array, Robot

_MODES = ("free motion", "closed hands")
"""Rows of CONTACT_MODES that hold while hands are wide open, and otherwise."""


def control_law(robot: Robot, finger_force_max_n: float, dt_s: float) -> Law:
    """Return the constants of `JointLoop`."""
    return Law(
        bounds=reference_bounds(robot),
        tau_max=robot.tau_max.copy(),
        gripper=advance_constants(dt_s, robot.hand.travel_m),
        dt_s=dt_s,
        ramp_s=RAMP_S,
        reference_rad_s=REFERENCE_RAD_S,
        servo_rad_s=SERVO_RAD_S,
        damping=float(robot.arm.damping),
        dry=float(robot.arm.friction),
        pinch_n=min(JOINT_PINCH_N, finger_force_max_n),
    )


def supervised_bounds(robot: Robot, config: SupervisorConfig, dt_s: float) -> Bounds:
    """Return the bounds of torques and deviations."""
    modes = [CONTACT_MODES[name] for name in _MODES]
    torques = [np.maximum(mode.torque_share * robot.tau_max, LEAST_NM) for mode in modes]
    return Bounds(
        torque=config.contact_scale * np.array(torques),
        deviation=config.deviation_scale * np.array([mode.deviation_rad for mode in modes]),
        share=-math.expm1(-dt_s / FILTER_S),
        travel_m=float(robot.hand.travel_m),
    )


def hand_force_bounds(config: SupervisorConfig) -> Array:
    """Return the bounds (2,) [N] of a hand's force, free and with closed hands."""
    return config.contact_scale * np.array([CONTACT_MODES[name].force_n for name in _MODES])
