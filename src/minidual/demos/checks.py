"""Checks of an episode's arrays; they yield every `EpisodeFault` instead of raising."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from minidual.demos import schema
from minidual.demos.faults import EpisodeFault
from minidual.robot.limits import joint_text
from minidual.robot.pair import Array, Robot

Images = Mapping[str, NDArray[np.uint8]]
Thumbnails = Mapping[str, NDArray[np.float64]]

ACTION_EQUAL_RAD = 1e-6
"""Command and reading closer than this are equal; real tracking is never this exact."""
ACTION_EQUAL_SHARE = 0.95
"""Least share of equal ticks that is a fault."""
BLACK_LEVEL = 8
"""Largest pixel value of a black image."""
FROZEN_MOTION_RAD = 0.05
"""Joint motion during which an image must change."""
LIMIT_TOLERANCE_RAD = 1e-3
MEDIAN_DEVIATION_SHARE = 0.02
JITTER_SHARE = 0.5
"""Largest deviation of the median interval, and of any interval, in periods."""
THUMBNAIL_WIDTH_PX = 16
THUMBNAIL_HEIGHT_PX = 12


def check_finite(arrays: Mapping[str, Array]) -> Iterator[EpisodeFault]:
    """Report arrays with NaN or infinity."""
    for key, values in arrays.items():
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            first_tick = int(bad[0][0])
            yield EpisodeFault(
                "not_finite",
                f"{key} holds {len(bad)} values that are NaN or infinite, "
                f"the first at tick {first_tick}",
            )


def check_monotonic(timestamps: Array, key: str) -> Iterator[EpisodeFault]:
    """Report timestamps that do not strictly increase."""
    increases = np.diff(timestamps) > 0.0  # False for NaN
    violations = np.flatnonzero(~increases)
    if violations.size:
        k = int(violations[0])
        yield EpisodeFault(
            "timestamps_not_monotonic",
            f"{key} goes from {timestamps[k]:.6f} s to {timestamps[k + 1]:.6f} s "
            f"between ticks {k} and {k + 1}",
        )


def check_action_is_command(qpos: Array, action: Array) -> Iterator[EpisodeFault]:
    """Report actions that equal the readings."""
    difference = np.max(np.abs(action - qpos), axis=1)
    share = np.mean(difference <= ACTION_EQUAL_RAD)
    if share >= ACTION_EQUAL_SHARE:
        yield EpisodeFault(
            "action_equals_qpos",
            f"action[t] equals qpos[t] on {share:.0%} of the ticks; "
            "a policy would learn to stand still",
        )


def check_rate(timestamps: Array, fps: float) -> Iterator[EpisodeFault]:
    """Report a median interval off by 2 %, or any off by half a period; needs two ticks."""
    intervals = np.diff(timestamps)
    period_s = 1.0 / fps
    median_s = float(np.median(intervals))
    if abs(median_s - period_s) > MEDIAN_DEVIATION_SHARE * period_s:
        yield EpisodeFault(
            "rate_wrong",
            f"ticks come at {1.0 / median_s:.2f} Hz, the file declares {fps:g} Hz",
        )
    deviation = np.abs(intervals - period_s)
    limit_s = JITTER_SHARE * period_s
    worst = int(np.argmax(deviation))
    if deviation[worst] > limit_s:
        count = int(np.sum(deviation > limit_s))
        yield EpisodeFault(
            "timestamps_jitter",
            f"{count} intervals stray more than {1e3 * limit_s:.1f} ms from "
            f"{1e3 * period_s:.1f} ms; the worst is {1e3 * float(intervals[worst]):.1f} ms "
            f"at tick {worst}",
        )


def check_sync(timestamps: Array, image_timestamps: Array) -> Iterator[EpisodeFault]:
    """Report images more than 20 ms from their tick's joints."""
    offset = np.abs(image_timestamps - timestamps)
    worst = int(np.argmax(offset))
    if offset[worst] > schema.MAX_SYNC_S:
        yield EpisodeFault(
            "out_of_sync",
            f"images lie up to {1e3 * float(offset[worst]):.1f} ms from the joints "
            f"(tick {worst}); the limit is {1e3 * schema.MAX_SYNC_S:.0f} ms",
        )


def check_limits(qpos: Array, robot: Robot) -> Iterator[EpisodeFault]:
    """Report joints outside the limits, or a wrong joint count."""
    joints_n = qpos.shape[1]
    if joints_n != robot.dof:
        yield EpisodeFault(
            "joints_wrong",
            f"the file holds {joints_n} joints; the arms {robot.name} have {robot.dof}",
        )
        return
    lower = robot.q_lower - LIMIT_TOLERANCE_RAD
    upper = robot.q_upper + LIMIT_TOLERANCE_RAD
    outside = (qpos < lower) | (qpos > upper)
    joints = np.flatnonzero(outside.any(axis=0))
    if joints.size:
        joint = int(joints[0])
        tick = int(np.argmax(outside[:, joint]))
        yield EpisodeFault(
            "outside_joint_limits",
            f"{joints.size} joints leave their limits; joint index {joint} is at "
            f"{joint_text(qpos[tick, joint])} rad at tick {tick}, allowed "
            f"{joint_text(robot.q_lower[joint])} to {joint_text(robot.q_upper[joint])}",
        )


def check_images(images: Images, qpos: Array) -> Iterator[EpisodeFault]:
    """Report images (T, H, W, 3) that are black, of one colour, duplicated, or frozen in motion."""
    moves = bool(np.max(np.ptp(qpos, axis=0)) > FROZEN_MOTION_RAD)
    for camera, frames in images.items():
        yield from _check_content(camera, frames)
        if moves and all(np.array_equal(frame, frames[0]) for frame in frames):
            yield EpisodeFault(
                "images_frozen",
                f"camera '{camera}' shows the same image on all {len(frames)} ticks "
                "while the joints move",
            )
    for first, second in combinations(images, 2):
        if np.array_equal(images[first], images[second]):
            yield EpisodeFault(
                "cameras_identical",
                f"cameras '{first}' and '{second}' hold the same images",
            )


def _check_content(camera: str, frames: NDArray[np.uint8]) -> Iterator[EpisodeFault]:
    # Two calls each: one over both axes takes 40 times as long.
    highest = frames.max(axis=1).max(axis=1)
    lowest = frames.min(axis=1).min(axis=1)
    black = highest.max(axis=1) <= BLACK_LEVEL
    constant = np.all(highest == lowest, axis=1) & ~black
    for name, bad in (("images_black", black), ("images_constant", constant)):
        if bad.any():
            yield EpisodeFault(
                name,
                f"camera '{camera}': {int(bad.sum())} of {len(frames)} frames, "
                f"the first at tick {int(np.argmax(bad))}",
            )


def thumbnails(images: Images) -> Thumbnails:
    """Return each camera's first image as means over areas, at most (12, 16, 3)."""
    views: dict[str, NDArray[np.float64]] = {}
    for camera, frames in images.items():
        first = frames[0].astype(np.float64)
        height, width = first.shape[:2]
        size = (min(THUMBNAIL_WIDTH_PX, width), min(THUMBNAIL_HEIGHT_PX, height))
        views[camera] = cv2.resize(first, size, interpolation=cv2.INTER_AREA)
    return views


def camera_references(episodes: Sequence[Thumbnails]) -> Thumbnails:
    """Return each camera's median thumbnail over episodes."""
    cameras = {camera for views in episodes for camera in views}
    references: dict[str, NDArray[np.float64]] = {}
    for camera in cameras:
        views_of_camera = [views[camera] for views in episodes if camera in views]
        references[camera] = np.median(np.stack(views_of_camera), axis=0)
    return references


def check_swapped(views: Thumbnails, references: Thumbnails) -> Iterator[EpisodeFault]:
    """Report thumbnails nearer to another camera's reference."""
    for camera, view in views.items():
        differences = {
            other: float(np.mean(np.abs(view - reference)))
            for other, reference in references.items()
            if reference.shape == view.shape
        }
        if camera not in differences:
            continue
        nearest = min(differences, key=differences.__getitem__)
        if nearest != camera:
            yield EpisodeFault(
                "cameras_swapped",
                f"camera '{camera}' shows what '{nearest}' shows in the other episodes "
                f"(mean difference {differences[nearest]:.1f} of 255 "
                f"against {differences[camera]:.1f})",
            )
