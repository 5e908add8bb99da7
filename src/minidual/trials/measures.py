"""Time series of a trial, and what is measured on them beside the indicators of success."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from minidual.demos.quality import MIN_DURATION_S, rms_jerk
from minidual.registry import rows_beside
from minidual.robot.pair import Array

LOG_RATE_HZ = 250
_IMPULSE_ROWS = 5
_PUT_M_PER_S = 4.0  # no hand and no fall is that fast
_HELD_N = 1.0
"""Pinch of a hand that holds."""


@dataclass(frozen=True)
class Measure:
    """One row of measures.yaml; `scale`: displayed value / SI value."""

    title: str
    unit: str
    meaning: str
    scale: float = 1.0


MEASURES = {name: Measure(**row) for name, row in rows_beside(__file__).items()}


@dataclass
class TrialLog:
    """Time series at 250 Hz.

    Attributes:
        t: (T,) [s].
        q: (T, n) measured [rad].
        tau: (T, n) motor torques [Nm].
        tcp: (T, 2, 3) tool centres [m].
        position: (T, 3) of the object [m].
        tilt: (T,) [rad].
        pinch: (T, 2) [N].
        internal_force: (T,) [N].
        airborne: (T,) whether the object is off the table.
    """

    t: Array
    q: Array
    tau: Array
    tcp: Array
    position: Array
    tilt: Array
    pinch: Array
    internal_force: Array
    airborne: npt.NDArray[np.bool_]


def jerk(q: Array, cutoff_hz: float) -> float:
    """Return `rms_jerk` of a log's joints (T, n), or NaN if it is too short."""
    return (
        math.nan
        if (len(q) - 1) / LOG_RATE_HZ < MIN_DURATION_S
        else rms_jerk(q, LOG_RATE_HZ, cutoff_hz)
    )


def measure(log: TrialLog, mass_kg: float, wanted_n: float) -> dict[str, float]:
    """Return the measures of the motion (measures.yaml); NaN for what did not happen.

    mass_kg: of the object. wanted_n: internal force that the method controls, or NaN.
    """
    held = log.airborne & (log.pinch.min(axis=1) > _HELD_N)
    span = np.linalg.norm(log.tcp[held, 0] - log.tcp[held, 1], axis=1)
    missed = log.internal_force[held] - wanted_n
    velocity = np.diff(log.position, axis=0) * LOG_RATE_HZ
    velocity[np.linalg.norm(velocity, axis=1) > _PUT_M_PER_S] = (
        math.nan
    )  # somebody put it there: no contact
    change = np.linalg.norm(velocity[_IMPULSE_ROWS:] - velocity[:-_IMPULSE_ROWS], axis=1)
    return {
        "sync_error_m": float(np.abs(span - span[0]).max()) if len(span) else math.nan,
        "internal_force_error_n": float(np.sqrt(np.mean(missed**2))) if len(missed) else math.nan,
        "impulse_max_ns": mass_kg * float(np.nanmax(change)) if len(change) else math.nan,
        "energy_j": float(np.abs(log.tau[1:] * np.diff(log.q, axis=0)).sum()),
        "jerk_50_hz_rms": jerk(log.q, 50.0),
    }
