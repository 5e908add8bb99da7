"""How good a demonstration is: smoothness, straightness, and how much of the workspace it visits.

Quality never changes a recording. `filter_by_jerk` says which ones to leave out, and how many those were.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minidual.demos.episode import Episode
from minidual.demos.smoothness import rms_jerk
from minidual.errors import DataError

#: Edge of the cubes in which coverage is counted, metres.
CELL_M = 0.05
#: Gripper commands either side of the middle between their extremes count as open and closed.
_MIDDLE = 0.5

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EpisodeQuality:
    """One episode's record.

    Attributes:
        file: Name of the recording.
        success: Whether it achieved the task.
        duration_s: First tick to last.
        ticks: Number of ticks.
        rms_jerk_rad_s3: `minidual.demos.smoothness.rms_jerk` of the measured joints.
        path_length_m: Path of a hand, mean of the two.
        path_efficiency: See `path_efficiency`; the mean of both hands.
        cells_n: Cubes of 5 cm that either hand visits.
    """

    file: str
    success: bool
    duration_s: float
    ticks: int
    rms_jerk_rad_s3: float
    path_length_m: float
    path_efficiency: float
    cells_n: int

    def to_dict(self) -> dict[str, Any]:
        """Return the record for JSON or CSV."""
        return asdict(self)


@dataclass(frozen=True)
class JerkFilter:
    """Which episodes stay under a jerk limit, which go, and the counts before and after."""

    limit_rad_s3: float
    kept: tuple[EpisodeQuality, ...]
    dropped: tuple[EpisodeQuality, ...]

    @property
    def before_n(self) -> int:
        """Number of episodes before the filter."""
        return len(self.kept) + len(self.dropped)

    @property
    def after_n(self) -> int:
        """Number of episodes after the filter."""
        return len(self.kept)


@dataclass(frozen=True)
class Coverage:
    """How much of a box the hands of a data set visit.

    Attributes:
        left_n: Cubes of 5 cm the left hand visits inside the box.
        right_n: The right hand's.
        both_n: Visited by either.
        box_n: Cubes in the box.
    """

    left_n: int
    right_n: int
    both_n: int
    box_n: int

    @property
    def share(self) -> float:
        """Visited share of the box."""
        return self.both_n / self.box_n


def tcp_positions(q: NDArray[np.floating]) -> Array:
    """Return the positions (T, 2, 3), metres in the world, of the left and right tool centre for q (T, 14)."""
    from minidual.robot.kinematics import Kinematics

    kinematics = Kinematics()
    return np.array([[pose[:3, 3] for pose in kinematics.tcp_poses(row)] for row in np.asarray(q, dtype=float)])


def path_length_m(positions: NDArray[np.floating]) -> Array:
    """Return the length of each hand's path, (2,) metres, for positions (T, 2, 3)."""
    return np.linalg.norm(np.diff(positions, axis=0), axis=2).sum(axis=0)


def path_efficiency(positions: NDArray[np.floating], action_gripper: NDArray[np.floating]) -> float:
    """Return straight length over travelled length, 0 to 1, mean of the two hands.

    Straight means by straight segments from the start through every change of the hand's own grip to the
    end, since a hand that picks, carries and comes home would otherwise count as going nowhere. A hand that
    travels less than 1 cm is left out; with neither moving the result is 1.

    Args:
        positions: (T, 2, 3) tool centres, metres.
        action_gripper: (T, 2) gripper commands, any unit.
    """
    shares: list[float] = []
    for hand in range(2):
        path = positions[:, hand]
        travelled = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
        if travelled < 0.01:
            continue
        stops = [0, *grip_changes(action_gripper[:, hand]), len(path) - 1]
        straight = float(np.linalg.norm(np.diff(path[stops], axis=0), axis=1).sum())
        shares.append(straight / travelled)
    return float(np.mean(shares)) if shares else 1.0


def grip_changes(command: NDArray[np.floating]) -> list[int]:
    """Return the ticks at which one gripper's command (T,) crosses the middle between its extremes."""
    low, high = float(np.min(command)), float(np.max(command))
    if high - low < 1e-6:
        return []
    above = command > low + _MIDDLE * (high - low)
    return (np.flatnonzero(above[1:] != above[:-1]) + 1).tolist()


def cells(positions: NDArray[np.floating], cell_m: float = CELL_M) -> set[tuple[int, int, int]]:
    """Return the cubes that the points (..., 3) fall in, as integer indices."""
    indices = np.floor(np.asarray(positions).reshape(-1, 3) / cell_m).astype(int)
    return {(int(x), int(y), int(z)) for x, y, z in np.unique(indices, axis=0)}


def coverage(
    positions: Sequence[NDArray[np.floating]],
    low_m: Sequence[float] = (0.3, -0.4, 0.0),
    high_m: Sequence[float] = (0.7, 0.4, 0.4),
    cell_m: float = CELL_M,
) -> Coverage:
    """Return how much of a box the hands visit over several episodes, each (T, 2, 3) metres.

    The default box is the part of the table's airspace between and before the two bases.
    """
    size = np.subtract(high_m, low_m)
    if np.any(size < cell_m):
        raise DataError(f"the box {low_m} to {high_m} m holds no cube of {cell_m} m")
    counts = np.floor(size / cell_m + 1e-9).astype(int)
    visited: list[set[tuple[int, int, int]]] = [set(), set()]
    for episode in positions:
        for hand in range(2):
            local = episode[:, hand] - np.asarray(low_m)
            inside = np.all((local >= 0.0) & (local < counts * cell_m), axis=1)
            visited[hand] |= cells(local[inside], cell_m)
    return Coverage(len(visited[0]), len(visited[1]), len(visited[0] | visited[1]), int(np.prod(counts)))


def episode_quality(episode: Episode, positions: NDArray[np.floating] | None = None) -> EpisodeQuality:
    """Return one episode's record.

    Args:
        episode: The recording; pictures are not needed.
        positions: (T, 2, 3) tool centres if they are known already; computed from qpos when None.

    Raises:
        DataError: the episode is too short for a jerk (half a second), or not finite.
    """
    hands = tcp_positions(episode.qpos) if positions is None else np.asarray(positions)
    return EpisodeQuality(
        file=episode.path.name if episode.path is not None else "",
        success=episode.meta.success,
        duration_s=episode.duration_s,
        ticks=len(episode),
        rms_jerk_rad_s3=rms_jerk(episode.qpos, episode.meta.fps),
        path_length_m=float(path_length_m(hands).mean()),
        path_efficiency=path_efficiency(hands, episode.action_gripper),
        cells_n=len(cells(hands)),
    )


def filter_by_jerk(records: Sequence[EpisodeQuality], limit_rad_s3: float) -> JerkFilter:
    """Part episodes at a jerk limit, rad/s^3; a jerk that is NaN is dropped, never kept."""
    kept = tuple(record for record in records if record.rms_jerk_rad_s3 <= limit_rad_s3)
    dropped = tuple(record for record in records if not record.rms_jerk_rad_s3 <= limit_rad_s3)
    return JerkFilter(limit_rad_s3, kept, dropped)


def quality_of(paths: Sequence[Path | str]) -> list[EpisodeQuality]:
    """Return the record of each file, in order; raises as `read_episode` and `episode_quality`."""
    from minidual.demos.episode import read_episode

    return [episode_quality(read_episode(path, cameras=())) for path in paths]
