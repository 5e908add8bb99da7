"""Time series of a trial, and their measures beside the indicators of success."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from minidual.demos.quality import MIN_DURATION_S, rms_jerk
from minidual.robot.pair import Array

LOG_RATE_HZ = 250
_IMPULSE_S = 0.02
_JERK_RATE = 4.0
"""Least rate of samples over the cutoff of a jerk."""
_PUT_M_PER_S = 4.0  # no hand and no fall is that fast
_HELD_N = 1.0
"""Pinch of a hand that holds."""


@dataclass(frozen=True)
class Measure:
    """A further measure of a trial.

    Attributes:
        scale: Displayed value / SI value.
    """

    title: str
    unit: str
    meaning: str
    scale: float = 1.0


MEASURES: dict[str, Measure] = {
    "progress": Measure(
        "Stages reached",
        "%",
        "stages of the task that were reached, of all, also after the first violation;"
        " mean over trials",
        scale=100.0,
    ),
    "sync_error_m": Measure(
        "Arm synchronisation error",
        "mm",
        "largest change of the distance between the hands while both hold the object in the air;"
        " 5 mm is called good",
        scale=1000.0,
    ),
    "internal_force_error_n": Measure(
        "Internal-force error",
        "N",
        "RMS of felt minus wanted internal force in the air, where a method controls it",
    ),
    "impulse_max_ns": Measure(
        "Contact impulse",
        "N s",
        "largest change of the momentum of the task's first object (peg, first red cube)"
        " within 20 ms; presses without motion have none",
    ),
    "energy_j": Measure(
        "Motor work",
        "J",
        "integral of |torque x speed| over all joints, without the heat of holding still",
    ),
    "jerk_50_hz_rms": Measure(
        "RMS jerk at 50 Hz",
        "rad/s³",
        "as RMS jerk, whose low-pass lets 10 Hz through",
    ),
    "planning_s": Measure(
        "Planning time",
        "s",
        "processor time before the first motion, from the sensed poses on",
    ),
    "inference_s": Measure(
        "Inference time",
        "ms",
        "wall time of one inference of a policy, mean of the trial",
        scale=1000.0,
    ),
}


class Sample(NamedTuple):
    """One instant of a trial; the fields are those of TrialLog."""

    t: float
    q: Array
    tau: Array
    tcp: Sequence[Array]
    position: tuple[float, float, float]
    tilt: float
    pinch: tuple[float, float]
    internal_force: float
    airborne: bool


@dataclass
class TrialLog:
    """Time series, at 250 Hz where the control runs that fast.

    Attributes:
        rate_hz: Of the samples.
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
    rate_hz: float = LOG_RATE_HZ

    @classmethod
    def of(cls, samples: Sequence[Sample], rate_hz: float = LOG_RATE_HZ) -> TrialLog:
        """Return the log of one or more samples."""
        columns = zip(*samples, strict=True)
        return cls(*map(np.array, columns), rate_hz=rate_hz)


def jerk(log: TrialLog, cutoff_hz: float) -> float:
    """Return `rms_jerk` of a log's joints, or NaN if it is too short or too slow for the cutoff."""
    duration_s = (len(log.q) - 1) / log.rate_hz
    if duration_s < MIN_DURATION_S or log.rate_hz < _JERK_RATE * cutoff_hz:
        return math.nan
    return rms_jerk(log.q, log.rate_hz, cutoff_hz)


def measure(log: TrialLog, mass_kg: float, wanted_n: float) -> dict[str, float]:
    """Return the measures of the motion (MEASURES); NaN for events that did not happen.

    mass_kg is that of the object, wanted_n the internal force that the method controls, or NaN.
    """
    held = log.airborne & (log.pinch.min(axis=1) > _HELD_N)
    return {
        "sync_error_m": _sync_error_m(log.tcp[held]),
        "internal_force_error_n": _rms(log.internal_force[held] - wanted_n),
        "impulse_max_ns": mass_kg * _velocity_change_max(log.position, log.rate_hz),
        "energy_j": float(np.abs(log.tau[1:] * np.diff(log.q, axis=0)).sum()),
        "jerk_50_hz_rms": jerk(log, 50.0),
    }


def _sync_error_m(tcp: Array) -> float:
    """Return the largest change of the distance between two points (T, 2, 3); NaN if empty."""
    span_m = np.linalg.norm(tcp[:, 0] - tcp[:, 1], axis=1)
    if len(span_m) == 0:
        return math.nan
    return float(np.abs(span_m - span_m[0]).max())


def _rms(values: Array) -> float:
    if len(values) == 0:
        return math.nan
    return float(np.sqrt(np.mean(values**2)))


def _velocity_change_max(position: Array, rate_hz: float) -> float:
    """Return the largest change of velocity [m/s] within 20 ms; NaN if the log is too short."""
    velocity = np.diff(position, axis=0) * rate_hz
    rows = round(_IMPULSE_S * rate_hz)
    # Faster than any contact: somebody put the object there.
    velocity[np.linalg.norm(velocity, axis=1) > _PUT_M_PER_S] = math.nan
    change = np.linalg.norm(velocity[rows:] - velocity[:-rows], axis=1)
    if len(change) == 0:
        return math.nan
    return float(np.nanmax(change))
