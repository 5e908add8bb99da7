"""Controllers of ros2_control, and the parameters of minidual's force laws."""

from typing import Any

from minidual.config.root import Config
from minidual.robot.pair import SIDES, Robot
from minidual.ros2.names import (
    BOTH_ARMS_CONTROLLER,
    FORWARD_CONTROLLER,
    STATE_BROADCASTER,
    arm_controller,
    camera_info_topic,
    gripper_controller,
    image_topic,
)

_UPDATE_HZ = 1000
_STATES_HZ = 100
_REAL_GOAL_TIME_S = 1.0
_TRAJECTORY_TOLERANCE_RAD = 0.1
_GOAL_TOLERANCE_RAD = 0.01
_REAL_SPEED_SHARE = 0.5
"""Of the acceleration limit, when a motion on hardware is cancelled."""
_GRIPPER_TOLERANCE_M = 0.002
_JOINT_TRAJECTORY = "joint_trajectory_controller/JointTrajectoryController"
_FORWARD = "forward_command_controller/ForwardCommandController"
_GRIPPER = "parallel_gripper_action_controller/GripperActionController"
_BROADCASTER = "joint_state_broadcaster/JointStateBroadcaster"


def simulated_controllers(robot: Robot, config: Config) -> dict[str, Any]:
    """Return ros2_controllers.yaml, for simulated and mock hardware."""
    types = _types()
    parameters = _trajectory_parameters(robot)
    parameters |= _common_parameters(robot)
    for side in SIDES:
        leading, _ = robot.hand.finger_joints
        name = gripper_controller(side)
        types[name] = _GRIPPER
        parameters[name] = {
            "joint": f"{side}_{leading}",
            "goal_tolerance": _GRIPPER_TOLERANCE_M,
            "allow_stalling": True,
            "max_effort": config.carry.impedance.pinch_n,
        }
    return _document(types, parameters)


def real_controllers(robot: Robot, config: Config) -> dict[str, Any]:
    """Return ros2_controllers_real.yaml, for two Frankas.

    Tolerances stop a motion that does not follow; a cancelled one is braked. Grippers are nodes of
    franka_gripper, so they have no controller here.
    """
    parameters = _trajectory_parameters(robot)
    share = min(_REAL_SPEED_SHARE, config.arbiter.speed_override)
    deceleration = dict(zip(robot.joint_names, (share * robot.a_max).tolist(), strict=True))
    for settings in parameters.values():
        constraints: dict[str, Any] = {
            "stopped_velocity_tolerance": config.arbiter.still_speed_rad_s,
            "goal_time": _REAL_GOAL_TIME_S,
            "decelerate_on_cancel": True,
        }
        for joint in settings["joints"]:
            constraints[joint] = {
                "trajectory": _TRAJECTORY_TOLERANCE_RAD,
                "goal": _GOAL_TOLERANCE_RAD,
                "max_deceleration_on_cancel": deceleration[joint],
            }
        settings["constraints"] = constraints
    parameters |= _common_parameters(robot)
    return _document(_types(), parameters)


def _types() -> dict[str, str]:
    types = {STATE_BROADCASTER: _BROADCASTER, BOTH_ARMS_CONTROLLER: _JOINT_TRAJECTORY}
    for side in SIDES:
        types[arm_controller(side)] = _JOINT_TRAJECTORY
    types[FORWARD_CONTROLLER] = _FORWARD
    return types


def _trajectory_parameters(robot: Robot) -> dict[str, dict[str, Any]]:
    """Return the parameters of the trajectory controllers, which send positions."""
    joints = {BOTH_ARMS_CONTROLLER: list(robot.joint_names)}
    for side, arm in zip(SIDES, robot.arms, strict=True):
        joints[arm_controller(side)] = [f"{side}_{joint}" for joint in arm.joints]
    return {
        name: {
            "joints": names,
            "command_interfaces": ["position"],
            "state_interfaces": ["position", "velocity"],
            "allow_nonzero_velocity_at_trajectory_end": False,
        }
        for name, names in joints.items()
    }


def _common_parameters(robot: Robot) -> dict[str, dict[str, Any]]:
    return {
        STATE_BROADCASTER: {"update_rate": _STATES_HZ},
        FORWARD_CONTROLLER: {"joints": list(robot.joint_names), "interface_name": "position"},
    }


def _document(types: dict[str, str], parameters: dict[str, dict[str, Any]]) -> dict[str, Any]:
    manager: dict[str, Any] = {"update_rate": _UPDATE_HZ}
    for name, kind in types.items():
        manager[name] = {"type": kind}
    document: dict[str, Any] = {"controller_manager": {"ros__parameters": manager}}
    for name, settings in parameters.items():
        document[name] = {"ros__parameters": settings}
    return document


def impedance_parameters(config: Config) -> dict[str, Any]:
    """Return impedance_params.yaml: gains of the object impedance, for a controller of your own.

    ros2_control has no such controller; minidual's runs in minidual.
    """
    gains = config.carry.impedance
    stiffness = [gains.stiffness_n_per_m] * 3 + [gains.stiffness_nm_per_rad] * 3
    return {
        "/**": {
            "ros__parameters": {
                "object_impedance": {
                    "stiffness": stiffness,
                    "damping_ratio": gains.damping_ratio,
                    "internal_force": gains.internal_force_n,
                    "force_gain": gains.force_gain,
                    "force_correction_max": gains.force_correction_max_n,
                    "squeeze_axes": gains.squeeze_axes,
                    "pinch_force": gains.pinch_n,
                },
            },
        },
    }


def camera_plugin(cameras: tuple[str, ...], rate_hz: float) -> dict[str, Any]:
    """Return mujoco_plugins.yaml: the cameras of the MuJoCo scene as topics."""
    plugin: dict[str, Any] = {
        "type": "mujoco_ros2_control_plugins/CameraPlugin",
        "camera_publish_rate": rate_hz,
    }
    for camera in cameras:
        plugin[camera] = {
            "frame_name": f"camera_{camera}_optical_frame",
            "info_topic": camera_info_topic(camera),
            "image_topic": image_topic(camera),
            "depth_topic": f"/camera_{camera}/depth/image_raw",
        }
    return {"/**": {"ros__parameters": {"mujoco_plugins": {"camera_plugin": plugin}}}}
