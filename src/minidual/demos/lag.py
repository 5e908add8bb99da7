"""How far behind the leader the arms are."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from minidual.robot.pair import Array

LAG_MAX_S = 0.3
"""Longest lag that is looked for."""
MOVING_RAD_S = 0.1
"""Samples with a slower motion of the joints, together, show no lag."""
_STEP_S = 0.001


class Lag(NamedTuple):
    """Lag of a motion behind its commands.

    Attributes:
        aligned_s: At which motion and commands agree best over the whole episode; NaN at rest.
        samples_s: At which each moving sample agrees best with the commands before it (m,).
    """

    aligned_s: float
    samples_s: Array


def leader_lag(action: NDArray[np.floating], q: NDArray[np.floating], rate_hz: float) -> Lag:
    """Return by how much joints (T, n) [rad] lag behind the commands (T, n) of the same ticks."""
    action = np.asarray(action, dtype=float)
    q = np.asarray(q, dtype=float)
    history = round(LAG_MAX_S * rate_hz)
    times_s = np.arange(len(q)) / rate_hz
    speed = np.linalg.norm(np.gradient(q, axis=0), axis=1) * rate_hz if len(q) > 1 else np.zeros(0)
    moving = np.flatnonzero(speed > MOVING_RAD_S)
    moving = moving[moving >= history]
    if not len(moving):
        return Lag(float("nan"), np.empty(0))
    lags_s: Array = np.arange(0.0, LAG_MAX_S, _STEP_S, dtype=np.float64)
    squares = np.zeros((len(lags_s), len(moving)))
    for k, lag_s in enumerate(lags_s):
        asked_s = times_s[moving] - lag_s
        for joint in range(q.shape[1]):
            command = np.interp(asked_s, times_s, action[:, joint])
            squares[k] += (q[moving, joint] - command) ** 2
    aligned_s = float(lags_s[np.argmin(squares.sum(axis=1))])
    return Lag(aligned_s, lags_s[np.argmin(squares, axis=0)])
