"""Lead the arms from a terminal by inverse kinematics."""

import os
import re
import select
import termios
import tty
from typing import ClassVar, NamedTuple, Self

import numpy as np

from minidual import emergency
from minidual.demos.leader import Leader, LeaderSetup
from minidual.errors import EnvironmentMissingError, UsageError
from minidual.motion.ik import posture_at
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, pose, rot_z
from minidual.tasks.task import Trial

STEP = np.array([0.01, 0.01, 0.01, 0.05])
"""Step per key press: x, y, z [m], yaw [rad]."""
SPEED_MAX = np.array([0.25, 0.25, 0.25, 1.0])
"""Speed limits: x, y, z [m/s], yaw [rad/s]."""


class _Move(NamedTuple):
    """Which of x, y, z, yaw a key changes, and the sign."""

    axis: int
    sign: int


_MOVES = {
    "w": _Move(0, 1),
    "s": _Move(0, -1),
    "a": _Move(1, 1),
    "d": _Move(1, -1),
    "r": _Move(2, 1),
    "f": _Move(2, -1),
    "q": _Move(3, 1),
    "e": _Move(3, -1),
}
_ESCAPE = "\x1b"
"""The key alone. Arrow keys and the like send it followed by letters."""
_ESCAPE_SEQUENCE = re.compile(r"\x1b[\[O][0-9;]*[A-Za-z~]")
_SELECTIONS: tuple[list[int], ...] = ([0, 1], [0], [1])
"""Hands that move together."""
_KEYS_BYTES_MAX = 256


class KeyboardLeader(Leader):
    """Jogs one or both hands. Keys move a goal that is followed at bounded speed.

    Raises:
        EnvironmentMissingError: The descriptor is not a terminal.
    """

    realtime: ClassVar[bool] = True
    usage: ClassVar[str] = (
        "keys: w/s away/back  a/d left/right  r/f up/down  q/e turn  space open/close  "
        "tab left/right/both hands  enter ends the episode  x or escape: EMERGENCY STOP"
    )

    def __init__(self, kinematics: Kinematics, *, descriptor: int = 0) -> None:
        if not os.isatty(descriptor):
            missing = "the keyboard leader needs a terminal, and standard input is not one"
            remedy = (
                "run it in a terminal, or let the scripted operator lead: "
                "--set teleop.leader=scripted"
            )
            raise EnvironmentMissingError(missing, remedy=remedy)
        self._fd = descriptor
        self._saved = termios.tcgetattr(self._fd)
        tty.setcbreak(self._fd)
        self._robot = kinematics.robot
        self._q = self._robot.home.copy()
        self._start = [T.copy() for T in kinematics.tcp_poses(self._q)]
        # x, y, z [m] and yaw [rad] of each hand from its start
        self._goal = np.zeros((2, 4))
        self._offset = np.zeros((2, 4))
        self._open = np.ones(2)
        self._selected = 0
        self._ended = False
        self._last_s = 0.0

    @classmethod
    def for_trial(cls, setup: LeaderSetup, trial: Trial) -> Self:
        """Take over the terminal."""
        return cls(Kinematics(setup.robot))

    def read(self, now_s: float) -> tuple[Array, Array] | None:
        """Process keys; see `Leader`."""
        self._process_keys()
        self._follow_goal(now_s)
        return self._q.copy(), self._open.copy()

    def finished(self, now_s: float) -> bool:
        """Return whether enter was pressed."""
        return self._ended

    def close(self) -> None:
        """Restore the terminal."""
        termios.tcsetattr(self._fd, termios.TCSADRAIN, self._saved)

    def _process_keys(self) -> None:
        readable, _, _ = select.select([self._fd], [], [], 0.0)
        if not readable:
            return
        keys = os.read(self._fd, _KEYS_BYTES_MAX).decode(errors="ignore")
        if keys == _ESCAPE or "x" in keys.lower():
            emergency.press("key of the keyboard leader")
        for key in _ESCAPE_SEQUENCE.sub("", keys):
            self._press(key)

    def _press(self, key: str) -> None:
        hands = _SELECTIONS[self._selected]
        move = _MOVES.get(key.lower())
        if move is not None:
            self._goal[hands, move.axis] += move.sign * STEP[move.axis]
        elif key == " ":
            self._open[hands] = 1.0 - self._open[hands[0]]
        elif key == "\t":
            self._selected = (self._selected + 1) % len(_SELECTIONS)
        elif key in "\r\n":
            self._ended = True

    def _follow_goal(self, now_s: float) -> None:
        """Move the hands towards the goal at bounded speed; stay where it is out of reach."""
        step_max = max(now_s - self._last_s, 0.0) * SPEED_MAX
        self._last_s = now_s
        offset = self._offset + np.clip(self._goal - self._offset, -step_max, step_max)
        Ts_world_hand = []
        for T_start, hand_offset in zip(self._start, offset, strict=True):
            R_world_hand = rot_z(hand_offset[3]) @ T_start[:3, :3]
            Ts_world_hand.append(pose(R_world_hand, T_start[:3, 3] + hand_offset[:3]))
        try:
            self._q = posture_at(self._robot, Ts_world_hand, self._q, self._robot.home)
            self._offset = offset
        except UsageError:  # out of reach: the goal becomes the present position
            self._goal = self._offset.copy()
