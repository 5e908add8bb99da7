"""Metrics of trials, and their summary. Missing values are NaN, and words in CSV and JSON."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from minidual.demos.quality import CUTOFF_HZ
from minidual.errors import NothingEvaluatedError, UsageError
from minidual.robot.kinematics import path_length
from minidual.tasks.failures import FAILURES, failure_words
from minidual.tasks.judge import Failure, Outcome
from minidual.trials.measures import MEASURES, TrialLog, jerk
from minidual.trials.statistics import bootstrap_median_interval, wilson_interval

NOT_MEASURED = "not measured"
_NO_SUCCESS = "no successful trial"

Cell = float | int | str | bool
"""A value of a table."""


@dataclass(frozen=True)
class TrialMetrics:
    """One trial.

    Attributes:
        failure: First violated condition, empty on success.
        failed_at_s: NaN on success.
        failed_in: The method's phase then; the last one before it stopped.
        duration_s: Start to rest; NaN without success.
        torque_ratio_max: Largest |torque| / limit.
        jerk_rms: Low-passed; NaN if too short.
        path_length_m: Mean of both hands.
        internal_force_min_n, pinch_force_min_n: Off the table.
        aborted: Why the method stopped itself.
        disturbed: Whether the push or move took place; None without.
        saturated_max_s: Longest time of one motor at its limit; not in tables.
        measured: Numbers of the conditions and of the motion; tables show the rows of MEASURES.
        wall: Measured times by name, which differ from run to run.
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
    saturated_max_s: float = 0.0
    failed_in: str = ""
    measured: Mapping[str, float] = field(default_factory=dict)
    wall: Mapping[str, float] = field(default_factory=dict, compare=False)

    @property
    def measures(self) -> dict[str, float]:
        """The rows of MEASURES; NaN where one does not apply."""
        numbers = {**self.measured, **self.wall}
        return {name: numbers.get(name, math.nan) for name in MEASURES}

    @property
    def text(self) -> str:
        """The outcome as one line."""
        if self.success:
            return "success"
        stop = f" (stopped itself: {self.aborted})" if self.aborted else ""
        reason = self.reason or failure_words(self.failure)
        return f"{reason}, at {self.failed_at_s:.2f} s{stop}"

    def to_row(self) -> dict[str, Cell]:
        """Return the trial for CSV or JSON."""
        words = {"failed_at_s": "did not fail", "duration_s": "did not succeed"}
        not_shown = ("saturated_max_s", "measured", "wall")
        shown = {name: value for name, value in vars(self).items() if name not in not_shown}
        row: dict[str, Cell] = {}
        for name, value in {**shown, **self.measures}.items():
            row[name] = _or_words(value, words.get(name, NOT_MEASURED))
        row["disturbed"] = "no push or move" if self.disturbed is None else self.disturbed
        return row


_OF_SOME_TASKS = ("internal_", "pinch_")
"""Prefixes of indicators that some tasks lack."""
_OVER_SUCCESSES = ("duration_", "path_", *_OF_SOME_TASKS)
"""Prefixes of indicators over successful trials; the others are over all."""


@dataclass(frozen=True)
class MethodSummary:
    """Trials of one method under one condition.

    Attributes:
        numbers: Indicators by name; *_low and *_high bound 95 % intervals (success rate: Wilson;
            others: bootstrap of the median). Durations, path lengths and forces are over
            successes, the others over all trials.
        failures: By first violated condition and phase, most frequent first.
        stopped_n: Failures of a method that stopped itself.
        measures: Median of each row of MEASURES, of `progress` the mean; NaN where none applies.
    """

    method: str
    condition: str
    trials_n: int
    successes_n: int
    numbers: Mapping[str, float]
    failures: Mapping[str, int]
    stopped_n: int
    measures: Mapping[str, float] = field(default_factory=dict, compare=False)

    def __getitem__(self, name: str) -> float:
        return self.numbers[name]

    def to_row(self) -> dict[str, Cell]:
        """Return the summary for CSV."""
        row: dict[str, Cell] = {
            "method": self.method,
            "condition": self.condition,
            "trials_n": self.trials_n,
            "successes_n": self.successes_n,
        }
        for name, value in self.numbers.items():
            lacks_successes = name.startswith(_OVER_SUCCESSES) and not self.successes_n
            row[name] = _or_words(value, _NO_SUCCESS if lacks_successes else NOT_MEASURED)
        for name, value in self.measures.items():
            row[name] = _or_words(value, NOT_MEASURED)
        failures = [f"{count} x {failure_words(name)}" for name, count in self.failures.items()]
        row["failures"] = "; ".join(failures) if failures else "none"
        row["stopped_n"] = self.stopped_n
        return row

    def record(self) -> dict[str, Any]:
        """Return the summary for a verdict; NaN becomes "nan"."""
        return {
            "trials": self.trials_n,
            "successes_n": self.successes_n,
            "stopped_n": self.stopped_n,
            **{name: _or_words(value, "nan") for name, value in self.numbers.items()},
            "failures": dict(self.failures),
            "measures": {name: _or_words(value, "nan") for name, value in self.measures.items()},
        }

    def not_finite(self) -> list[str]:
        """Return the names of numbers that its trials should have given."""
        may_lack = _OF_SOME_TASKS if self.successes_n else _OVER_SUCCESSES
        return [
            name
            for name, value in self.numbers.items()
            if not name.startswith(may_lack) and not math.isfinite(value)
        ]

    @property
    def interval(self) -> str:
        """The success rate's interval in words."""
        within = f"{self['success_low']:.3f} to {self['success_high']:.3f}"
        return f"{self.successes_n} of {self.trials_n} trials, 95 % Wilson interval {within}"


_NO_WALL: Mapping[str, float] = MappingProxyType({})


def trial_metrics(
    method: str,
    index: int,
    outcome: Outcome,
    log: TrialLog,
    *,
    torque_ratio_max: float,
    saturated_max_s: float = 0.0,
    aborted: str = "",
    wall: Mapping[str, float] = _NO_WALL,
) -> TrialMetrics:
    """Return the metrics of one undisturbed trial.

    Outcome and log are what judge and world say; the keywords are fields of TrialMetrics that
    neither knows.

    Raises:
        DataError: Its joints are not finite.
    """
    cause = _cause(outcome)
    return TrialMetrics(
        method=method,
        index=index,
        condition="clean",
        success=outcome.success,
        failure=cause.name,
        reason=cause.detail,
        failed_at_s=cause.at_s,
        duration_s=outcome.duration_s if outcome.success else math.nan,
        torque_ratio_max=torque_ratio_max,
        jerk_rms=jerk(log, CUTOFF_HZ),
        tilt_max_rad=outcome.number("tilt_max_rad"),
        path_length_m=float(path_length(log.tcp).mean()),
        internal_force_min_n=outcome.number("internal_force_min_n"),
        pinch_force_min_n=outcome.number("pinch_min_n"),
        goal_error_m=outcome.number("goal_error_m"),
        aborted=aborted,
        saturated_max_s=saturated_max_s,
        measured=outcome.measured,
        wall=wall,
    )


def _cause(outcome: Outcome) -> Failure:
    """Return the first failure; an empty one on success."""
    if outcome.success:
        return Failure("", math.nan, "")
    unfinished = Failure("unfinished", outcome.duration_s, FAILURES["unfinished"])
    return min(outcome.failures, key=lambda failure: failure.at_s, default=unfinished)


def summarise(trials: Sequence[TrialMetrics], rng: np.random.Generator) -> MethodSummary:
    """Summarise trials of one method and condition.

    Raises:
        NothingEvaluatedError: No trials.
        UsageError: Several methods or conditions, or a repeated trial.
    """
    _check_one_series(trials)
    successes = [trial for trial in trials if trial.success]
    return MethodSummary(
        method=trials[0].method,
        condition=trials[0].condition,
        trials_n=len(trials),
        successes_n=len(successes),
        numbers=_indicators(trials, successes, rng),
        failures=_failures(trials),
        stopped_n=sum(bool(trial.aborted) and not trial.success for trial in trials),
        measures=_measures(trials),
    )


def _check_one_series(trials: Sequence[TrialMetrics]) -> None:
    if not trials:
        raise NothingEvaluatedError("no trials to summarise")
    labels = {(trial.method, trial.condition) for trial in trials}
    if len(labels) > 1:
        raise UsageError(
            f"trials of {len(labels)} methods or conditions in one summary: {sorted(labels)}",
        )
    if len({trial.index for trial in trials}) != len(trials):
        raise UsageError(
            f"method {trials[0].method} ran the same trial twice; a trial would count double",
        )


class _Spread(NamedTuple):
    """Median of a sample, and its 95 % interval."""

    median: float
    low: float
    high: float


def _spread(values: Sequence[float], rng: np.random.Generator) -> _Spread:
    low, high = bootstrap_median_interval(values, rng)
    return _Spread(_median(values), low, high)


def _indicators(
    trials: Sequence[TrialMetrics],
    successes: Sequence[TrialMetrics],
    rng: np.random.Generator,
) -> dict[str, float]:
    """Return `MethodSummary.numbers`. np.max and np.min propagate NaN, the built-ins may not."""
    success_low, success_high = wilson_interval(len(successes), len(trials))
    torques = [t.torque_ratio_max for t in trials]
    tilts = [t.tilt_max_rad for t in trials]
    jerks = [t.jerk_rms for t in trials if math.isfinite(t.jerk_rms)]
    # All intervals draw from one generator: their order is part of the result.
    duration = _spread([t.duration_s for t in successes], rng)
    torque = _spread(torques, rng)
    jerk_rms = _spread(jerks, rng)
    tilt = _spread(tilts, rng)
    path = _spread([t.path_length_m for t in successes], rng)
    return {
        "success_rate": len(successes) / len(trials),
        "success_low": success_low,
        "success_high": success_high,
        "duration_median_s": duration.median,
        "duration_low_s": duration.low,
        "duration_high_s": duration.high,
        "torque_ratio_max": float(np.max(torques)),
        "torque_ratio_median": torque.median,
        "torque_ratio_low": torque.low,
        "torque_ratio_high": torque.high,
        "jerk_rms_median": jerk_rms.median,
        "jerk_rms_low": jerk_rms.low,
        "jerk_rms_high": jerk_rms.high,
        "tilt_max_rad": float(np.max(tilts)),
        "tilt_median_rad": tilt.median,
        "tilt_low_rad": tilt.low,
        "tilt_high_rad": tilt.high,
        "path_length_m": path.median,
        "path_length_low_m": path.low,
        "path_length_high_m": path.high,
        "internal_force_min_n": _least([t.internal_force_min_n for t in successes]),
        "pinch_force_min_n": _least([t.pinch_force_min_n for t in successes]),
        "goal_error_median_m": _median([t.goal_error_m for t in trials]),
    }


def _failures(trials: Sequence[TrialMetrics]) -> dict[str, int]:
    """Count the failed trials by first violated condition and phase, most frequent first."""
    counts: Counter[str] = Counter()
    for trial in trials:
        if not trial.success:
            where = f" ({trial.failed_in})" if trial.failed_in else ""
            counts[f"{trial.failure}{where}"] += 1
    return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))


def _measures(trials: Sequence[TrialMetrics]) -> dict[str, float]:
    rows = [trial.measures for trial in trials]
    measures: dict[str, float] = {}
    for name in MEASURES:
        measures[name] = _median([row[name] for row in rows if math.isfinite(row[name])])
    measures["progress"] = float(np.mean([row["progress"] for row in rows]))
    return measures


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if len(values) else math.nan


def _least(values: Sequence[float]) -> float:
    return float(np.min(values)) if len(values) else math.nan


def _or_words(value: Cell, words: str) -> Cell:
    """Return a value, or the words that stand for one that is not finite."""
    if isinstance(value, float) and not math.isfinite(value):
        return words
    return value
