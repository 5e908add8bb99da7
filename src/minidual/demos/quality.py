"""Quality measures of a demonstration, and RMS jerk for recordings and benchmarks.

The jerk is resampled and low-passed with zero phase, so that it does not depend on the rate.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from minidual.demos.episode import Episode
from minidual.errors import DataError
from minidual.robot.kinematics import Kinematics, path_length
from minidual.robot.pair import Array

CELL_M = 0.05
"""Cube edge of the workspace count."""
PATH_MIN_M = 0.01
"""Hands that move less have no path efficiency."""
FILTER_ORDER = 4
CUTOFF_HZ = 10.0
INTERNAL_RATE_HZ = 1000.0
TRIM_S = 2.0 / CUTOFF_HZ
"""Time left out at each end, at any cutoff."""
MIN_DURATION_S = 2.5 * TRIM_S

JERK_FILTER = (
    "Butterworth low-pass, order 4, 10 Hz, run forward and backward "
    "(zero phase, -6 dB at 10 Hz) on the measured joints brought to 1 kHz by a quintic spline; "
    "third central difference; 0.2 s left out at each end; "
    "RMS over time of the norm over all joints"
)
"""The filter of `rms_jerk` in words, for verdicts."""


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
    cells = np.floor(hands.reshape(-1, 3) / CELL_M)
    return EpisodeQuality(
        ticks=len(episode),
        duration_s=float(episode.timestamps[-1] - episode.timestamps[0]),
        rms_jerk_rad_s3=rms_jerk(episode.qpos, episode.meta.fps),
        path_length_m=float(path_length(hands).mean()),
        path_efficiency=path_efficiency(hands, episode.action_gripper),
        cells_n=len(np.unique(cells, axis=0)),
    )


def tcp_positions(q: NDArray[np.floating], kinematics: Kinematics) -> Array:
    """Return TCPs (T, 2, 3) [m] for postures (T, n)."""
    return np.array(
        [[pose[:3, 3] for pose in kinematics.tcp_poses(row)] for row in np.asarray(q, dtype=float)],
    )


def path_efficiency(positions: NDArray[np.floating], action_gripper: NDArray[np.floating]) -> float:
    """Return straight over travelled length, 0 to 1, mean of both hands.

    The straight path goes through the places of grip changes. Hands moving under 1 cm are left out;
    1 if both are. `positions` are TCPs (T, 2, 3) [m], `action_gripper` is (T, 2).
    """
    ratios: list[float] = []
    for hand, travelled_m in enumerate(path_length(positions)):
        if travelled_m >= PATH_MIN_M:
            stops = [0, *grip_changes(action_gripper[:, hand]), -1]
            straight_m = path_length(positions[stops, hand])
            ratios.append(straight_m / travelled_m)
    if not ratios:
        return 1.0
    return float(np.mean(ratios))


def grip_changes(command: NDArray[np.floating]) -> list[int]:
    """Return the ticks where a command (T,) crosses mid-range."""
    low = float(np.min(command))
    high = float(np.max(command))
    if high - low < 1e-6:
        return []
    above = command > 0.5 * (low + high)
    crossings = np.flatnonzero(above[1:] != above[:-1]) + 1
    return crossings.tolist()


def rms_jerk(q: NDArray[np.floating], rate_hz: float, cutoff_hz: float = CUTOFF_HZ) -> float:
    """Return sqrt(mean over t of sum over joints of (d3q/dt3)^2), rad/s^3, of q (T, n) [rad].

    DataError below four times the cutoff, under 0.5 s, or if not finite.
    """
    from scipy.signal import butter, sosfiltfilt  # slow import, not needed for JERK_FILTER

    q = np.asarray(q, dtype=np.float64)
    _check_jerk_input(q, rate_hz, cutoff_hz)
    factor = max(1, int(np.ceil(INTERNAL_RATE_HZ / rate_hz - 1e-9)))
    rate = rate_hz * factor
    q = _upsampled(q, factor)
    sections = butter(FILTER_ORDER, cutoff_hz, fs=rate, output="sos")
    padding = min(len(q) - 1, int(TRIM_S * rate))
    # Subtracting the start avoids rounding error in the third difference.
    smooth = sosfiltfilt(sections, q - q[0], axis=0, padlen=padding)
    # Central third difference: (q[+2] - 2 q[+1] + 2 q[-1] - q[-2]) / (2 dt^3).
    third = (smooth[4:] - 2.0 * smooth[3:-1] + 2.0 * smooth[1:-3] - smooth[:-4]) * (0.5 * rate**3)
    trim = round(TRIM_S * rate) - 2
    inner = third[trim:-trim]
    return float(np.sqrt(np.mean(np.sum(inner**2, axis=1))))


def _check_jerk_input(q: Array, rate_hz: float, cutoff_hz: float) -> None:
    if q.ndim != 2 or q.shape[1] == 0:
        raise DataError(f"jerk needs joint positions of shape (T, joints), got {q.shape}")
    rate_min_hz = 4.0 * cutoff_hz
    if not (np.isfinite(rate_hz) and rate_hz >= rate_min_hz):
        raise DataError(
            f"jerk with a {cutoff_hz:g} Hz cutoff needs at least {rate_min_hz:g} Hz, "
            f"got {rate_hz:g} Hz",
        )
    duration_s = (len(q) - 1) / rate_hz
    if duration_s < MIN_DURATION_S - 1e-9:
        raise DataError(
            f"jerk needs at least {MIN_DURATION_S:.2f} s of motion, "
            f"got {len(q)} samples at {rate_hz:g} Hz",
        )
    if not np.all(np.isfinite(q)):
        raise DataError("jerk needs finite joint positions; the motion holds NaN or infinity")


def _upsampled(q: Array, factor: int) -> Array:
    """Return q (T, n) at `factor` times its rate, by a quintic spline."""
    from scipy.interpolate import make_interp_spline  # slow import

    if factor == 1:
        return q
    ticks = np.arange(len(q), dtype=np.float64)
    spline = make_interp_spline(ticks, q, k=5, axis=0)
    return spline(np.arange((len(q) - 1) * factor + 1) / factor)
