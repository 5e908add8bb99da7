"""The faults that arrays of one episode can have, each with its name and its remedy.

Pure functions on arrays: the writer runs the first group before a file exists, validation runs all of
them on files. A fault is a `Problem`, never an exception, so that one pass reports all of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from minidual.demos import schema

Array = NDArray[np.floating]

#: Below this difference a command "is" the reading: real tracking never agrees so well on 14 joints.
ACTION_EQUAL_RAD = 1e-6
#: Share of ticks on which they must agree for the recording to be at fault.
ACTION_EQUAL_SHARE = 0.95
#: An image whose brightest value is at most this is black.
BLACK_LEVEL = 8
#: Joint motion (rad, largest joint) beyond which a picture that never changes is at fault.
FROZEN_MOTION_RAD = 0.05


@dataclass(frozen=True)
class Problem:
    """One fault: a stable `name` for programs, a `detail` with numbers, and a `remedy` for people."""

    name: str
    detail: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.name}: {self.detail} (remedy: {self.remedy})"


def check_finite(arrays: Mapping[str, Array]) -> list[Problem]:
    """Report each array that holds NaN or infinity, with its first bad tick."""
    problems: list[Problem] = []
    for key, values in arrays.items():
        bad = ~np.isfinite(values)
        if bad.any():
            tick = int(np.argwhere(bad)[0][0])
            problems.append(
                Problem(
                    "not_finite",
                    f"{key} holds {int(bad.sum())} values that are NaN or infinite, the first at tick {tick}",
                    "record the episode again; look for an unstable simulation or a lost sensor",
                )
            )
    return problems


def check_monotonic(timestamps: Array, key: str = schema.TIMESTAMPS) -> list[Problem]:
    """Report time that does not strictly increase."""
    steps = np.diff(timestamps)
    if steps.size and not bool(np.all(steps > 0.0)):
        tick = int(np.argmax(~(steps > 0.0)))
        return [
            Problem(
                "timestamps_not_monotonic",
                f"{key} goes from {timestamps[tick]:.6f} s to {timestamps[tick + 1]:.6f} s "
                f"between ticks {tick} and {tick + 1}",
                "stamp ticks with a monotonic clock (simulation time, or time.monotonic on hardware)",
            )
        ]
    return []


def check_action_is_command(qpos: Array, action: Array) -> list[Problem]:
    """Report a recording whose action is the measured position: qpos (T, 14) and action (T, 14) in rad."""
    equal = np.max(np.abs(action - qpos), axis=1) <= ACTION_EQUAL_RAD
    share = float(np.mean(equal)) if equal.size else 0.0
    if share >= ACTION_EQUAL_SHARE:
        return [
            Problem(
                "action_equals_qpos",
                f"action[t] equals qpos[t] on {share:.0%} of the ticks; a policy would learn to stand still",
                "record the command sent at t (the one that leads to t + 1), not the reading",
            )
        ]
    return []


def check_rate(timestamps: Array, fps: float, max_jitter_s: float | None = None) -> list[Problem]:
    """Report ticks that stray from the recording rate.

    Args:
        timestamps: (T,) seconds.
        fps: The rate that the file declares, 1/s.
        max_jitter_s: Largest |interval - 1/fps|; half a period when None.
    """
    steps = np.diff(timestamps)
    if not steps.size:
        return []
    period_s = 1.0 / fps
    problems: list[Problem] = []
    median_s = float(np.median(steps))
    if abs(median_s - period_s) > 0.02 * period_s:
        measured = f"{1.0 / median_s:.2f} Hz" if median_s > 0.0 else "no rate"
        problems.append(
            Problem(
                "rate_wrong",
                f"ticks come at {measured}, the file declares {fps:g} Hz",
                "declare the rate the recorder really ran at, or slow the recorder down",
            )
        )
    limit_s = 0.5 * period_s if max_jitter_s is None else max_jitter_s
    deviation = np.abs(steps - period_s)
    worst = int(np.argmax(deviation))
    if deviation[worst] > limit_s:
        count = int(np.sum(deviation > limit_s))
        problems.append(
            Problem(
                "timestamps_jitter",
                f"{count} intervals stray more than {1e3 * limit_s:.1f} ms from {1e3 * period_s:.1f} ms; the "
                f"worst is {1e3 * float(steps[worst]):.1f} ms at tick {worst}",
                "drive the recorder by simulation time, or free the machine of other load",
            )
        )
    return problems


def check_sync(timestamps: Array, image_timestamps: Array, max_sync_s: float = schema.MAX_SYNC_S) -> list[Problem]:
    """Report images taken at another time than the joints of their tick."""
    offset = np.abs(image_timestamps - timestamps)
    worst = int(np.argmax(offset)) if offset.size else 0
    if offset.size and offset[worst] > max_sync_s:
        return [
            Problem(
                "out_of_sync",
                f"images lie up to {1e3 * float(offset[worst]):.1f} ms from the joints (tick {worst}); "
                f"the limit is {1e3 * max_sync_s:.0f} ms",
                "stamp joints, images and action in the same tick, and pair the nearest ones",
            )
        ]
    return []


def check_limits(qpos: Array, lower: Array, upper: Array, tolerance_rad: float = 1e-3) -> list[Problem]:
    """Report joints outside their limits: qpos (T, 14), lower (14,), upper (14,), all rad."""
    below = qpos < np.asarray(lower) - tolerance_rad
    above = qpos > np.asarray(upper) + tolerance_rad
    joints = np.flatnonzero((below | above).any(axis=0))
    if not joints.size:
        return []
    joint = int(joints[0])
    tick = int(np.argmax((below | above)[:, joint]))
    return [
        Problem(
            "outside_joint_limits",
            f"{joints.size} joints leave their limits; joint index {joint} is at {qpos[tick, joint]:.4f} rad "
            f"at tick {tick}, allowed {lower[joint]:.4f} to {upper[joint]:.4f}",
            "check the joint order (left 1-7, then right 1-7), the units (rad) and the follower's limits",
        )
    ]


def check_images(images: Mapping[str, NDArray[np.uint8]], qpos: Array | None = None) -> list[Problem]:
    """Report pictures that carry nothing.

    Args:
        images: (T, H, W, 3) by camera.
        qpos: (T, 14) rad; with it a picture that never changes while joints move is reported too.

    Returns:
        `images_black` (some frame is black), `images_constant` (some frame has a single colour),
        `images_frozen` (no frame ever differs from the first), `cameras_identical` (two show the same).
    """
    problems: list[Problem] = []
    moved = qpos is not None and bool(np.max(np.ptp(qpos, axis=0)) > FROZEN_MOTION_RAD)
    for camera, frames in images.items():
        flat = frames.reshape(len(frames), -1, frames.shape[-1])
        black = flat.max(axis=(1, 2)) <= BLACK_LEVEL
        constant = np.all(flat.max(axis=1) == flat.min(axis=1), axis=1) & ~black
        for name, bad in (("images_black", black), ("images_constant", constant)):
            if bad.any():
                problems.append(
                    Problem(
                        name,
                        f"camera '{camera}': {int(bad.sum())} of {len(frames)} frames, "
                        f"the first at tick {int(np.argmax(bad))}",
                        "check the renderer (MUJOCO_GL=egl), the lights, and that the camera looks at the table",
                    )
                )
        if moved and len(frames) > 1 and not any(np.any(frame != frames[0]) for frame in frames[1:]):
            problems.append(
                Problem(
                    "images_frozen",
                    f"camera '{camera}' shows the same picture on all {len(frames)} ticks while the joints move",
                    "update the scene before each rendering; on hardware check the camera's stream",
                )
            )
    names = list(images)
    for i, first in enumerate(names):
        for second in names[i + 1 :]:
            if images[first].shape == images[second].shape and np.array_equal(images[first], images[second]):
                problems.append(
                    Problem(
                        "cameras_identical",
                        f"cameras '{first}' and '{second}' hold the same pictures",
                        "check which camera each name renders",
                    )
                )
    return problems
