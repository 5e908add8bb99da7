"""Metrics of trials, and their summary. Missing values are NaN, and words in CSV and JSON."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from minidual.demos.quality import CUTOFF_HZ
from minidual.errors import NothingEvaluatedError, UsageError
from minidual.robot.kinematics import path_length
from minidual.tasks.judge import Failure, Outcome
from minidual.trials.measures import MEASURES, TrialLog, jerk
from minidual.trials.statistics import bootstrap_median_interval, wilson_interval

NOT_MEASURED = "not measured"

Cell = float | int | str | bool


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
        found = {**self.measured, **self.wall}
        return {name: found.get(name, math.nan) for name in MEASURES}

    @property
    def text(self) -> str:
        """The outcome as one line."""
        if self.success:
            return "success"
        stop = f" (stopped itself: {self.aborted})" if self.aborted else ""
        return f"not '{self.failure}' at {self.failed_at_s:.2f} s: {self.reason}{stop}"

    def to_row(self) -> dict[str, Cell]:
        """Return the trial for CSV or JSON."""
        words = {"failed_at_s": "did not fail", "duration_s": "did not succeed"}
        hidden = ("saturated_max_s", "measured", "wall")
        told = {
            name: value for name, value in vars(self).items() if name not in hidden
        } | self.measures
        row = {name: _said(value, words.get(name, NOT_MEASURED)) for name, value in told.items()}
        return {**row, "disturbed": "no push or move" if self.disturbed is None else self.disturbed}


_OF_SOME_TASKS = ("internal_", "pinch_")
# Prefixes of indicators over successful trials; the others are over all.
_OVER_SUCCESSES = ("duration_", "path_", *_OF_SOME_TASKS)


@dataclass(frozen=True)
class MethodSummary:
    """Trials of one method under one condition.

    Attributes:
        numbers: Indicators by name; *_low and *_high bound 95 % intervals (success rate: Wilson; others: bootstrap of
            the median). Durations, path lengths and forces are over successes, the others over all trials.
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
        missing = NOT_MEASURED if self.successes_n else "no successful trial"
        numbers = {
            name: _said(value, missing if name.startswith(_OVER_SUCCESSES) else NOT_MEASURED)
            for name, value in self.numbers.items()
        }
        labels = {
            name: getattr(self, name) for name in ("method", "condition", "trials_n", "successes_n")
        }
        failures = "; ".join(f"{name} {count}" for name, count in self.failures.items()) or "none"
        measures = {name: _said(value, NOT_MEASURED) for name, value in self.measures.items()}
        return {**labels, **numbers, **measures, "failures": failures, "stopped_n": self.stopped_n}

    def record(self) -> dict[str, Any]:
        """Return the summary for a verdict; NaN becomes "nan"."""
        numbers = {name: _said(value, "nan") for name, value in self.numbers.items()}
        counts = {
            "trials": self.trials_n,
            "successes_n": self.successes_n,
            "stopped_n": self.stopped_n,
        }
        measures = {name: _said(value, "nan") for name, value in self.measures.items()}
        return {**counts, **numbers, "failures": dict(self.failures), "measures": measures}

    def not_finite(self) -> list[str]:
        """Return the names of numbers that its trials should have given."""
        due = [
            n
            for n in self.numbers
            if not n.startswith(_OF_SOME_TASKS if self.successes_n else _OVER_SUCCESSES)
        ]
        return [n for n in due if not math.isfinite(self.numbers[n])]

    @property
    def interval(self) -> str:
        """The success rate's interval in words."""
        within = f"{self['success_low']:.3f} to {self['success_high']:.3f}"
        return f"{self.successes_n} of {self.trials_n} trials, 95 % Wilson interval {within}"


def trial_metrics(
    method: str,
    index: int,
    outcome: Outcome,
    log: TrialLog,
    **known: Any,
) -> TrialMetrics:
    """Return the metrics of one undisturbed trial; `known` are further fields.

    Raises:
        DataError: Its joints are not finite.
    """
    unfinished = Failure("unfinished", outcome.duration_s, "the object was never released at rest")
    first = min(outcome.failures, key=lambda failure: failure.at_s, default=unfinished)
    cause = Failure("", math.nan, "") if outcome.success else first
    return TrialMetrics(
        *(method, index, "clean", outcome.success, cause.name, cause.detail, cause.at_s),
        duration_s=outcome.duration_s if outcome.success else math.nan,
        jerk_rms=jerk(log.q, CUTOFF_HZ),
        path_length_m=float(path_length(log.tcp).mean()),
        pinch_force_min_n=outcome.number("pinch_min_n"),
        measured=outcome.measured,
        **{
            name: outcome.number(name)
            for name in ("tilt_max_rad", "internal_force_min_n", "goal_error_m")
        },
        **known,
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
        raise UsageError(
            f"trials of {len(labels)} methods or conditions in one summary: {sorted(labels)}",
        )
    if len({trial.index for trial in trials}) != len(trials):
        raise UsageError(
            f"method {trials[0].method} ran the same trial twice; a trial would count double",
        )
    won = [trial for trial in trials if trial.success]
    low, high = wilson_interval(len(won), len(trials))

    def spread(values: Sequence[float], *names: str) -> dict[str, float]:
        """Return median and interval under these names."""
        return dict(
            zip(names, (_median(values), *bootstrap_median_interval(values, rng)), strict=True),
        )

    torques = [t.torque_ratio_max for t in trials]
    tilts = [t.tilt_max_rad for t in trials]
    jerks = [t.jerk_rms for t in trials if math.isfinite(t.jerk_rms)]
    numbers = {  # np.max and np.min propagate NaN, the built-ins may not
        "success_rate": len(won) / len(trials),
        "success_low": low,
        "success_high": high,
        **spread(
            [t.duration_s for t in won],
            "duration_median_s",
            "duration_low_s",
            "duration_high_s",
        ),
        "torque_ratio_max": float(np.max(torques)),
        **spread(torques, "torque_ratio_median", "torque_ratio_low", "torque_ratio_high"),
        **spread(jerks, "jerk_rms_median", "jerk_rms_low", "jerk_rms_high"),
        "tilt_max_rad": float(np.max(tilts)),
        **spread(tilts, "tilt_median_rad", "tilt_low_rad", "tilt_high_rad"),
        **spread(
            [t.path_length_m for t in won],
            "path_length_m",
            "path_length_low_m",
            "path_length_high_m",
        ),
        "internal_force_min_n": float(np.min([t.internal_force_min_n for t in won]))
        if won
        else math.nan,
        "pinch_force_min_n": float(np.min([t.pinch_force_min_n for t in won])) if won else math.nan,
        "goal_error_median_m": _median([t.goal_error_m for t in trials]),
    }
    counts = Counter(
        f"{t.failure} ({t.failed_in})" if t.failed_in else t.failure
        for t in trials
        if not t.success
    )
    failures = dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))
    stopped_n = sum(bool(t.aborted) and not t.success for t in trials)
    measures = {
        name: _median([x for t in trials if math.isfinite(x := t.measures[name])])
        for name in MEASURES
    }
    measures["progress"] = float(np.mean([t.measures["progress"] for t in trials]))
    return MethodSummary(
        *labels.pop(),
        len(trials),
        len(won),
        numbers,
        failures,
        stopped_n,
        measures,
    )


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if len(values) else math.nan


def _said(value: Cell, words: str) -> Cell:
    return words if isinstance(value, float) and not math.isfinite(value) else value
