"""The wire format of a Franka controller, protocol version 10, field by field.

One TCP connection a client carries commands (port 1337 for the arm, 1338 for the hand): a header,
then the fields of the request; answers likewise. Over UDP the controller sends its state every
millisecond, and the client answers each with a command. All numbers are little-endian, without
padding. Matrices are column-major.

Source: the public library libfranka 0.21 and its client franky, whose tests here hold every size.
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

JOINTS_N = 7
"""Joints of an arm: records and limits of the interface have so many entries."""
ARM_PORT = 1337
HAND_PORT = 1338
ARM_VERSION = 10
HAND_VERSION = 3
ERRORS_N = 41

Record = NDArray[np.void]
"""One filled structure."""


class ArmCommand(IntEnum):
    """Kinds of request to an arm."""

    CONNECT = 0
    MOVE = 1
    STOP_MOVE = 2
    SET_COLLISION_BEHAVIOR = 3
    SET_JOINT_IMPEDANCE = 4
    SET_CARTESIAN_IMPEDANCE = 5
    SET_GUIDING_MODE = 6
    SET_EE_TO_K = 7
    SET_NE_TO_EE = 8
    SET_LOAD = 9
    AUTOMATIC_ERROR_RECOVERY = 10
    GET_ROBOT_MODEL = 11


class HandCommand(IntEnum):
    """Kinds of request to a hand."""

    CONNECT = 0
    HOMING = 1
    GRASP = 2
    MOVE = 3
    STOP = 4


class ConnectStatus(IntEnum):
    """Answers to a connection."""

    SUCCESS = 0
    INCOMPATIBLE_VERSION = 1


class MoveStatus(IntEnum):
    """Answers to a motion: one when it starts, one when it ends."""

    SUCCESS = 0
    MOTION_STARTED = 1
    PREEMPTED = 2
    PREEMPTED_BY_SAFETY = 3
    REJECTED_BY_SAFETY = 4
    NOT_POSSIBLE = 5
    SINGULAR_START = 6
    INVALID_ARGUMENT = 7
    REFLEX_ABORTED = 8
    EMERGENCY_ABORTED = 9
    INPUT_ERROR_ABORTED = 10
    ABORTED = 11


class StopStatus(IntEnum):
    """Answers to the end of a motion."""

    SUCCESS = 0
    NOT_POSSIBLE = 1


class SetterStatus(IntEnum):
    """Answers to a setting."""

    SUCCESS = 0
    NOT_POSSIBLE = 1
    INVALID_ARGUMENT = 2


class RecoveryStatus(IntEnum):
    """Answers to a recovery from errors."""

    SUCCESS = 0
    NOT_POSSIBLE = 1
    REJECTED_BY_SAFETY = 2
    MANUAL_RECOVERY_REQUIRED = 3
    REFLEX_ABORTED = 4
    EMERGENCY_ABORTED = 5
    ABORTED = 6


class HandStatus(IntEnum):
    """Answers of a hand."""

    SUCCESS = 0
    FAIL = 1
    UNSUCCESSFUL = 2
    ABORTED = 3


class Controller(IntEnum):
    """Who controls the motors, in a motion's request and in the state."""

    JOINT_IMPEDANCE = 0
    CARTESIAN_IMPEDANCE = 1
    EXTERNAL = 2
    OTHER = 3


class Generator(IntEnum):
    """What moves the target, in a motion's request; the state counts from idle."""

    JOINT_POSITION = 0
    JOINT_VELOCITY = 1
    CARTESIAN_POSITION = 2
    CARTESIAN_VELOCITY = 3
    NONE = 4


IDLE_GENERATOR = 0
"""Generator code of a state without a motion; otherwise the code is `Generator` plus one."""


class RobotMode(IntEnum):
    """Modes of an arm."""

    OTHER = 0
    IDLE = 1
    MOVE = 2
    GUIDING = 3
    REFLEX = 4
    USER_STOPPED = 5
    AUTOMATIC_ERROR_RECOVERY = 6


ARM_HEADER = np.dtype(
    [
        ("command", "<u4"),  # an ArmCommand
        ("command_id", "<u4"),  # the client counts; an answer repeats it
        ("size", "<u4"),  # of the whole message, header included
    ],
)
HAND_HEADER = np.dtype(
    [
        ("command", "<u2"),  # a HandCommand
        ("command_id", "<u4"),
        ("size", "<u4"),
    ],
)
CONNECT = np.dtype(
    [
        ("version", "<u2"),  # of the client's protocol
        ("udp_port", "<u2"),  # where the client wants the states
    ],
)
ARM_CONNECTED = np.dtype(
    [
        ("status", "u1"),  # a ConnectStatus
        ("version", "<u2"),  # of the controller's protocol
    ],
)
HAND_CONNECTED = np.dtype([("status", "<u2"), ("version", "<u2")])
_DEVIATION = np.dtype([("translation", "<f8"), ("rotation", "<f8"), ("elbow", "<f8")])
MOVE = np.dtype(
    [
        ("controller", "<u4"),  # a Controller
        ("generator", "<u4"),  # a Generator
        ("path_deviation", _DEVIATION),  # largest: [m], [rad], [rad]
        ("goal_deviation", _DEVIATION),
    ],
)
"""Fields that follow it in later clients (variable rate, velocities) are not read."""
COLLISION_BEHAVIOR = np.dtype(
    [
        ("lower_torque_acceleration", "<f8", (JOINTS_N,)),  # [Nm], contacts while accelerating
        ("upper_torque_acceleration", "<f8", (JOINTS_N,)),  # [Nm], collisions
        ("lower_torque_nominal", "<f8", (JOINTS_N,)),
        ("upper_torque_nominal", "<f8", (JOINTS_N,)),
        ("lower_force_acceleration", "<f8", (6,)),  # [N] and [Nm]
        ("upper_force_acceleration", "<f8", (6,)),
        ("lower_force_nominal", "<f8", (6,)),
        ("upper_force_nominal", "<f8", (6,)),
    ],
)
JOINT_IMPEDANCE = np.dtype([("stiffness", "<f8", (JOINTS_N,))])  # [Nm/rad]
CARTESIAN_IMPEDANCE = np.dtype([("stiffness", "<f8", (6,))])  # [N/m] and [Nm/rad]
GUIDING_MODE = np.dtype([("axes", "?", (6,)), ("nullspace", "?")])
FRAME = np.dtype([("transform", "<f8", (16,))])
LOAD = np.dtype(
    [
        ("mass", "<f8"),  # [kg]
        ("centre", "<f8", (3,)),  # [m], in the flange's frame
        ("inertia", "<f8", (9,)),  # [kg m^2]
    ],
)
ARM_COMMAND = np.dtype(
    [
        ("message_id", "<u8"),  # of the state that it answers
        ("q_c", "<f8", (JOINTS_N,)),  # joint positions [rad]
        ("dq_c", "<f8", (JOINTS_N,)),  # joint velocities [rad/s]
        ("O_T_EE_c", "<f8", (16,)),  # pose of the end effector in the base
        ("O_dP_EE_c", "<f8", (6,)),  # its twist [m/s, rad/s]
        ("elbow_c", "<f8", (2,)),  # third joint [rad], sign of the fourth
        ("valid_elbow", "?"),
        ("motion_generation_finished", "?"),
        ("tau_J_d", "<f8", (JOINTS_N,)),  # torques [Nm], without gravity and friction
        ("torque_command_finished", "?"),
    ],
)
ARM_STATE = np.dtype(
    [
        ("message_id", "<u8"),  # milliseconds since the controller started
        ("O_T_EE", "<f4", (16,)),  # measured pose of the end effector in the base
        ("O_T_EE_d", "<f4", (16,)),  # desired
        ("F_T_EE", "<f4", (16,)),  # end effector in the flange
        ("EE_T_K", "<f4", (16,)),  # stiffness frame in the end effector
        ("F_T_NE", "<f4", (16,)),  # nominal end effector in the flange
        ("NE_T_EE", "<f4", (16,)),  # end effector in the nominal one
        ("m_ee", "<f4"),  # mass of the end effector [kg]
        ("I_ee", "<f4", (9,)),  # its inertia [kg m^2]
        ("F_x_Cee", "<f4", (3,)),  # its centre of mass [m]
        ("m_load", "<f4"),
        ("I_load", "<f4", (9,)),
        ("F_x_Cload", "<f4", (3,)),
        ("elbow", "<f4", (2,)),
        ("elbow_d", "<f4", (2,)),
        ("tau_J", "<f4", (JOINTS_N,)),  # measured torques, links' side [Nm]
        ("tau_J_d", "<f4", (JOINTS_N,)),  # desired, without gravity
        ("dtau_J", "<f4", (JOINTS_N,)),
        ("q", "<f4", (JOINTS_N,)),  # measured positions [rad]
        ("q_d", "<f4", (JOINTS_N,)),  # desired
        ("dq", "<f4", (JOINTS_N,)),  # measured velocities [rad/s]
        ("dq_d", "<f4", (JOINTS_N,)),
        ("ddq_d", "<f4", (JOINTS_N,)),
        ("joint_contact", "<f4", (JOINTS_N,)),  # 1 where a lower threshold is exceeded
        ("cartesian_contact", "<f4", (6,)),
        ("joint_collision", "<f4", (JOINTS_N,)),  # 1 where an upper one is
        ("cartesian_collision", "<f4", (6,)),
        ("tau_ext_hat_filtered", "<f4", (JOINTS_N,)),  # external torques [Nm]
        ("O_F_ext_hat_K", "<f4", (6,)),  # external wrench in the base [N, Nm]
        ("K_F_ext_hat_K", "<f4", (6,)),  # the same in the stiffness frame
        ("O_dP_EE_d", "<f4", (6,)),
        ("O_ddP_O", "<f4", (3,)),  # gravity, seen from the base [m/s^2]
        ("elbow_c", "<f4", (2,)),
        ("delbow_c", "<f4", (2,)),
        ("ddelbow_c", "<f4", (2,)),
        ("O_T_EE_c", "<f4", (16,)),
        ("O_dP_EE_c", "<f4", (6,)),
        ("O_ddP_EE_c", "<f4", (6,)),
        ("theta", "<f4", (JOINTS_N,)),  # motor positions [rad]
        ("dtheta", "<f4", (JOINTS_N,)),
        ("accelerometer_top", "<f4", (18,)),
        ("accelerometer_bottom", "<f4", (18,)),
        ("motion_generator_mode", "u1"),  # 0 idle, else Generator + 1
        ("controller_mode", "u1"),  # a Controller
        ("errors", "?", (ERRORS_N,)),  # see errors.py
        ("reflex_reason", "?", (ERRORS_N,)),  # errors of the last motion
        ("robot_mode", "u1"),  # a RobotMode
        ("control_command_success_rate", "<f4"),  # share of the last 100 commands in time
    ],
)
HAND_MOVE = np.dtype([("width", "<f8"), ("speed", "<f8")])  # [m], [m/s]
HAND_GRASP = np.dtype(
    [
        ("width", "<f8"),  # [m]
        ("epsilon_inner", "<f8"),  # how much less counts as grasped
        ("epsilon_outer", "<f8"),
        ("speed", "<f8"),  # [m/s]
        ("force", "<f8"),  # [N]
    ],
)
HAND_STATE = np.dtype(
    [
        ("message_id", "<u4"),
        ("width", "<f8"),  # [m]
        ("max_width", "<f8"),
        ("is_grasped", "?"),
        ("temperature", "<u2"),  # [degree C]
    ],
)
ARM_REQUESTS: dict[ArmCommand, np.dtype[np.void]] = {
    ArmCommand.CONNECT: CONNECT,
    ArmCommand.MOVE: MOVE,
    ArmCommand.SET_COLLISION_BEHAVIOR: COLLISION_BEHAVIOR,
    ArmCommand.SET_JOINT_IMPEDANCE: JOINT_IMPEDANCE,
    ArmCommand.SET_CARTESIAN_IMPEDANCE: CARTESIAN_IMPEDANCE,
    ArmCommand.SET_GUIDING_MODE: GUIDING_MODE,
    ArmCommand.SET_EE_TO_K: FRAME,
    ArmCommand.SET_NE_TO_EE: FRAME,
    ArmCommand.SET_LOAD: LOAD,
}
HAND_REQUESTS: dict[HandCommand, np.dtype[np.void]] = {
    HandCommand.CONNECT: CONNECT,
    HandCommand.MOVE: HAND_MOVE,
    HandCommand.GRASP: HAND_GRASP,
}


class Request(NamedTuple):
    """A request as it came.

    Attributes:
        command: Its number.
        command_id: To be repeated in the answer.
        payload: Bytes after the header.
    """

    command: int
    command_id: int
    payload: bytes


class WireError(ValueError):
    """Bytes that are no message."""


class RequestReader:
    """Cuts a stream of bytes into requests."""

    _SIZE_MAX = 1 << 20

    def __init__(self, header: np.dtype[np.void]) -> None:
        self._header = header
        self._bytes = bytearray()

    def feed(self, data: bytes) -> list[Request]:
        """Return the requests that are complete now.

        Raises:
            WireError: A message claims to be shorter than its header, or longer than 1 MiB.
        """
        self._bytes += data
        requests: list[Request] = []
        while len(self._bytes) >= self._header.itemsize:
            head = np.frombuffer(bytes(self._bytes[: self._header.itemsize]), self._header)[0]
            size = int(head["size"])
            if not self._header.itemsize <= size <= self._SIZE_MAX:
                raise WireError(f"a message of {size} bytes")
            if len(self._bytes) < size:
                break
            payload = bytes(self._bytes[self._header.itemsize : size])
            del self._bytes[:size]
            requests.append(Request(int(head["command"]), int(head["command_id"]), payload))
        return requests


def parse(payload: bytes, layout: np.dtype[np.void]) -> Record:
    """Return the structure at the beginning of a payload.

    Raises:
        WireError: It is too short.
    """
    if len(payload) < layout.itemsize:
        raise WireError(f"{len(payload)} bytes where {layout.itemsize} are needed")
    return np.frombuffer(payload[: layout.itemsize], layout)[0]


def answer(
    header: np.dtype[np.void],
    command: int,
    command_id: int,
    payload: bytes,
) -> bytes:
    """Return the bytes of an answer."""
    head = np.zeros((), header)
    head["command"] = command
    head["command_id"] = command_id
    head["size"] = header.itemsize + len(payload)
    return head.tobytes() + payload
