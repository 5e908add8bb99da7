"""Checks of a policy's input and output, before anything is clamped.

A clamp would hide a broken network.
"""

import zlib
from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from minidual.errors import DataError
from minidual.robot.pair import SIDES, Array

OVERSHOOT_RAD = 0.3
OVERSHOOT = 0.5
"""Largest distance beyond a limit: of joints [rad], and of openings, of which it is half the travel.

Networks regress to targets at a limit with some error.
"""
ZERO_RAD = 1e-9
SWING_RAD = 0.05
SWING = 0.2
"""A joint target or an opening turns back when it leaves its last extreme by this much."""
TURNS_MAX = 8
WINDOW_TICKS = 200
"""Most turns of one joint in the last ticks (4 s at 50 Hz)."""
MOVED_RAD = 0.1
"""A picture that stays equal to the bit over a larger motion is frozen."""


class _Stop(NamedTuple):
    """Why a policy is stopped; names in braces are filled in where it happens."""

    text: str
    remedy: str


_CHECK_CAMERA = "look at that camera and its driver"
_RETRAIN = "this checkpoint must not drive arms: minidual train-act --force"
STOPS = {
    "camera_failed": _Stop("camera '{camera}' gives no picture ({error})", _CHECK_CAMERA),
    "stale_picture": _Stop(
        "the picture of camera '{camera}' is {age_s:.3f} s old; limit {limit_s} s",
        _CHECK_CAMERA,
    ),
    "frozen_picture": _Stop(
        "camera '{camera}' gives the same picture after {moved_rad:.2f} rad of motion; "
        "bound {bound_rad} rad",
        _CHECK_CAMERA,
    ),
    "late_answer": _Stop(
        "the policy answered after {age_s:.3f} s; limit {limit_s} s",
        "take a faster device or a smaller policy",
    ),
    "all_zero": _Stop("the policy emits 0.0 rad for every joint", _RETRAIN),
    "out_of_bounds": _Stop(
        "the policy asks {what} for {asked:.4g}; bounds {lower:.4g} to {upper:.4g}",
        _RETRAIN,
    ),
    "oscillation": _Stop(
        "the target of {what} turned back {turns_n} times by more than {swing} "
        "within {ticks} ticks; bound {bound_n}",
        _RETRAIN,
    ),
}
"""Faults of a policy's input or output by name; docs/deploy.md lists them."""


class PolicyStoppedError(DataError):
    """The policy's input or output is broken; `name`, one of STOPS, says how."""

    def __init__(self, name: str, **values: object) -> None:
        stop = STOPS[name]
        super().__init__(f"{name}: {stop.text.format(**values)}", remedy=stop.remedy)
        self.name = name


class _LastPicture(NamedTuple):
    """A picture's checksum, and the joints (n,) [rad] when it first came."""

    checksum: int
    q: Array


class Plausible:
    """Checks one policy's pictures, chunks and actions.

    Every method raises PolicyStoppedError.

    Args:
        lower, upper: Limits (n + 2,) of an action: joints [rad], then openings.
    """

    def __init__(self, lower: Array, upper: Array) -> None:
        hands_n = len(SIDES)
        self._n = len(lower) - hands_n
        overshoot = np.repeat([OVERSHOOT_RAD, OVERSHOOT], [self._n, hands_n])
        self._lower = lower - overshoot
        self._upper = upper + overshoot
        self._swing = np.repeat([SWING_RAD, SWING], [self._n, hands_n])
        joints = [f"joint {k + 1} of {self._n} [rad]" for k in range(self._n)]
        hands = [f"the {side} hand" for side in SIDES]
        self._names = [*joints, *hands]
        self.reset()

    def reset(self) -> None:
        """Forget earlier pictures and actions."""
        self._pictures: dict[str, _LastPicture] = {}
        self._turns = _TurnCounter(self._swing)

    def pictures(self, images: Mapping[str, NDArray[np.uint8]], q: Array) -> None:
        """Check images (H, W, 3) taken at joints q (n,) [rad]."""
        for camera, image in images.items():
            checksum = zlib.crc32(np.ascontiguousarray(image))
            last = self._pictures.get(camera)
            if last is None or checksum != last.checksum:
                self._pictures[camera] = _LastPicture(checksum, q.copy())
                continue
            moved_rad = float(np.abs(q - last.q).max())
            if moved_rad > MOVED_RAD:
                raise PolicyStoppedError(
                    "frozen_picture",
                    camera=camera,
                    moved_rad=moved_rad,
                    bound_rad=MOVED_RAD,
                )

    def chunk(self, chunk: Array) -> None:
        """Check the actions (k, n + 2) that will run."""
        largest_rad = np.abs(chunk[:, : self._n]).max(axis=1)
        if (largest_rad < ZERO_RAD).any():
            raise PolicyStoppedError("all_zero")
        beyond = np.maximum(self._lower - chunk, chunk - self._upper)
        row, k = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
        if beyond[row, k] > 0.0:
            raise PolicyStoppedError(
                "out_of_bounds",
                what=self._names[k],
                asked=chunk[row, k],
                lower=self._lower[k],
                upper=self._upper[k],
            )

    def action(self, action: Array) -> None:
        """Check that the targets (n + 2,) do not swing to and fro."""
        turns = self._turns.add(action)
        k = int(np.argmax(turns))
        if turns[k] > TURNS_MAX:
            raise PolicyStoppedError(
                "oscillation",
                what=self._names[k],
                turns_n=turns[k],
                swing=self._swing[k],
                ticks=WINDOW_TICKS,
                bound_n=TURNS_MAX,
            )


class _TurnCounter:
    """Counts how often targets turned back by more than `swing` (m,) in the last ticks."""

    def __init__(self, swing: Array) -> None:
        self._swing = swing
        self._extreme: Array | None = None
        """Of each target, since it last turned."""
        self._direction = np.zeros_like(swing)
        """1, -1, or 0 before a target has moved by its swing."""
        nothing = np.zeros(len(swing), dtype=bool)
        self._window: deque[NDArray[np.bool_]] = deque([nothing] * WINDOW_TICKS)
        self._turns = np.zeros(len(swing), dtype=int)

    def add(self, targets: Array) -> NDArray[np.int_]:
        """Return the turns (m,) in the window that ends with `targets` (m,)."""
        if self._extreme is None:
            self._extreme = targets.copy()
        away = targets - self._extreme
        unmoved = self._direction == 0.0
        begins = unmoved & (np.abs(away) > self._swing)
        turns_back = self._direction * away < -self._swing
        changed = begins | turns_back
        onward = changed | (self._direction * away > 0.0)
        turned = changed & ~unmoved
        self._window.append(turned)
        self._turns += turned.astype(int) - self._window.popleft()
        self._direction = np.where(changed, np.sign(away), self._direction)
        self._extreme = np.where(onward, targets, self._extreme)
        return self._turns
