"""Checks of what a policy sees and emits, before anything is clamped: a clamp would hide a broken network."""

import zlib
from collections import deque
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from minidual.errors import DataError
from minidual.registry import rows_beside
from minidual.robot.pair import SIDES, Array

_STOPS: dict[str, dict[str, str]] = rows_beside(__file__)
OVERSHOOT_RAD = 0.3  # networks regress to targets at a limit with some error
_ZERO_RAD = 1e-9
OVERSHOOT = 0.5
"""Of an opening: half the travel."""
SWING_RAD = 0.05
SWING = 0.2
"""A joint target or an opening turns back when it leaves its last extreme by this much; hands switch over 0.2."""
TURNS_MAX = 8
_WINDOW_TICKS = 200
"""Most turns of one joint in the last ticks (4 s at 50 Hz)."""
MOVED_RAD = 0.1
"""A picture that stays equal to the bit over a larger motion is frozen."""


class PolicyStoppedError(DataError):
    """The policy's input or output is broken; `name`, a row of plausible.yaml, says how (docs/deploy.md)."""

    def __init__(self, name: str, **values: object) -> None:
        super().__init__(
            f"{name}: {_STOPS[name]['text'].format(**values)}",
            remedy=_STOPS[name]["remedy"],
        )
        self.name = name


class Plausible:
    """Checks one policy's pictures, chunks and actions within lower to upper (n + 2,): joints [rad], then openings.

    Every method raises PolicyStoppedError.
    """

    def __init__(self, lower: Array, upper: Array) -> None:
        self._n = len(lower) - len(SIDES)
        over, self._swing = np.repeat(
            [[OVERSHOOT_RAD, OVERSHOOT], [SWING_RAD, SWING]],
            [self._n, len(SIDES)],
            axis=1,
        )
        self._lower = lower - over
        self._upper = upper + over
        joints = (f"joint {k + 1} of {self._n} [rad]" for k in range(self._n))
        hands = (f"the {s} hand" for s in SIDES)
        self._names = [*joints, *hands]
        self.reset()

    def reset(self) -> None:
        """Forget what was seen and emitted."""
        self._pictures: dict[str, tuple[int, Array]] = {}
        self._extreme: Array | None = None
        self._sign = np.zeros_like(self._swing)
        self._turned: deque[NDArray[np.bool_]] = deque([self._sign > 0.0] * _WINDOW_TICKS)
        self._turns = np.zeros(len(self._swing), dtype=int)

    def pictures(self, images: Mapping[str, NDArray[np.uint8]], q: Array) -> None:
        """Check images (H, W, 3) taken at joints q (n,) [rad]."""
        for camera, image in images.items():
            content = zlib.crc32(np.ascontiguousarray(image))
            before, q_before = self._pictures.get(camera, (None, q))
            if content != before:
                self._pictures[camera] = content, q.copy()
            elif (moved := float(np.abs(q - q_before).max())) > MOVED_RAD:
                raise PolicyStoppedError(
                    "frozen_picture",
                    camera=camera,
                    moved_rad=moved,
                    bound_rad=MOVED_RAD,
                )

    def chunk(self, chunk: Array) -> None:
        """Check the actions (k, n + 2) that will run."""
        if (np.abs(chunk[:, : self._n]).max(axis=1) < _ZERO_RAD).any():
            raise PolicyStoppedError("all_zero")
        beyond = np.maximum(self._lower - chunk, chunk - self._upper)
        row, k = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
        if beyond[row, k] > 0.0:
            named = {"asked": chunk[row, k], "lower": self._lower[k], "upper": self._upper[k]}
            raise PolicyStoppedError("out_of_bounds", what=self._names[k], **named)

    def action(self, action: Array) -> None:
        """Check that the targets (n + 2,) do not swing to and fro."""
        if self._extreme is None:
            self._extreme = action.copy()
        away = action - self._extreme
        swing = self._swing
        turned = (self._sign * away < -swing) | ((self._sign == 0.0) & (np.abs(away) > swing))
        onward = turned | (self._sign * away > 0.0)
        self._turned.append(turned & (self._sign != 0.0))
        self._turns += self._turned[-1].astype(int) - self._turned.popleft()
        self._sign = np.where(turned, np.sign(away), self._sign)
        self._extreme = np.where(onward, action, self._extreme)
        k = int(np.argmax(self._turns))
        if self._turns[k] > TURNS_MAX:
            bounds = {"swing": swing[k], "ticks": _WINDOW_TICKS, "bound_n": TURNS_MAX}
            raise PolicyStoppedError(
                "oscillation",
                what=self._names[k],
                turns_n=self._turns[k],
                **bounds,
            )
