"""One Franka arm and its hand through the vendor's client library; its C++ loop owns the 1 kHz."""

import math
import threading
import time
from contextlib import suppress
from typing import Any

import numpy as np

from minidual.config.plant import PlantConfig
from minidual.errors import EnvironmentMissingError
from minidual.plant.franka.description import EMULATED, declared_limits
from minidual.plant.franka.errors import ERRORS, ERRORS_BY_NAME
from minidual.plant.franka.wire import JOINTS_N
from minidual.robot.pair import Array, Robot

_CLOSE_BELOW = 0.4
_OPENING_STEP = 0.05
"""A smaller change of a hand's opening is no new command."""
_HAND_SPEED_M_PER_S = 0.08
_ANY_WIDTH_M = 0.1
_HAND_PERIOD_S = 0.02
_STIFFNESS_NM_PER_RAD = (3000.0, 3000.0, 3000.0, 2500.0, 2500.0, 2000.0, 2000.0)
"""The controller's own."""
_PURSUIT_PER_S = 8.0
"""Velocity for each radian by which the controller's target is away from ours."""
_SPEED_SHARE = 0.95
"""Of the velocities that the library's interpolation may use: at its limit it refuses."""
_PATIENCE_PERIODS = 2.0
"""So long an arm keeps its velocity without a new target."""
_HOLD_MS = 3_600_000
_CLOSING_S = 10.0
_RECOVERY_S = 2.0
_RECOVERY_POLL_S = 0.01
_CONNECTION_LOST = "NetworkException"
"""The library's class for it."""
_KEPT: list[Any] = []
"""Arms that did not end their motion in time: to destroy one waits for its end without end."""


def client_library() -> Any:
    """Return the module of the vendor's client library.

    Raises:
        EnvironmentMissingError: The extra is not installed.
    """
    try:
        import franky
    except ModuleNotFoundError as error:
        raise EnvironmentMissingError(
            "plant 'franka' needs the library franky-control, which is not installed",
            remedy="pip install 'minidual[franka]'",
        ) from error
    return franky


def described(name: str) -> str:
    """Return an error of the vendor with the family of our reflexes and what it means."""
    error = ERRORS_BY_NAME.get(name)
    return name if error is None else f"{name} ({error.reflex}: {error.text})"


class ArmLink:
    """One arm.

    Args:
        host: Address of its controller.
        robot: Both arms, for limits.
        arm: 0 left, 1 right.
        config: Section `plant`.

    Attributes:
        host: As given.
        limits_rad: Least and largest positions (7,) that its controller declares, or None.
        q, v, tau: Last measurement (7,).
        time_s: Of the last state, since the connection.
        fault: Why it cannot be driven, or empty.
        is_lost: Whether its connection is gone: until `recover` it brings no states.

    Raises:
        EnvironmentMissingError: There is no controller, or it speaks another version.
    """

    def __init__(self, host: str, robot: Robot, arm: int, config: PlantConfig) -> None:
        self.host = host
        self._franky = franky = client_library()
        joints = robot.joints_of(arm)
        self._v_max = _SPEED_SHARE * config.velocity_share * robot.v_max[joints]
        try:
            self._robot = franky.Robot(
                host,
                relative_dynamics_factor=franky.RelativeDynamicsFactor(
                    config.velocity_share,
                    config.acceleration_share,
                    config.acceleration_share,
                ),
                default_torque_threshold=config.collision_torque_nm,
                default_force_threshold=config.collision_force_n,
                realtime_config=franky.RealtimeConfig.Ignore,
            )
        except Exception as error:  # the library's own classes
            raise EnvironmentMissingError(
                f"no Franka controller answers at {host}: {error}",
                remedy="check the cable, open the brakes and activate FCI in Desk; "
                "`minidual plant serve` starts the emulator",
            ) from error
        self.emulated = EMULATED in self._robot.model_urdf
        self.limits_rad = declared_limits(self._robot.model_urdf)
        self.fault = ""
        self.is_lost = False
        self._stopped = False
        self._began_s: float | None = None
        self.time_s = 0.0
        self.q = np.zeros(JOINTS_N)
        self._q_told = np.zeros(JOINTS_N)
        self.v = np.zeros(JOINTS_N)
        self.tau = np.zeros(JOINTS_N)
        self.success_rate = 1.0
        self.read()

    def read(self) -> bool:
        """Read the newest state; return whether it is newer than the last."""
        try:
            self._robot.poll_motion()
        except Exception as error:
            self._note(error)
        try:
            state = self._robot.state
        except Exception as error:
            self._note(error)
            return False
        stamp_s = float(state.time.to_sec())
        if self._began_s is None:
            self._began_s = stamp_s
        time_s = stamp_s - self._began_s
        newer = time_s > self.time_s
        self.time_s = time_s
        self.q = np.array(state.q)
        self._q_told = np.array(state.q_d)
        self.v = np.array(state.dq)
        self.tau = np.array(state.tau_J)
        self.success_rate = float(state.control_command_success_rate)
        names = [error.name for error in ERRORS if getattr(state.current_errors, error.name)]
        if names:
            self.fault = ", ".join(described(name) for name in names)
        elif state.robot_mode == self._franky.RobotMode.UserStopped:
            self.fault = "user_stopped (emergency_stop: the stop button is pressed)"
        return newer

    def _note(self, error: Exception) -> None:
        """Keep why a motion ended, by the names in the library's message."""
        text = str(error)
        if "preempted" in text:  # our own stop
            return
        names = [vendor_error.name for vendor_error in ERRORS if f'"{vendor_error.name}"' in text]
        reasons = [described(name) for name in names]
        if not reasons:
            reasons = [f"{type(error).__name__}: {text.splitlines()[0] if text else 'no reason'}"]
            self.is_lost = self.is_lost or type(error).__name__ == _CONNECTION_LOST
        self.fault = self.fault or ", ".join(reasons)

    def follow(self, q: Array, v: Array, period_s: float) -> None:
        """Be at q (7,) with velocity v (7,) after a period; without the next target, come to rest.

        The controller gets velocities: v, and what brings its target back to ours. Its
        interpolation towards positions in motion fails where targets come late.
        """
        if self.fault:
            return
        franky = self._franky
        now = q - period_s * v
        pursuit = v + _PURSUIT_PER_S * (now - self._q_told)
        speed = np.clip(pursuit, -self._v_max, self._v_max)
        patience = franky.Duration(round(1000.0 * _PATIENCE_PERIODS * period_s))
        hold = franky.Duration(_HOLD_MS)
        waypoints = [
            franky.JointVelocityWaypoint(speed, hold_target_duration=patience),
            franky.JointVelocityWaypoint(np.zeros(JOINTS_N), hold_target_duration=hold),
        ]
        motion = franky.JointVelocityWaypointMotion(waypoints)
        try:
            self._robot.move(motion, asynchronous=True)
            self._stopped = False
        except Exception as error:
            self._note(error)

    def stop(self) -> None:
        """Let the controller brake the arm, and hold it."""
        if self._stopped:
            return
        self._stopped = True
        try:
            self._robot.stop()
            self._robot.join_motion(1.0)
        except Exception as error:
            self._note(error)

    def close(self) -> None:
        """Stop, and wait until the motion has ended."""
        self._stopped = False
        self.stop()
        give_up_s = time.monotonic() + _CLOSING_S
        ended = False
        while not ended and time.monotonic() < give_up_s:
            try:
                ended = self._robot.join_motion(1.0)
            except Exception:  # the motion's own: it has ended
                ended = True
        if not ended:
            _KEPT.append(self._robot)

    def soften(self, share: float) -> None:
        """Set the stiffness of the controller's joints to a share of its default."""
        self.stop()
        try:
            self._robot.set_joint_impedance([share * k for k in _STIFFNESS_NM_PER_RAD])
        except Exception as error:
            self._note(error)

    def recover(self) -> None:
        """Clear the errors that the controller can clear."""
        with suppress(Exception):  # the exception of the motion that ended; `read` has noted it
            self._robot.join_motion(1.0)
        fault = self.fault
        self.fault = ""
        self.is_lost = False
        try:
            if not self._is_clear():
                self.fault = f"the controller refused to recover from {fault or 'an error'}"
        except Exception as error:
            self._note(error)
        self._stopped = False
        self.read()

    def _is_clear(self) -> bool:
        """Clear the errors; return whether they are gone, in a state that may come a while later."""
        if self._robot.has_errors:
            self._robot.recover_from_errors()
        give_up_s = time.monotonic() + _RECOVERY_S
        while self._robot.has_errors:
            if time.monotonic() > give_up_s:
                return False
            time.sleep(_RECOVERY_POLL_S)
        return True


class HandLink:
    """One hand, read and commanded by a thread of its own: its service answers slowly."""

    def __init__(self, host: str, travel_m: float, grip_n: float) -> None:
        self._hand = client_library().Gripper(host)
        self._travel_m = travel_m
        self._grip_n = grip_n
        self._opening = math.nan
        self._wanted: float | None = None
        self._work: Any = None
        self.finger_m = 0.5 * float(self._hand.width)
        self.grip_n = 0.0
        self.fault = ""
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True, name=f"hand {host}")
        self._thread.start()

    def open_to(self, opening: float) -> None:
        """Close (below 0.4) or open; NaN and small changes change nothing."""
        if math.isnan(opening):
            return
        if not math.isnan(self._opening) and abs(opening - self._opening) < _OPENING_STEP:
            return
        if self._opening < _CLOSE_BELOW and opening < _CLOSE_BELOW:
            return
        self._opening = opening
        self._wanted = opening

    def _run(self) -> None:
        while not self._ended.wait(_HAND_PERIOD_S):
            try:
                self._turn()
                self.fault = ""
            except Exception as error:
                self.fault = f"{type(error).__name__}: {error}"

    def _turn(self) -> None:
        state = self._hand.state
        self.finger_m = 0.5 * float(state.width)
        self.grip_n = self._grip_n if state.is_grasped else 0.0
        opening = self._wanted
        if opening is None:
            return
        self._wanted = None
        if self._work is not None:
            self._hand.stop()
        if opening < _CLOSE_BELOW:
            self._work = self._hand.grasp_async(
                0.0,
                _HAND_SPEED_M_PER_S,
                self._grip_n,
                _ANY_WIDTH_M,
                _ANY_WIDTH_M,
            )
        else:
            width_m = 2.0 * self._travel_m * min(opening, 1.0)
            self._work = self._hand.move_async(width_m, _HAND_SPEED_M_PER_S)

    def close(self) -> None:
        """End the thread."""
        self._ended.set()
        self._thread.join(timeout=2.0)
