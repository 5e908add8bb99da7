"""RMS jerk for recordings and benchmarks.

Resampling and a zero-phase low-pass make it independent of the rate.
"""

import numpy as np
from numpy.typing import NDArray

from minidual.errors import DataError

FILTER_ORDER = 4
CUTOFF_HZ = 10.0
INTERNAL_RATE_HZ = 1000.0
TRIM_S = 2.0 / CUTOFF_HZ
"""Time left out at each end."""
MIN_DURATION_S = 2.5 * TRIM_S

JERK_FILTER = (
    "Butterworth low-pass, order 4, 10 Hz, run forward and backward (zero phase, -6 dB at 10 Hz) on the measured "
    "joints brought to 1 kHz by a quintic spline; third central difference; 0.2 s left out at each end; RMS over "
    "time of the norm over all joints"
)
"""The filter in words."""


def rms_jerk(q: NDArray[np.floating], rate_hz: float) -> float:
    """Return sqrt(mean over t of sum over joints of (d3q/dt3)^2), rad/s^3, of q (T, n) [rad].

    DataError below 40 Hz, under 0.5 s, or if not finite.
    """
    from scipy.interpolate import make_interp_spline  # slow import, not needed for JERK_FILTER
    from scipy.signal import butter, sosfiltfilt

    q = np.asarray(q, dtype=np.float64)
    if q.ndim != 2 or q.shape[1] == 0:
        raise DataError(f"jerk needs joint positions of shape (T, joints), got {q.shape}")
    if not (np.isfinite(rate_hz) and rate_hz >= 4.0 * CUTOFF_HZ):
        raise DataError(f"jerk with a {CUTOFF_HZ:g} Hz cutoff needs at least {4 * CUTOFF_HZ:g} Hz, got {rate_hz:g} Hz")
    if (len(q) - 1) / rate_hz < MIN_DURATION_S - 1e-9:
        raise DataError(f"jerk needs at least {MIN_DURATION_S:.2f} s of motion, got {len(q)} samples at {rate_hz:g} Hz")
    if not np.all(np.isfinite(q)):
        raise DataError("jerk needs finite joint positions; the motion holds NaN or infinity")

    factor = max(1, int(np.ceil(INTERNAL_RATE_HZ / rate_hz - 1e-9)))
    rate = rate_hz * factor
    if factor > 1:
        ticks = np.arange(len(q), dtype=np.float64)
        fine = np.arange((len(q) - 1) * factor + 1) / factor
        q = make_interp_spline(ticks, q, k=5, axis=0)(fine)
    sos = butter(FILTER_ORDER, CUTOFF_HZ, fs=rate, output="sos")
    # Subtracting the start avoids rounding error in the third difference.
    smooth = sosfiltfilt(sos, q - q[0], axis=0, padlen=min(len(q) - 1, int(TRIM_S * rate)))
    # Central third difference: (q[+2] - 2 q[+1] + 2 q[-1] - q[-2]) / (2 dt^3).
    third = (smooth[4:] - 2.0 * smooth[3:-1] + 2.0 * smooth[1:-3] - smooth[:-4]) * (0.5 * rate**3)
    trim = round(TRIM_S * rate) - 2
    jerk = third[trim:-trim]
    return float(np.sqrt(np.mean(np.sum(jerk**2, axis=1))))
