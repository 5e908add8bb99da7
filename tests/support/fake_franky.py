"""The part of the vendor's client library that the plant uses, without a network: arms move as they are told."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from minidual.plant.franka.description import EMULATED
from minidual.plant.franka.errors import ERRORS
from minidual.robot.models import PANDA


class ControlException(Exception):
    pass


class NetworkException(Exception):
    pass


class Cell:
    """What the fakes of one test share: robots and hands by host."""

    def __init__(self) -> None:
        self.robots: dict[str, Robot] = {}
        self.hands: dict[str, Gripper] = {}
        self.refuse: set[str] = set()
        self.hardware = True
        self.pause_ms = 0.0

    def take_pause(self) -> None:
        """Let time pass once, as a busy machine does."""
        pause_ms = self.pause_ms
        self.pause_ms = 0.0
        for robot in self.robots.values():
            robot.time_ms += pause_ms


class Robot:
    cell = Cell()

    def __init__(self, host: str, **options: Any) -> None:
        if host in self.cell.refuse:
            raise RuntimeError("libfranka: Connection timeout.")
        self.host = host
        self.options = options
        self.model_urdf = "" if self.cell.hardware else f'<robot name="{EMULATED}">'
        self.q = np.array(PANDA.home)
        self.errors: set[str] = set()
        self.mode = "Idle"
        self.time_ms = 1000.0 if host.endswith("1") else 5000.0
        self.silent = False
        self.raises: Exception | None = None
        self.motions: list[JointVelocityWaypointMotion] = []
        self.speed = np.zeros(7)
        self.calls: list[str] = []
        self.recoverable = True
        self.recovering = False
        self.clears_after = 0
        """States after a recovery that still show the errors."""
        self.cell.robots[host] = self

    @property
    def state(self) -> SimpleNamespace:
        if not self.silent:
            self.time_ms += 4.0  # the next read comes when it comes
            self.q = self.q + 0.004 * self.speed
        if self.cell.robots.get(self.host) is self and self.host.endswith("2"):
            self.cell.take_pause()
        named = {error.name: error.name in self.errors for error in ERRORS}
        return SimpleNamespace(
            time=SimpleNamespace(to_sec=lambda: 1e-3 * self.time_ms),
            q=self.q,
            q_d=self.q,
            dq=np.zeros(7),
            tau_J=np.ones(7),
            current_errors=SimpleNamespace(**named),
            robot_mode=self.mode,
            control_command_success_rate=0.99,
        )

    def poll_motion(self) -> bool:
        error, self.raises = self.raises, None
        if error is not None:
            raise error
        return bool(self.motions)

    def move(self, motion: JointVelocityWaypointMotion, asynchronous: bool) -> None:
        assert asynchronous
        self.motions.append(motion)
        self.speed = motion.waypoints[0].target

    def stop(self) -> None:
        self.calls.append("stop")
        self.speed = np.zeros(7)

    def join_motion(self, timeout: float) -> bool:
        self.calls.append("join")
        return True

    @property
    def has_errors(self) -> bool:
        if self.recovering:
            self.clears_after -= 1
            if self.clears_after < 0:
                self.errors.clear()
        return bool(self.errors)

    def recover_from_errors(self) -> bool:
        self.recovering = self.recoverable
        return not self.has_errors


class Gripper:
    def __init__(self, host: str) -> None:
        self.width = 0.08
        self.is_grasped = False
        self.calls: list[tuple[Any, ...]] = []
        Robot.cell.hands[host] = self

    @property
    def state(self) -> SimpleNamespace:
        return SimpleNamespace(width=self.width, is_grasped=self.is_grasped)

    def grasp_async(self, *arguments: float) -> str:
        self.calls.append(("grasp", *arguments))
        self.width = 0.03
        self.is_grasped = True
        return "future"

    def move_async(self, *arguments: float) -> str:
        self.calls.append(("move", *arguments))
        self.width = arguments[0]
        self.is_grasped = False
        return "future"

    def stop(self) -> bool:
        self.calls.append(("stop",))
        return True


class Duration:
    def __init__(self, milliseconds: int) -> None:
        self.milliseconds = milliseconds


class JointVelocityWaypoint:
    def __init__(self, target: np.ndarray, hold_target_duration: Duration) -> None:
        self.target = np.array(target)
        self.hold = hold_target_duration


class JointVelocityWaypointMotion:
    def __init__(self, waypoints: list[JointVelocityWaypoint]) -> None:
        self.waypoints = waypoints


RelativeDynamicsFactor = SimpleNamespace
RealtimeConfig = SimpleNamespace(Ignore="ignore")
RobotMode = SimpleNamespace(UserStopped="UserStopped")


def module(cell: Cell) -> SimpleNamespace:
    """Return the library whose robots stand in a cell."""
    Robot.cell = cell
    return SimpleNamespace(
        Robot=Robot,
        Gripper=Gripper,
        Duration=Duration,
        JointVelocityWaypoint=JointVelocityWaypoint,
        JointVelocityWaypointMotion=JointVelocityWaypointMotion,
        RelativeDynamicsFactor=lambda v, a, j: (v, a, j),
        RealtimeConfig=RealtimeConfig,
        RobotMode=RobotMode,
    )
