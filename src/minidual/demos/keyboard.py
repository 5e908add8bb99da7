"""Lead the arms with the keys of a terminal: each key jogs the hands, inverse kinematics gives the joints."""

from __future__ import annotations

import os
import select
import sys
import termios
import tty

import numpy as np

from minidual.errors import EnvironmentMissingError, UsageError
from minidual.motion.ik import PostureIK
from minidual.robot.constants import HOME, Array
from minidual.robot.kinematics import Kinematics
from minidual.robot.poses import pose, rot_z

HELP = (
    "w/s away/back  a/d left/right  r/f up/down  q/e turn  space open/close  tab left/right/both hands  "
    "enter ends the episode"
)
_STEP_M = 0.01
_STEP_RAD = 0.05
_SPEED_M_PER_S = 0.25
_SPEED_RAD_PER_S = 1.0
_MOVES: dict[str, tuple[float, float, float, float]] = {
    "w": (1.0, 0.0, 0.0, 0.0),
    "s": (-1.0, 0.0, 0.0, 0.0),
    "a": (0.0, 1.0, 0.0, 0.0),
    "d": (0.0, -1.0, 0.0, 0.0),
    "r": (0.0, 0.0, 1.0, 0.0),
    "f": (0.0, 0.0, -1.0, 0.0),
    "q": (0.0, 0.0, 0.0, 1.0),
    "e": (0.0, 0.0, 0.0, -1.0),
}
_SELECTIONS: tuple[tuple[int, ...], ...] = ((0, 1), (0,), (1,))


class KeyboardLeader:
    """Jogs both hands, or one of them, from a terminal.

    A key press moves the goal of the chosen hands by 1 cm or 0.05 rad; the hands run after their goals at a
    bounded speed, so holding a key down gives a steady motion whatever the terminal's key repeat does.

    Args:
        kinematics: Workspace for the inverse kinematics.
        descriptor: Terminal to read; standard input by default.
        q_start: (14,) posture to begin from [rad].

    Raises:
        EnvironmentMissingError: The descriptor is no terminal.
    """

    realtime = True

    def __init__(self, kinematics: Kinematics, *, descriptor: int | None = None, q_start: Array = HOME) -> None:
        self._fd = _terminal(descriptor)
        self._saved = termios.tcgetattr(self._fd)
        tty.setcbreak(self._fd)
        self._ik = PostureIK(kinematics, posture=HOME)
        self._q = np.array(q_start, dtype=float)
        self._start = [T.copy() for T in kinematics.tcp_poses(self._q)]
        self._goal = np.zeros((2, 4))  # x, y, z [m] and turn [rad] of each hand from its start
        self._offset = np.zeros((2, 4))
        self._open = np.ones(2)
        self._selected = 0
        self._ended = False
        self._last_s = 0.0

    def read(self, now_s: float) -> tuple[Array, Array] | None:
        """Take the keys pressed since the last call, move on, and return joints (14,) and openings (2,)."""
        for key in self._keys():
            self._press(key)
        dt, self._last_s = max(now_s - self._last_s, 0.0), now_s
        bound = dt * np.array([_SPEED_M_PER_S] * 3 + [_SPEED_RAD_PER_S])
        wanted = self._offset + np.clip(self._goal - self._offset, -bound, bound)
        try:
            self._q = self._ik.solve(*self._poses(wanted), self._q)
            self._offset = wanted
        except UsageError:  # out of reach: stay, and let the goal come back with the next key
            self._goal = self._offset.copy()
        return self._q.copy(), self._open.copy()

    def finished(self, now_s: float) -> bool:
        """Return whether enter was pressed."""
        return self._ended

    def close(self) -> None:
        """Give the terminal back as it was."""
        termios.tcsetattr(self._fd, termios.TCSADRAIN, self._saved)

    def _keys(self) -> str:
        if not select.select([self._fd], [], [], 0.0)[0]:
            return ""
        return os.read(self._fd, 256).decode(errors="ignore")

    def _press(self, key: str) -> None:
        hands = list(_SELECTIONS[self._selected])
        if key.lower() in _MOVES:
            step = np.array(_MOVES[key.lower()]) * np.array([_STEP_M] * 3 + [_STEP_RAD])
            self._goal[hands] += step
        elif key == " ":
            self._open[hands] = 1.0 - self._open[hands[0]]
        elif key == "\t":
            self._selected = (self._selected + 1) % len(_SELECTIONS)
        elif key in "\r\n":
            self._ended = True

    def _poses(self, offset: Array) -> tuple[Array, Array]:
        left, right = (
            pose(rot_z(move[3]) @ T[:3, :3], T[:3, 3] + move[:3]) for T, move in zip(self._start, offset, strict=True)
        )
        return left, right


def _terminal(descriptor: int | None) -> int:
    """Return the descriptor if a terminal is behind it."""
    try:
        fd = sys.stdin.fileno() if descriptor is None else descriptor
        if os.isatty(fd):
            return fd
    except (OSError, ValueError, AttributeError):  # standard input closed or replaced
        pass
    raise EnvironmentMissingError(
        "the keyboard leader needs a terminal, and standard input is not one",
        remedy="run it in an interactive terminal, or let the scripted operator lead: --set teleop.leader=scripted",
    )
