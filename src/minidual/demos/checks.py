"""Checks of an episode's arrays; they yield every `EpisodeFault` instead of raising."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from minidual.demos import schema
from minidual.registry import rows_beside
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

REMEDIES: dict[str, str] = rows_beside(__file__, "remedies.yaml")


class EpisodeFault(NamedTuple):
    """One fault; `name` is stable."""

    name: str
    detail: str

    @property
    def remedy(self) -> str:
        """What to do."""
        return REMEDIES.get(self.name, "record this episode again")

    def __str__(self) -> str:
        return f"{self.name}: {self.detail} (remedy: {self.remedy})"


def check_finite(arrays: Mapping[str, Array]) -> Iterator[EpisodeFault]:
    """Report arrays with NaN or infinity."""
    for key, values in arrays.items():
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            detail = f"{key} holds {len(bad)} values that are NaN or infinite, the first at tick {int(bad[0][0])}"
            yield EpisodeFault("not_finite", detail)


def check_monotonic(timestamps: Array, key: str) -> Iterator[EpisodeFault]:
    """Report timestamps that do not strictly increase."""
    held = np.flatnonzero(~(np.diff(timestamps) > 0.0))
    if held.size:
        k = int(held[0])
        detail = f"{key} goes from {timestamps[k]:.6f} s to {timestamps[k + 1]:.6f} s between ticks {k} and {k + 1}"
        yield EpisodeFault("timestamps_not_monotonic", detail)


def check_action_is_command(qpos: Array, action: Array) -> Iterator[EpisodeFault]:
    """Report actions that equal the readings."""
    share = np.mean(np.max(np.abs(action - qpos), axis=1) <= ACTION_EQUAL_RAD)
    if share >= ACTION_EQUAL_SHARE:
        detail = f"action[t] equals qpos[t] on {share:.0%} of the ticks; a policy would learn to stand still"
        yield EpisodeFault("action_equals_qpos", detail)


def check_rate(timestamps: Array, fps: float) -> Iterator[EpisodeFault]:
    """Report a median interval off by 2 %, or any off by half a period; needs two ticks."""
    steps = np.diff(timestamps)
    period_s = 1.0 / fps
    median_s = float(np.median(steps))
    if abs(median_s - period_s) > 0.02 * period_s:
        yield EpisodeFault(
            "rate_wrong",
            f"ticks come at {1.0 / median_s:.2f} Hz, the file declares {fps:g} Hz",
        )
    deviation = np.abs(steps - period_s)
    limit_s = 0.5 * period_s
    worst = int(np.argmax(deviation))
    if deviation[worst] > limit_s:
        stray = f"{int(np.sum(deviation > limit_s))} intervals stray more than {1e3 * limit_s:.1f} ms from"
        found = f"{1e3 * period_s:.1f} ms; the worst is {1e3 * float(steps[worst]):.1f} ms at tick {worst}"
        yield EpisodeFault("timestamps_jitter", f"{stray} {found}")


def check_sync(timestamps: Array, image_timestamps: Array) -> Iterator[EpisodeFault]:
    """Report images more than 20 ms from their tick's joints."""
    offset = np.abs(image_timestamps - timestamps)
    worst = int(np.argmax(offset))
    limit_ms = 1e3 * schema.MAX_SYNC_S
    if offset[worst] > schema.MAX_SYNC_S:
        apart = f"up to {1e3 * float(offset[worst]):.1f} ms from the joints (tick {worst})"
        yield EpisodeFault("out_of_sync", f"images lie {apart}; the limit is {limit_ms:.0f} ms")


def check_limits(qpos: Array, robot: Robot) -> Iterator[EpisodeFault]:
    """Report joints outside the limits, or a wrong joint count."""
    if qpos.shape[1] != robot.dof:
        detail = (
            f"the file holds {qpos.shape[1]} joints; two {robot.arm.name} arms have {robot.dof}"
        )
        yield EpisodeFault("joints_wrong", detail)
        return
    lower = robot.q_lower - LIMIT_TOLERANCE_RAD
    upper = robot.q_upper + LIMIT_TOLERANCE_RAD
    outside = (qpos < lower) | (qpos > upper)
    joints = np.flatnonzero(outside.any(axis=0))
    if joints.size:
        joint = int(joints[0])
        tick = int(np.argmax(outside[:, joints[0]]))
        found = f"joint index {joint} is at {qpos[tick, joint]:.4f} rad at tick {tick}"
        allowed = f"allowed {robot.q_lower[joint]:.4f} to {robot.q_upper[joint]:.4f}"
        yield EpisodeFault(
            "outside_joint_limits",
            f"{joints.size} joints leave their limits; {found}, {allowed}",
        )


def check_images(images: Images, qpos: Array) -> Iterator[EpisodeFault]:
    """Report images (T, H, W, 3) that are black, of one colour, duplicated, or frozen during motion."""
    moved = bool(np.max(np.ptp(qpos, axis=0)) > FROZEN_MOTION_RAD)
    for camera, frames in images.items():
        # Two calls each: one over both axes takes 40 times as long.
        highest = frames.max(axis=1).max(axis=1)
        lowest = frames.min(axis=1).min(axis=1)
        black = highest.max(axis=1) <= BLACK_LEVEL
        constant = np.all(highest == lowest, axis=1) & ~black
        for name, bad in (("images_black", black), ("images_constant", constant)):
            if bad.any():
                where = f"{int(bad.sum())} of {len(frames)} frames, the first at tick {int(np.argmax(bad))}"
                yield EpisodeFault(name, f"camera '{camera}': {where}")
        if moved and all(np.array_equal(frame, frames[0]) for frame in frames):
            detail = f"camera '{camera}' shows the same image on all {len(frames)} ticks while the joints move"
            yield EpisodeFault("images_frozen", detail)
    for first, second in combinations(images, 2):
        if np.array_equal(images[first], images[second]):
            yield EpisodeFault(
                "cameras_identical",
                f"cameras '{first}' and '{second}' hold the same images",
            )


def thumbnails(images: Images) -> Thumbnails:
    """Return each camera's first image as means over areas, at most (12, 16, 3)."""
    found: dict[str, NDArray[np.float64]] = {}
    for camera, (first, *_) in images.items():
        size = min(16, first.shape[1]), min(12, first.shape[0])
        found[camera] = cv2.resize(first.astype(np.float64), size, interpolation=cv2.INTER_AREA)
    return found


def camera_references(episodes: Sequence[Thumbnails]) -> Thumbnails:
    """Return each camera's median thumbnail over episodes."""
    names = {camera for views in episodes for camera in views}
    return {
        c: np.median(np.stack([views[c] for views in episodes if c in views]), axis=0)
        for c in names
    }


def check_swapped(views: Thumbnails, references: Thumbnails) -> Iterator[EpisodeFault]:
    """Report thumbnails nearer to another camera's reference."""
    for camera, view in views.items():
        apart = {
            c: float(np.mean(np.abs(view - r)))
            for c, r in references.items()
            if r.shape == view.shape
        }
        nearest = min(apart, key=apart.__getitem__, default=camera)
        if camera in apart and nearest != camera:
            means = f"mean difference {apart[nearest]:.1f} of 255 against {apart[camera]:.1f}"
            detail = (
                f"camera '{camera}' shows what '{nearest}' shows in the other episodes ({means})"
            )
            yield EpisodeFault("cameras_swapped", detail)
