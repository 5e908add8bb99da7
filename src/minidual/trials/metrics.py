"""Metrics of trials, and their summary. Missing values are NaN, in CSV and JSON words."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from minidual.demos.quality import path_length_m
from minidual.demos.smoothness import min_duration_s, rms_jerk
from minidual.errors import DataError, NothingEvaluatedError, UsageError
from minidual.tasks.judge import Outcome
from minidual.trials.statistics import bootstrap_median_interval, wilson_interval

#: Words for missing values in tables.
NO_SUCCESS = "no successful trial"
NOT_MEASURED = "not measured"
NO_EVENT = "no push or move"

Cell = float | int | str | bool


@dataclass(frozen=True)
class TrialMetrics:
    """One trial.

    Attributes:
        failure: First violated condition, empty on success.
        reason: The violation with numbers.
        failed_at_s: NaN on success.
        duration_s: Start to released and at rest; NaN without success.
        torque_ratio_max: Largest |torque| / limit over joints and time.
        jerk_rms: Low-passed; NaN if too short.
        path_length_m: Mean of both hands.
        internal_force_min_n, pinch_force_min_n: Minimum off the table.
        goal_error_m: At the end.
        aborted: Why the method stopped itself.
        disturbed: Whether the push or move took place; None if the condition has none.
    """

    method: str
    index: int
    condition: str
    success: bool
    failure: str
    reason: str
    failed_at_s: float
    duration_s: float
    torque_ratio_max: float
    jerk_rms: float
    tilt_max_rad: float
    path_length_m: float
    internal_force_min_n: float
    pinch_force_min_n: float
    goal_error_m: float
    aborted: str = ""
    disturbed: bool | None = None

    @property
    def text(self) -> str:
        """The outcome as one line."""
        if self.success:
            return "success"
        stop = f" (stopped itself: {self.aborted})" if self.aborted else ""
        return f"{self.failure} at {self.failed_at_s:.2f} s: {self.reason}{stop}"

    def to_row(self) -> dict[str, Cell]:
        """Return the trial for CSV or JSON."""
        words = {"failed_at_s": "did not fail", "duration_s": "did not succeed"}
        row = {f.name: _said(getattr(self, f.name), words.get(f.name, NOT_MEASURED)) for f in fields(self)}
        return {**row, "disturbed": NO_EVENT if self.disturbed is None else self.disturbed}


_OVER_ALL = ("torque_", "jerk_", "tilt_", "goal_")
"""Prefixes of indicators that include failed trials."""


@dataclass(frozen=True)
class MethodSummary:
    """Trials of one method under one condition; *_low and *_high bound 95 % intervals.

    Attributes:
        success_low, success_high: Wilson interval; the others are bootstrap intervals of medians.
        duration_median_s, path_length_m: Medians over successes; NaN without any.
        torque_ratio_max, tilt_max_rad: Largest over all trials.
        torque_ratio_median, tilt_median_rad: Over all trials, of the largest in each.
        jerk_rms_median: Over all trials long enough, rad/s^3.
        internal_force_min_n, pinch_force_min_n: Minimum over successes.
        failures: Trials by first violated condition.
        stopped_n: Failures in which the method stopped itself.
    """

    method: str
    condition: str
    trials_n: int
    successes_n: int
    success_rate: float
    success_low: float
    success_high: float
    duration_median_s: float
    duration_low_s: float
    duration_high_s: float
    torque_ratio_max: float
    torque_ratio_median: float
    torque_ratio_low: float
    torque_ratio_high: float
    jerk_rms_median: float
    jerk_rms_low: float
    jerk_rms_high: float
    tilt_max_rad: float
    tilt_median_rad: float
    tilt_low_rad: float
    tilt_high_rad: float
    path_length_m: float
    path_length_low_m: float
    path_length_high_m: float
    internal_force_min_n: float
    pinch_force_min_n: float
    goal_error_median_m: float
    failures: tuple[tuple[str, int], ...]
    stopped_n: int

    def to_row(self) -> dict[str, Cell]:
        """Return the summary for CSV or JSON."""
        missing = NO_SUCCESS if self.successes_n == 0 else NOT_MEASURED
        row: dict[str, Cell] = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if f.name == "failures":
                row["failures"] = "; ".join(f"{name} {count}" for name, count in value) or "none"
            else:
                row[f.name] = _said(value, NOT_MEASURED if f.name.startswith(_OVER_ALL) else missing)
        return row


def jerk_or_nan(q: NDArray[np.floating], rate_hz: float) -> float:
    """Return `rms_jerk`; NaN below half a second."""
    return math.nan if (len(q) - 1) / rate_hz < min_duration_s() else rms_jerk(q, rate_hz)


def trial_metrics(
    method: str,
    index: int,
    outcome: Outcome,
    *,
    q: NDArray[np.floating],
    tcp_positions: NDArray[np.floating],
    rate_hz: float,
    torque_ratio_max: float,
    condition: str = "clean",
    aborted: str = "",
) -> TrialMetrics:
    """Return the metrics of one trial.

    `q` is (T, n) [rad], `tcp_positions` (T, 2, 3) [m], both measured.

    Raises:
        DataError: Wrong shape or not finite.
    """
    positions = np.asarray(tcp_positions, dtype=float)
    for name, log, shape in (("q", q, (len(q), *q.shape[1:2])), ("tcp_positions", positions, (len(q), 2, 3))):
        if log.shape != shape or log.ndim < 2:
            raise DataError(f"the log of {name} of {method}, trial {index}, has shape {log.shape}; it must be {shape}")
        if not np.all(np.isfinite(log)):
            raise DataError(f"the log of {name} of {method}, trial {index}, holds NaN or infinity")
    if not math.isfinite(torque_ratio_max):
        raise DataError(f"the torques of {method}, trial {index}, hold NaN or infinity")
    first = min(outcome.faults, key=lambda fault: fault.at_s, default=None)
    if outcome.success:
        failure, detail, failed_at = "", "", math.nan
    elif first is None:
        failure, detail, failed_at = "unfinished", "the object was never released at rest", outcome.duration_s
    else:
        failure, detail, failed_at = first.name, first.detail, first.at_s
    return TrialMetrics(
        method=method,
        index=index,
        condition=condition,
        success=outcome.success,
        failure=failure,
        reason=detail,
        failed_at_s=failed_at,
        duration_s=outcome.duration_s if outcome.success else math.nan,
        torque_ratio_max=torque_ratio_max,
        jerk_rms=jerk_or_nan(q, rate_hz),
        tilt_max_rad=outcome.tilt_max_rad,
        path_length_m=float(path_length_m(positions).mean()),
        internal_force_min_n=outcome.internal_force_min_n,
        pinch_force_min_n=outcome.pinch_min_n,
        goal_error_m=outcome.goal_error_m,
        aborted=aborted,
    )


def summarise(trials: Sequence[TrialMetrics], rng: np.random.Generator) -> MethodSummary:
    """Summarise trials of one method and condition.

    Raises:
        NothingEvaluatedError: No trials.
        UsageError: Several methods or conditions, or a repeated trial.
    """
    if not trials:
        raise NothingEvaluatedError("no trials to summarise")
    labels = {(trial.method, trial.condition) for trial in trials}
    if len(labels) > 1:
        raise UsageError(f"trials of {len(labels)} methods or conditions in one summary: {sorted(labels)}")
    if len({trial.index for trial in trials}) != len(trials):
        raise UsageError(f"method {trials[0].method} ran the same trial twice; a trial would count double")
    won = [trial for trial in trials if trial.success]
    low, high = wilson_interval(len(won), len(trials))
    counts = Counter(trial.failure for trial in trials if not trial.success)

    def spread(values: Sequence[float], *names: str) -> dict[str, float]:
        """Return median and interval, or NaN."""
        middle = float(np.median(values)) if len(values) else math.nan
        known = len(values) > 0 and bool(np.all(np.isfinite(values)))
        ends = bootstrap_median_interval(values, rng) if known else (math.nan, math.nan)
        return dict(zip(names, (middle, *ends), strict=True))

    torques, tilts = [t.torque_ratio_max for t in trials], [t.tilt_max_rad for t in trials]
    jerks = [t.jerk_rms for t in trials if math.isfinite(t.jerk_rms)]
    return MethodSummary(  # np.max and np.min propagate NaN, the built-ins may not
        method=trials[0].method,
        condition=trials[0].condition,
        trials_n=len(trials),
        successes_n=len(won),
        success_rate=len(won) / len(trials),
        success_low=low,
        success_high=high,
        **spread([t.duration_s for t in won], "duration_median_s", "duration_low_s", "duration_high_s"),
        torque_ratio_max=float(np.max(torques)),
        **spread(torques, "torque_ratio_median", "torque_ratio_low", "torque_ratio_high"),
        **spread(jerks, "jerk_rms_median", "jerk_rms_low", "jerk_rms_high"),
        tilt_max_rad=float(np.max(tilts)),
        **spread(tilts, "tilt_median_rad", "tilt_low_rad", "tilt_high_rad"),
        **spread([t.path_length_m for t in won], "path_length_m", "path_length_low_m", "path_length_high_m"),
        internal_force_min_n=float(np.min([t.internal_force_min_n for t in won])) if won else math.nan,
        pinch_force_min_n=float(np.min([t.pinch_force_min_n for t in won])) if won else math.nan,
        goal_error_median_m=float(np.median([t.goal_error_m for t in trials])),
        failures=tuple(sorted(counts.items(), key=lambda item: (-item[1], item[0]))),
        stopped_n=sum(bool(t.aborted) and not t.success for t in trials),
    )


def _said(value: Cell, words: str) -> Cell:
    """Return words for NaN."""
    return words if isinstance(value, float) and not math.isfinite(value) else value
