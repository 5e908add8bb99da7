"""Checks of what a policy sees and emits, before anything is clamped: a clamp would hide a broken network."""

import zlib
from collections import deque
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from minidual.errors import DataError

Floats = NDArray[np.float64]

OVERSHOOT_RAD = 0.3  # networks regress to targets at a limit with some error
_ZERO_RAD = 1e-9
SWING_RAD = 0.05
"""A joint target turns back when it leaves its last extreme by this much."""
TURNS_MAX, _WINDOW_TICKS = 8, 200
"""Most turns of one joint in the last ticks (4 s at 50 Hz)."""
MOVED_RAD = 0.1
"""A picture that stays equal to the bit over a larger motion is frozen."""


class PolicyStoppedError(DataError):
    """The policy's input or output is broken; `name` says how (docs/deploy.md)."""

    def __init__(self, name: str, message: str, *, remedy: str | None = None) -> None:
        super().__init__(f"{name}: {message}", remedy=remedy)
        self.name = name


class Plausible:
    """Checks one policy's pictures, chunks and actions; joints within lower to upper (n,) [rad].

    Every method raises PolicyStoppedError.
    """

    def __init__(self, lower: Floats, upper: Floats) -> None:
        self._lower, self._upper, self._n = lower - OVERSHOOT_RAD, upper + OVERSHOOT_RAD, len(lower)
        self.reset()

    def reset(self) -> None:
        """Forget what was seen and emitted."""
        self._pictures: dict[str, tuple[int, Floats]] = {}
        self._extreme: Floats | None = None
        self._sign = np.zeros(self._n)
        self._turned: deque[NDArray[np.bool_]] = deque([np.zeros(self._n, dtype=bool)] * _WINDOW_TICKS)
        self._turns = np.zeros(self._n, dtype=int)

    def pictures(self, images: Mapping[str, NDArray[np.uint8]], q: Floats) -> None:
        """Check images (H, W, 3) taken at joints q (n,) [rad]."""
        for camera, image in images.items():
            content = zlib.crc32(np.ascontiguousarray(image))
            before, q_before = self._pictures.get(camera, (None, q))
            if content != before:
                self._pictures[camera] = content, q.copy()
            elif (moved := float(np.abs(q - q_before).max())) > MOVED_RAD:
                raise PolicyStoppedError(
                    "frozen_picture",
                    f"camera '{camera}' gives the same picture after {moved:.2f} rad of motion; bound {MOVED_RAD} rad",
                    remedy="look at that camera and its driver",
                )

    def chunk(self, chunk: Floats) -> None:
        """Check the joint targets (k, n) that will run."""
        zero = np.abs(chunk).max(axis=1) < _ZERO_RAD
        if zero.any():
            raise PolicyStoppedError("all_zero", "the policy emits 0.0 rad for every joint", remedy=_REMEDY)
        beyond = np.maximum(self._lower - chunk, chunk - self._upper)
        row, joint = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
        if beyond[row, joint] > 0.0:
            raise PolicyStoppedError(
                "out_of_bounds",
                f"the policy asks joint {joint + 1} of {self._n} for {chunk[row, joint]:.4g} rad; bounds "
                f"{self._lower[joint]:.4g} to {self._upper[joint]:.4g}",
                remedy=_REMEDY,
            )

    def action(self, q: Floats) -> None:
        """Check that the joint targets q (n,) do not swing to and fro."""
        if self._extreme is None:
            self._extreme = q.copy()
        away = q - self._extreme
        turned = (self._sign * away < -SWING_RAD) | ((self._sign == 0.0) & (np.abs(away) > SWING_RAD))
        onward = turned | (self._sign * away > 0.0)
        self._turned.append(turned & (self._sign != 0.0))
        self._turns += self._turned[-1].astype(int) - self._turned.popleft()
        self._sign = np.where(turned, np.sign(away), self._sign)
        self._extreme = np.where(onward, q, self._extreme)
        joint = int(np.argmax(self._turns))
        if self._turns[joint] > TURNS_MAX:
            raise PolicyStoppedError(
                "oscillation",
                f"the target of joint {joint + 1} of {self._n} turned back {self._turns[joint]} times by more than {SWING_RAD} "
                f"rad within {_WINDOW_TICKS} ticks; bound {TURNS_MAX}",
                remedy=_REMEDY,
            )


_REMEDY = "this checkpoint must not drive arms: minidual train-act --force"
