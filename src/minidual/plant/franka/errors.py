"""Errors of the controllers by the vendor's names, in the order of the wire, and the reflex of ours."""

from typing import NamedTuple


class VendorError(NamedTuple):
    """An error that a controller reports.

    Attributes:
        name: The vendor's.
        reflex: The family of our reflexes that means the same (control/reflexes.py).
        text: What has happened.
    """

    name: str
    reflex: str
    text: str


ERRORS: tuple[VendorError, ...] = (
    VendorError(
        "joint_position_limits_violation",
        "joint_position",
        "a joint is past its limit",
    ),
    VendorError(
        "cartesian_position_limits_violation",
        "clearance",
        "past a virtual wall",
    ),
    VendorError(
        "self_collision_avoidance_violation",
        "clearance",
        "the arm would hit itself",
    ),
    VendorError(
        "joint_velocity_violation",
        "speed",
        "a joint is too fast",
    ),
    VendorError(
        "cartesian_velocity_violation",
        "speed",
        "the hand is too fast",
    ),
    VendorError(
        "force_control_safety_violation",
        "contact",
        "a safety threshold of force control",
    ),
    VendorError(
        "joint_reflex",
        "contact",
        "a joint feels more than its collision threshold",
    ),
    VendorError(
        "cartesian_reflex",
        "contact",
        "the hand feels more than its collision threshold",
    ),
    VendorError(
        "max_goal_pose_deviation_violation",
        "tracking_error",
        "the goal was not reached",
    ),
    VendorError(
        "max_path_pose_deviation_violation",
        "tracking_error",
        "the path was left",
    ),
    VendorError(
        "cartesian_velocity_profile_safety_violation",
        "speed",
        "a profile was exceeded",
    ),
    VendorError(
        "joint_position_motion_generator_start_pose_invalid",
        "reference",
        "the first joint target is far from the arm",
    ),
    VendorError(
        "joint_motion_generator_position_limits_violation",
        "reference",
        "a joint target is past its limit",
    ),
    VendorError(
        "joint_motion_generator_velocity_limits_violation",
        "reference",
        "joint targets move too fast",
    ),
    VendorError(
        "joint_motion_generator_velocity_discontinuity",
        "reference",
        "joint targets accelerate too much",
    ),
    VendorError(
        "joint_motion_generator_acceleration_discontinuity",
        "reference",
        "the jerk of joint targets is too large",
    ),
    VendorError(
        "cartesian_position_motion_generator_start_pose_invalid",
        "reference",
        "the first pose is far from the hand",
    ),
    VendorError(
        "cartesian_motion_generator_elbow_limit_violation",
        "reference",
        "the elbow's limit",
    ),
    VendorError(
        "cartesian_motion_generator_velocity_limits_violation",
        "reference",
        "poses move too fast",
    ),
    VendorError(
        "cartesian_motion_generator_velocity_discontinuity",
        "reference",
        "poses accelerate too much",
    ),
    VendorError(
        "cartesian_motion_generator_acceleration_discontinuity",
        "reference",
        "the jerk of poses is too large",
    ),
    VendorError(
        "cartesian_motion_generator_elbow_sign_inconsistent",
        "reference",
        "the elbow's sign",
    ),
    VendorError(
        "cartesian_motion_generator_start_elbow_invalid",
        "reference",
        "the first elbow",
    ),
    VendorError(
        "force_controller_desired_force_tolerance_violation",
        "contact",
        "the desired force",
    ),
    VendorError(
        "start_elbow_sign_inconsistent",
        "reference",
        "the elbow's sign at the start",
    ),
    VendorError(
        "communication_constraints_violation",
        "stale_command",
        "20 command packets in a row did not come in time",
    ),
    VendorError(
        "power_limit_violation",
        "torque",
        "the motors would need too much power",
    ),
    VendorError(
        "cartesian_motion_generator_joint_position_limits_violation",
        "reference",
        "a pose needs a joint past its limit",
    ),
    VendorError(
        "cartesian_motion_generator_joint_velocity_limits_violation",
        "reference",
        "a pose needs too fast a joint",
    ),
    VendorError(
        "cartesian_motion_generator_joint_velocity_discontinuity",
        "reference",
        "a pose needs too much acceleration of a joint",
    ),
    VendorError(
        "cartesian_motion_generator_joint_acceleration_discontinuity",
        "reference",
        "a pose needs too much jerk of a joint",
    ),
    VendorError(
        "cartesian_position_motion_generator_invalid_frame",
        "reference",
        "the pose is no transformation",
    ),
    VendorError(
        "controller_torque_discontinuity",
        "torque",
        "torques change too fast",
    ),
    VendorError(
        "joint_p2p_insufficient_torque_for_planning",
        "torque",
        "the arm is overloaded",
    ),
    VendorError(
        "tau_j_range_violation",
        "torque",
        "a torque sensor is out of its range",
    ),
    VendorError(
        "instability_detected",
        "torque",
        "an oscillation",
    ),
    VendorError(
        "joint_move_in_wrong_direction",
        "joint_position",
        "guided further past a limit",
    ),
    VendorError(
        "cartesian_spline_motion_generator_violation",
        "reference",
        "an internal motion",
    ),
    VendorError(
        "joint_via_motion_generator_planning_joint_limit_violation",
        "reference",
        "an internal motion",
    ),
    VendorError(
        "base_acceleration_initialization_timeout",
        "measurement",
        "gravity was not measured",
    ),
    VendorError(
        "base_acceleration_invalid_reading",
        "measurement",
        "gravity is not measured",
    ),
)
"""In the order of the flags in a robot state."""

ERRORS_BY_NAME: dict[str, VendorError] = {error.name: error for error in ERRORS}


def names_of(flags: object) -> tuple[str, ...]:
    """Return the names of the errors that are set in flags (41,)."""
    return tuple(
        error.name
        for error, flag in zip(ERRORS, flags, strict=True)  # type: ignore[call-overload]
        if flag
    )
