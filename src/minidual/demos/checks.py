"""Checks of an episode's arrays; they yield every `Problem` instead of raising."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from minidual.demos import schema
from minidual.robot.pair import Robot

Array = NDArray[np.floating]
Images = Mapping[str, NDArray[np.uint8]]
Thumbnails = Mapping[str, NDArray[np.float32]]

ACTION_EQUAL_RAD = 1e-6
"""Largest difference of an equal command and reading; real tracking is never this exact."""
ACTION_EQUAL_SHARE = 0.95
"""Share of equal ticks that is a fault."""
BLACK_LEVEL = 8
"""Largest pixel value of a black image."""
FROZEN_MOTION_RAD = 0.05
"""Joint motion during which an image must change."""
_LIMIT_TOLERANCE_RAD = 1e-3


@dataclass(frozen=True)
class Problem:
    """One fault; `name` is stable."""

    name: str
    detail: str
    remedy: str = "record this episode again"

    def __str__(self) -> str:
        return f"{self.name}: {self.detail} (remedy: {self.remedy})"


def check_finite(arrays: Mapping[str, Array]) -> Iterator[Problem]:
    """Report arrays with NaN or infinity."""
    for key, values in arrays.items():
        bad = ~np.isfinite(values)
        if bad.any():
            yield Problem(
                "not_finite",
                f"{key} holds {int(bad.sum())} values that are NaN or infinite, the first at tick "
                f"{int(np.argwhere(bad)[0][0])}",
                "record the episode again; look for an unstable simulation or a lost sensor",
            )


def check_monotonic(timestamps: Array, key: str = "timestamps") -> Iterator[Problem]:
    """Report timestamps that do not strictly increase."""
    stuck = ~(np.diff(timestamps) > 0.0)
    if stuck.any():
        tick = int(np.argmax(stuck))
        yield Problem(
            "timestamps_not_monotonic",
            f"{key} goes from {timestamps[tick]:.6f} s to {timestamps[tick + 1]:.6f} s between ticks {tick} and "
            f"{tick + 1}",
            "stamp ticks with a monotonic clock (simulation time, or time.monotonic on hardware)",
        )


def check_action_is_command(qpos: Array, action: Array) -> Iterator[Problem]:
    """Report actions that equal the readings."""
    equal = np.max(np.abs(action - qpos), axis=1) <= ACTION_EQUAL_RAD
    if equal.size and equal.mean() >= ACTION_EQUAL_SHARE:
        yield Problem(
            "action_equals_qpos",
            f"action[t] equals qpos[t] on {equal.mean():.0%} of the ticks; a policy would learn to stand still",
            "record the command sent at t (the one that leads to t + 1), not the reading",
        )


def check_rate(timestamps: Array, fps: float, max_jitter_s: float | None = None) -> Iterator[Problem]:
    """Report a median interval off by 2 %, or any off by `max_jitter_s` (default half a period)."""
    steps, period_s = np.diff(timestamps), 1.0 / fps
    if not steps.size:
        return
    median_s = float(np.median(steps))
    if abs(median_s - period_s) > 0.02 * period_s:
        measured = f"{1.0 / median_s:.2f} Hz" if median_s > 0.0 else "no rate"
        yield Problem(
            "rate_wrong",
            f"ticks come at {measured}, the file declares {fps:g} Hz",
            "declare the rate the recorder really ran at, or slow the recorder down",
        )
    limit_s = 0.5 * period_s if max_jitter_s is None else max_jitter_s
    deviation = np.abs(steps - period_s)
    worst = int(np.argmax(deviation))
    if deviation[worst] > limit_s:
        yield Problem(
            "timestamps_jitter",
            f"{int(np.sum(deviation > limit_s))} intervals stray more than {1e3 * limit_s:.1f} ms from "
            f"{1e3 * period_s:.1f} ms; the worst is {1e3 * float(steps[worst]):.1f} ms at tick {worst}",
            "drive the recorder by simulation time, or free the machine of other load",
        )


def check_sync(timestamps: Array, image_timestamps: Array) -> Iterator[Problem]:
    """Report images more than 20 ms from their tick's joints."""
    offset = np.abs(image_timestamps - timestamps)
    worst = int(np.argmax(offset))
    if offset[worst] > schema.MAX_SYNC_S:
        yield Problem(
            "out_of_sync",
            f"images lie up to {1e3 * float(offset[worst]):.1f} ms from the joints (tick {worst}); the limit is "
            f"{1e3 * schema.MAX_SYNC_S:.0f} ms",
            "stamp joints, images and action in the same tick, and pair the nearest ones",
        )


def check_limits(qpos: Array, robot: Robot) -> Iterator[Problem]:
    """Report joints outside the limits, or a wrong joint count."""
    if qpos.shape[1] != robot.dof:
        yield Problem(
            "joints_wrong",
            f"the file holds {qpos.shape[1]} joints; two {robot.arm.name} arms have {robot.dof}",
            "choose the arm that was recorded: --set robot.arm=NAME",
        )
        return
    outside = (qpos < robot.q_lower - _LIMIT_TOLERANCE_RAD) | (qpos > robot.q_upper + _LIMIT_TOLERANCE_RAD)
    joints = np.flatnonzero(outside.any(axis=0))
    if joints.size:
        joint, tick = int(joints[0]), int(np.argmax(outside[:, joints[0]]))
        yield Problem(
            "outside_joint_limits",
            f"{joints.size} joints leave their limits; joint index {joint} is at {qpos[tick, joint]:.4f} rad at tick "
            f"{tick}, allowed {robot.q_lower[joint]:.4f} to {robot.q_upper[joint]:.4f}",
            "check the joint order (left arm, then right arm), the units (rad) and the follower's limits",
        )


def check_images(images: Images, qpos: Array) -> Iterator[Problem]:
    """Report images (T, H, W, 3) that are black, of one colour, duplicated, or frozen during motion."""
    moved = bool(np.max(np.ptp(qpos, axis=0)) > FROZEN_MOTION_RAD)
    for camera, frames in images.items():
        flat = frames.reshape(len(frames), -1, frames.shape[-1])
        black = flat.max(axis=(1, 2)) <= BLACK_LEVEL
        constant = np.all(flat.max(axis=1) == flat.min(axis=1), axis=1) & ~black
        for name, bad in (("images_black", black), ("images_constant", constant)):
            if bad.any():
                yield Problem(
                    name,
                    f"camera '{camera}': {int(bad.sum())} of {len(frames)} frames, the first at tick "
                    f"{int(np.argmax(bad))}",
                    "check the renderer (MUJOCO_GL=egl), the lights, and that the camera looks at the table",
                )
        if moved and len(frames) > 1 and not any(np.any(frame != frames[0]) for frame in frames[1:]):
            yield Problem(
                "images_frozen",
                f"camera '{camera}' shows the same image on all {len(frames)} ticks while the joints move",
                "update the scene before each rendering; on hardware check the camera's stream",
            )
    for first, second in combinations(images, 2):
        if np.array_equal(images[first], images[second]):
            yield Problem(
                "cameras_identical",
                f"cameras '{first}' and '{second}' hold the same images",
                "check which camera each name renders",
            )


def thumbnails(images: Images) -> Thumbnails:
    """Return block means (12, 16, 3) of first images."""
    return {camera: _thumbnail(frames[0]) for camera, frames in images.items()}


def _thumbnail(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    rows, columns = (np.array_split(np.arange(n), min(k, n)) for n, k in zip(image.shape, (12, 16), strict=False))
    blocks = [[image[r[0] : r[-1] + 1, c[0] : c[-1] + 1].mean(axis=(0, 1)) for c in columns] for r in rows]
    return np.asarray(blocks, dtype=np.float32)


def camera_references(episodes: Sequence[Thumbnails]) -> Thumbnails:
    """Return each camera's median thumbnail.

    Fixed cameras give similar first images in every episode.
    """
    names = {camera for views in episodes for camera in views}
    return {c: np.median(np.stack([views[c] for views in episodes if c in views]), axis=0) for c in names}


def check_swapped(views: Thumbnails, references: Thumbnails) -> Iterator[Problem]:
    """Report thumbnails nearer to another camera's reference."""
    for camera, view in views.items():
        apart = {c: float(np.mean(np.abs(view - r))) for c, r in references.items() if r.shape == view.shape}
        nearest = min(apart, key=apart.__getitem__, default=camera)
        if camera in apart and nearest != camera:
            yield Problem(
                "cameras_swapped",
                f"camera '{camera}' shows what '{nearest}' shows in the other episodes (mean difference "
                f"{apart[nearest]:.1f} of 255 against {apart[camera]:.1f})",
                "check the order in which cameras are rendered and named; on hardware, the cables",
            )
