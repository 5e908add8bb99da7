"""Lead the arms from a terminal by inverse kinematics."""

import os
import re
import select
import termios
import tty
from typing import ClassVar, Self

import numpy as np

from minidual import emergency
from minidual.demos.leader import Leader, LeaderSetup
from minidual.errors import EnvironmentMissingError, UsageError
from minidual.motion.ik import posture_at
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, pose, rot_z
from minidual.tasks.task import Trial

# Step per key press: x, y, z [m], yaw [rad].
_STEP = np.array([0.01, 0.01, 0.01, 0.05])
# Speed limits: x, y, z [m/s], yaw [rad/s].
_SPEED = np.array([0.25, 0.25, 0.25, 1.0])
_MOVES = {key: (k // 2, 1 - 2 * (k % 2)) for k, key in enumerate("wsadrfqe")}  # axis and sign
_ESCAPE = "\x1b"  # the key alone; arrow keys send it with more
_SELECTIONS: tuple[list[int], ...] = ([0, 1], [0], [1])


class KeyboardLeader(Leader):
    """Jogs one or both hands. Keys move a goal that is followed at bounded speed.

    Raises:
        EnvironmentMissingError: The descriptor is not a terminal.
    """

    realtime: ClassVar[bool] = True
    usage: ClassVar[str] = (
        "keys: w/s away/back  a/d left/right  r/f up/down  q/e turn  space open/close  tab left/right/both hands  "
        "enter ends the episode  x or escape: EMERGENCY STOP"
    )

    def __init__(self, kinematics: Kinematics, *, descriptor: int = 0) -> None:
        if not os.isatty(descriptor):
            missing = "the keyboard leader needs a terminal, and standard input is not one"
            remedy = "run it in a terminal, or let the scripted operator lead: --set teleop.leader=scripted"
            raise EnvironmentMissingError(missing, remedy=remedy)
        self._fd = descriptor
        self._saved = termios.tcgetattr(self._fd)
        tty.setcbreak(self._fd)
        self._robot = kinematics.robot
        self._q = self._robot.home.copy()
        self._start = [T.copy() for T in kinematics.tcp_poses(self._q)]
        self._goal = np.zeros((2, 4))  # x, y, z [m] and yaw [rad] of each hand from its start
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
        if select.select([self._fd], [], [], 0.0)[0]:
            keys = os.read(self._fd, 256).decode(errors="ignore")
            if keys == _ESCAPE or "x" in keys.lower():
                emergency.press("key of the keyboard leader")
            for key in re.sub(
                r"\x1b[\[O][0-9;]*[A-Za-z~]",
                "",
                keys,
            ):  # arrows and the like are sent as letters
                self._press(key)
        bound = max(now_s - self._last_s, 0.0) * _SPEED
        self._last_s = now_s
        wanted = self._offset + np.clip(self._goal - self._offset, -bound, bound)
        moves = zip(self._start, wanted, strict=True)
        hands = [pose(rot_z(move[3]) @ T[:3, :3], T[:3, 3] + move[:3]) for T, move in moves]
        try:
            self._q = posture_at(self._robot, hands, self._q, self._robot.home)
            self._offset = wanted
        except UsageError:  # out of reach: stay, and reset the goal to the present position
            self._goal = self._offset.copy()
        return self._q.copy(), self._open.copy()

    def finished(self, now_s: float) -> bool:
        """Return whether enter was pressed."""
        return self._ended

    def close(self) -> None:
        """Restore the terminal."""
        termios.tcsetattr(self._fd, termios.TCSADRAIN, self._saved)

    def _press(self, key: str) -> None:
        hands = _SELECTIONS[self._selected]
        if key.lower() in _MOVES:
            axis, sign = _MOVES[key.lower()]
            self._goal[hands, axis] += sign * _STEP[axis]
        elif key == " ":
            self._open[hands] = 1.0 - self._open[hands[0]]
        elif key == "\t":
            self._selected = (self._selected + 1) % len(_SELECTIONS)
        elif key in "\r\n":
            self._ended = True
