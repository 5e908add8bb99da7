"""Checks of what a policy sees and emits, before anything is clamped: a clamp would hide a broken network."""

import zlib
from collections import deque
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from minidual.errors import DataError
from minidual.registry import rows_beside
from minidual.robot.pair import Array

_STOPS: dict[str, dict[str, str]] = rows_beside(__file__)
OVERSHOOT_RAD = 0.3  # networks regress to targets at a limit with some error
_ZERO_RAD = 1e-9
SWING_RAD = 0.05
"""A joint target turns back when it leaves its last extreme by this much."""
TURNS_MAX, _WINDOW_TICKS = 8, 200
"""Most turns of one joint in the last ticks (4 s at 50 Hz)."""
MOVED_RAD = 0.1
"""A picture that stays equal to the bit over a larger motion is frozen."""


class PolicyStoppedError(DataError):
    """The policy's input or output is broken; `name`, a row of plausible.yaml, says how (docs/deploy.md)."""

    def __init__(self, name: str, **values: object) -> None:
        super().__init__(f"{name}: {_STOPS[name]['text'].format(**values)}", remedy=_STOPS[name]["remedy"])
        self.name = name


class Plausible:
    """Checks one policy's pictures, chunks and actions; joints within lower to upper (n,) [rad].

    Every method raises PolicyStoppedError.
    """

    def __init__(self, lower: Array, upper: Array) -> None:
        self._lower, self._upper, self._n = lower - OVERSHOOT_RAD, upper + OVERSHOOT_RAD, len(lower)
        self.reset()

    def reset(self) -> None:
        """Forget what was seen and emitted."""
        self._pictures: dict[str, tuple[int, Array]] = {}
        self._extreme: Array | None = None
        self._sign = np.zeros(self._n)
        self._turned: deque[NDArray[np.bool_]] = deque([np.zeros(self._n, dtype=bool)] * _WINDOW_TICKS)
        self._turns = np.zeros(self._n, dtype=int)

    def pictures(self, images: Mapping[str, NDArray[np.uint8]], q: Array) -> None:
        """Check images (H, W, 3) taken at joints q (n,) [rad]."""
        for camera, image in images.items():
            content = zlib.crc32(np.ascontiguousarray(image))
            before, q_before = self._pictures.get(camera, (None, q))
            if content != before:
                self._pictures[camera] = content, q.copy()
            elif (moved := float(np.abs(q - q_before).max())) > MOVED_RAD:
                raise PolicyStoppedError("frozen_picture", camera=camera, moved_rad=moved, bound_rad=MOVED_RAD)

    def chunk(self, chunk: Array) -> None:
        """Check the joint targets (k, n) that will run."""
        if (np.abs(chunk).max(axis=1) < _ZERO_RAD).any():
            raise PolicyStoppedError("all_zero")
        beyond = np.maximum(self._lower - chunk, chunk - self._upper)
        row, joint = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
        if beyond[row, joint] > 0.0:
            named = {"asked_rad": chunk[row, joint], "lower_rad": self._lower[joint], "upper_rad": self._upper[joint]}
            raise PolicyStoppedError("out_of_bounds", joint=joint + 1, joints_n=self._n, **named)

    def action(self, q: Array) -> None:
        """Check that the joint targets q (n,) do not swing to and fro."""
        if self._extreme is None:
            self._extreme = q.copy()
        away = q - self._extreme
        turned = (self._sign * away < -SWING_RAD) | ((self._sign == 0.0) & (np.abs(away) > SWING_RAD))
        onward = turned | (self._sign * away > 0.0)
        self._turned.append(turned & (self._sign != 0.0))
        self._turns += self._turned[-1].astype(int) - self._turned.popleft()
        self._sign = np.where(turned, np.sign(away), self._sign)
        self._extreme, joint = np.where(onward, q, self._extreme), int(np.argmax(self._turns))
        if self._turns[joint] > TURNS_MAX:
            bounds = {"swing_rad": SWING_RAD, "ticks": _WINDOW_TICKS, "bound_n": TURNS_MAX}
            named = {"joint": joint + 1, "joints_n": self._n, "turns_n": self._turns[joint]}
            raise PolicyStoppedError("oscillation", **named, **bounds)
