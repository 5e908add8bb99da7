"""Quality measures of a demonstration, and RMS jerk for recordings and benchmarks.

For the jerk, resampling and a zero-phase low-pass make it independent of the rate.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from minidual.demos.episode import Episode
from minidual.errors import DataError
from minidual.registry import rows_beside
from minidual.robot.kinematics import Kinematics, path_length
from minidual.robot.pair import Array

CELL_M = 0.05
"""Cube edge of the workspace count."""
FILTER_ORDER = 4
CUTOFF_HZ = 10.0
INTERNAL_RATE_HZ = 1000.0
TRIM_S = 2.0 / CUTOFF_HZ
"""Time left out at each end, at any cutoff."""
MIN_DURATION_S = 2.5 * TRIM_S

JERK_FILTER: str = rows_beside(__file__)
"""The filter in words."""


class EpisodeQuality(NamedTuple):
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
        duration_s=float(episode.timestamps[-1] - episode.timestamps[0]),
        rms_jerk_rad_s3=rms_jerk(episode.qpos, episode.meta.fps),
        path_length_m=float(path_length(hands).mean()),
        path_efficiency=path_efficiency(hands, episode.action_gripper),
        cells_n=len(np.unique(np.floor(hands.reshape(-1, 3) / CELL_M), axis=0)),
    )


def tcp_positions(q: NDArray[np.floating], kinematics: Kinematics) -> Array:
    """Return TCPs (T, 2, 3) [m] for postures (T, n)."""
    return np.array(
        [[pose[:3, 3] for pose in kinematics.tcp_poses(row)] for row in np.asarray(q, dtype=float)],
    )


def path_efficiency(positions: NDArray[np.floating], action_gripper: NDArray[np.floating]) -> float:
    """Return straight over travelled length, 0 to 1, mean of both hands.

    The straight path goes through the places of grip changes. Hands moving under 1 cm are left out; 1 if both are.
    `positions` are TCPs (T, 2, 3) [m], `action_gripper` is (T, 2).
    """
    shares: list[float] = []
    for hand, travelled in enumerate(path_length(positions)):
        if travelled >= 0.01:
            stops = [0, *grip_changes(action_gripper[:, hand]), -1]
            shares.append(path_length(positions[stops, hand]) / travelled)
    return float(np.mean(shares)) if shares else 1.0


def grip_changes(command: NDArray[np.floating]) -> list[int]:
    """Return the ticks where a command (T,) crosses mid-range."""
    low = float(np.min(command))
    high = float(np.max(command))
    if high - low < 1e-6:
        return []
    above = command > 0.5 * (low + high)
    return (np.flatnonzero(above[1:] != above[:-1]) + 1).tolist()


def rms_jerk(q: NDArray[np.floating], rate_hz: float, cutoff_hz: float = CUTOFF_HZ) -> float:
    """Return sqrt(mean over t of sum over joints of (d3q/dt3)^2), rad/s^3, of q (T, n) [rad].

    DataError below four times the cutoff, under 0.5 s, or if not finite.
    """
    from scipy.interpolate import make_interp_spline  # slow import, not needed for JERK_FILTER
    from scipy.signal import butter, sosfiltfilt

    q = np.asarray(q, dtype=np.float64)
    if q.ndim != 2 or q.shape[1] == 0:
        raise DataError(f"jerk needs joint positions of shape (T, joints), got {q.shape}")
    if not (np.isfinite(rate_hz) and rate_hz >= 4.0 * cutoff_hz):
        raise DataError(
            f"jerk with a {cutoff_hz:g} Hz cutoff needs at least {4 * cutoff_hz:g} Hz, got {rate_hz:g} Hz",
        )
    if (len(q) - 1) / rate_hz < MIN_DURATION_S - 1e-9:
        raise DataError(
            f"jerk needs at least {MIN_DURATION_S:.2f} s of motion, got {len(q)} samples at {rate_hz:g} Hz",
        )
    if not np.all(np.isfinite(q)):
        raise DataError("jerk needs finite joint positions; the motion holds NaN or infinity")

    factor = max(1, int(np.ceil(INTERNAL_RATE_HZ / rate_hz - 1e-9)))
    rate = rate_hz * factor
    if factor > 1:
        ticks = np.arange(len(q), dtype=np.float64)
        q = make_interp_spline(ticks, q, k=5, axis=0)(np.arange((len(q) - 1) * factor + 1) / factor)
    sos = butter(FILTER_ORDER, cutoff_hz, fs=rate, output="sos")
    # Subtracting the start avoids rounding error in the third difference.
    smooth = sosfiltfilt(sos, q - q[0], axis=0, padlen=min(len(q) - 1, int(TRIM_S * rate)))
    # Central third difference: (q[+2] - 2 q[+1] + 2 q[-1] - q[-2]) / (2 dt^3).
    third = (smooth[4:] - 2.0 * smooth[3:-1] + 2.0 * smooth[1:-3] - smooth[:-4]) * (0.5 * rate**3)
    trim = round(TRIM_S * rate) - 2
    return float(np.sqrt(np.mean(np.sum(third[trim:-trim] ** 2, axis=1))))
