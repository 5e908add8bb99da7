"""Configuration of MoveIt 2: kinematics, limits, pipelines and controllers."""

from typing import Any

from minidual.config.root import Config
from minidual.robot.pair import GROUP_ARMS, SIDES, Robot
from minidual.ros2.names import (
    BOTH_ARMS_CONTROLLER,
    arm_controller,
    arm_group,
    gripper_controller,
    hand_group,
)

_IK_RESOLUTION_RAD = 0.005
_IK_TIMEOUT_S = 0.05
_FINGER_ACCELERATION_M_PER_S2 = 1.0
_FIRST_SPEED_SHARE = 0.1
"""Of the limits, until a user asks for more."""
_SEGMENT_FRACTION = 0.005
"""Of a state space, between two collision checks of a motion."""
_REQUEST_ADAPTERS = (
    "default_planning_request_adapters/ResolveConstraintFrames",
    "default_planning_request_adapters/ValidateWorkspaceBounds",
    "default_planning_request_adapters/CheckStartStateBounds",
    "default_planning_request_adapters/CheckStartStateCollision",
)
_CHECKING_ADAPTERS = (
    "default_planning_response_adapters/ValidateSolution",
    "default_planning_response_adapters/DisplayMotionPath",
)
_PLANNERS: dict[str, dict[str, Any]] = {
    "RRTConnectkConfigDefault": {"type": "geometric::RRTConnect", "range": 0.0},
    "BiTRRTkConfigDefault": {"type": "geometric::BiTRRT", "range": 0.0},
    "RRTstarkConfigDefault": {"type": "geometric::RRTstar", "range": 0.0, "goal_bias": 0.05},
    "PRMkConfigDefault": {"type": "geometric::PRM", "max_nearest_neighbors": 10},
}
"""RRT-Connect, the default, is also what minidual's planner runs."""


def kinematics() -> dict[str, Any]:
    """Return kinematics.yaml. MoveIt solves `both_arms` by the solvers of its two subgroups."""
    solver = {
        "kinematics_solver": "kdl_kinematics_plugin/KDLKinematicsPlugin",
        "kinematics_solver_search_resolution": _IK_RESOLUTION_RAD,
        "kinematics_solver_timeout": _IK_TIMEOUT_S,
    }
    return {arm_group(side): dict(solver) for side in SIDES}


def joint_limits(robot: Robot, config: Config) -> dict[str, Any]:
    """Return joint_limits.yaml: velocity, acceleration and jerk of each joint."""
    limits: dict[str, Any] = {}
    for k, name in enumerate(robot.joint_names):
        limits[name] = {
            "has_velocity_limits": True,
            "max_velocity": float(robot.v_max[k]),
            "has_acceleration_limits": True,
            "max_acceleration": float(robot.a_max[k]),
            "has_jerk_limits": True,
            "max_jerk": float(robot.jerk_max[k]),
        }
    for name in robot.finger_joint_names:
        limits[name] = {
            "has_velocity_limits": True,
            "max_velocity": config.arbiter.finger_speed_m_per_s,
            "has_acceleration_limits": True,
            "max_acceleration": _FINGER_ACCELERATION_M_PER_S2,
            "has_jerk_limits": False,
        }
    return {
        "default_velocity_scaling_factor": _FIRST_SPEED_SHARE,
        "default_acceleration_scaling_factor": _FIRST_SPEED_SHARE,
        "joint_limits": limits,
    }


def ompl_planning() -> dict[str, Any]:
    """Return ompl_planning.yaml."""
    document: dict[str, Any] = {
        "planning_plugins": ["ompl_interface/OMPLPlanner"],
        "request_adapters": list(_REQUEST_ADAPTERS),
        "response_adapters": [
            "default_planning_response_adapters/AddTimeOptimalParameterization",
            *_CHECKING_ADAPTERS,
        ],
        "planner_configs": {name: dict(settings) for name, settings in _PLANNERS.items()},
    }
    default = next(iter(_PLANNERS))
    for group in GROUP_ARMS:
        document[group] = {
            "default_planner_config": default,
            "planner_configs": list(_PLANNERS),
            "longest_valid_segment_fraction": _SEGMENT_FRACTION,
        }
    for side in SIDES:
        document[hand_group(side)] = {"planner_configs": [default]}
    return document


def pilz_planning() -> dict[str, Any]:
    """Return pilz_industrial_motion_planner_planning.yaml."""
    return {
        "planning_plugins": ["pilz_industrial_motion_planner/CommandPlanner"],
        "default_planner_config": "PTP",
        "request_adapters": list(_REQUEST_ADAPTERS),
        "response_adapters": list(_CHECKING_ADAPTERS),
        "capabilities": " ".join(
            f"pilz_industrial_motion_planner/MoveGroupSequence{kind}"
            for kind in ("Action", "Service")
        ),
    }


def pilz_limits(config: Config) -> dict[str, Any]:
    """Return pilz_cartesian_limits.yaml: the pace of a carried object."""
    pace = config.carry.pace
    return {
        "cartesian_limits": {
            "max_trans_vel": pace.object_speed_m_per_s,
            "max_trans_acc": pace.object_acceleration_m_per_s2,
            "max_trans_dec": -pace.object_acceleration_m_per_s2,
            "max_rot_vel": pace.object_turn_rad_per_s,
        },
    }


_EXECUTION = {
    "allowed_execution_duration_scaling": 1.2,
    "allowed_goal_duration_margin": 0.5,
    "allowed_start_tolerance": 0.01,
}


def switching_controllers() -> dict[str, Any]:
    """Return moveit_controllers.yaml.

    MoveIt asks the controller manager which controllers are active, and switches between
    both_arms_controller and the controllers of the single arms: they claim the same joints.
    """
    return {
        "trajectory_execution": dict(_EXECUTION),
        "moveit_controller_manager": "moveit_ros_control_interface/Ros2ControlManager",
    }


def fixed_controllers(robot: Robot) -> dict[str, Any]:
    """Return moveit_simple_controllers.yaml: the map of controllers, never switched.

    The arms of both_arms go through the controllers of the single arms, which must be active.
    """
    controllers: dict[str, Any] = {}
    for side, arm in zip(SIDES, robot.arms, strict=True):
        controllers[arm_controller(side)] = {
            "action_ns": "follow_joint_trajectory",
            "type": "FollowJointTrajectory",
            "default": True,
            "joints": [f"{side}_{joint}" for joint in arm.joints],
        }
    for side in SIDES:
        leading, _ = robot.hand.finger_joints
        controllers[gripper_controller(side)] = {
            "action_ns": "gripper_cmd",
            "type": "ParallelGripperCommand",
            "default": True,
            "joints": [f"{side}_{leading}"],
        }
    return {
        "trajectory_execution": dict(_EXECUTION),
        "moveit_controller_manager": (
            "moveit_simple_controller_manager/MoveItSimpleControllerManager"
        ),
        "moveit_simple_controller_manager": {
            "controller_names": list(controllers),
            **controllers,
        },
    }


def trajectory_controllers() -> tuple[str, ...]:
    """Return the controllers that MoveIt may switch between."""
    return (BOTH_ARMS_CONTROLLER, *(arm_controller(side) for side in SIDES))
