"""Quality measures of a demonstration."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from minidual.demos.episode import Episode
from minidual.demos.smoothness import rms_jerk
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array

CELL_M = 0.05
"""Cube edge of the workspace count."""


@dataclass(frozen=True)
class EpisodeQuality:
    """Measures of one recording.

    Attributes:
        path_length_m: Mean of both hands.
        cells_n: 5 cm cubes that hands visit.
    """

    ticks: int
    duration_s: float
    rms_jerk_rad_s3: float
    path_length_m: float
    path_efficiency: float
    cells_n: int


def episode_quality(episode: Episode, kinematics: Kinematics) -> EpisodeQuality:
    """Return the measures; DataError if shorter than 0.5 s."""
    hands = tcp_positions(episode.qpos, kinematics)
    return EpisodeQuality(
        ticks=len(episode),
        duration_s=episode.duration_s,
        rms_jerk_rad_s3=rms_jerk(episode.qpos, episode.meta.fps),
        path_length_m=float(path_length_m(hands).mean()),
        path_efficiency=path_efficiency(hands, episode.action_gripper),
        cells_n=len(np.unique(np.floor(hands.reshape(-1, 3) / CELL_M), axis=0)),
    )


def tcp_positions(q: NDArray[np.floating], kinematics: Kinematics) -> Array:
    """Return TCPs (T, 2, 3) [m] for postures (T, n)."""
    return np.array([[pose[:3, 3] for pose in kinematics.tcp_poses(row)] for row in np.asarray(q, dtype=float)])


def path_length_m(positions: NDArray[np.floating]) -> Array:
    """Return each hand's path length (2,)."""
    return np.linalg.norm(np.diff(positions, axis=0), axis=2).sum(axis=0)


def path_efficiency(positions: NDArray[np.floating], action_gripper: NDArray[np.floating]) -> float:
    """Return straight over travelled length, 0 to 1, mean of both hands.

    The straight path goes through the places of grip changes. Hands moving under 1 cm are left out; 1 if both are.
    `positions` are TCPs (T, 2, 3) [m], `action_gripper` is (T, 2).
    """
    shares: list[float] = []
    for hand in range(2):
        path = positions[:, hand]
        travelled = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
        if travelled >= 0.01:
            stops = [0, *grip_changes(action_gripper[:, hand]), len(path) - 1]
            shares.append(float(np.linalg.norm(np.diff(path[stops], axis=0), axis=1).sum()) / travelled)
    return float(np.mean(shares)) if shares else 1.0


def grip_changes(command: NDArray[np.floating]) -> list[int]:
    """Return the ticks where a command (T,) crosses mid-range."""
    low, high = float(np.min(command)), float(np.max(command))
    if high - low < 1e-6:
        return []
    above = command > 0.5 * (low + high)
    return (np.flatnonzero(above[1:] != above[:-1]) + 1).tolist()
