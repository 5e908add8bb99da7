"""Analysis: paired comparisons, failures, held-out starts, thinnest margins."""

from __future__ import annotations

import csv
import math
import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from minidual.errors import DataError
from minidual.gate.check import Check
from minidual.gate.verdict import Verdict
from minidual.show.report.indicators import INDICATORS
from minidual.show.report.paired import Paired, corrected, read_paired
from minidual.show.report.tables import Tables, finite
from minidual.trials.conditions import CLEAN

_THINNEST = 5
_COLUMNS = (*(item.column for item in INDICATORS if item.column is not None), "failed_at_s")


@dataclass(frozen=True)
class Trial:
    """One row of benchmark.csv.

    Attributes:
        failure: First fault, "" on success.
        numbers: Indicators and failed_at_s, SI; NaN where undefined.
    """

    method: str
    condition: str
    success: bool
    failure: str
    numbers: Mapping[str, float]


def read_trials(path: Path) -> list[Trial]:
    """Return the trials; DataError names file and bad line."""
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            reader = csv.DictReader(stream)
            columns = reader.fieldnames or ()
            for name in ("method", "condition", "success", "failure", *_COLUMNS):
                if name not in columns:
                    raise DataError(f"{path} lacks column '{name}'; there are {', '.join(columns) or 'none'}")
            return [_trial(row, f"{path}, line {reader.line_num}") for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{path} cannot be read: {error}") from error


def _trial(row: Mapping[str, str | None], where: str) -> Trial:
    success = {"true": True, "false": False}.get((row["success"] or "").lower())
    if success is None:
        raise DataError(f"{where}: success is '{row['success']}', must be True or False")
    numbers = {name: _number(row[name]) for name in _COLUMNS}
    return Trial(row["method"] or "", row["condition"] or "", success, row["failure"] or "", numbers)


def _number(text: str | None) -> float:
    try:
        return float(text or "nan")
    except ValueError:
        return math.nan


@dataclass(frozen=True)
class Reason:
    """Failures of a method by one fault; `at_s` is the median time."""

    method: str
    name: str
    times: int
    at_s: float | None


@dataclass(frozen=True)
class Gap:
    """Success of the policy on held-out starts with 95 % interval, and on training starts."""

    held_out: float
    low: float | None
    high: float | None
    training: float | None

    @property
    def within(self) -> bool:
        """Whether the training rate lies inside the held-out interval."""
        known = None not in (self.low, self.high, self.training)
        return known and float(self.low or 0.0) <= float(self.training or 0.0) <= float(self.high or 0.0)


@dataclass(frozen=True)
class Margin:
    """A check's margin as a share of its limit."""

    stage: str
    check: Check
    relative: float


@dataclass(frozen=True)
class Facts:
    """The analysis.

    Attributes:
        pairs: Undisturbed pairs of methods.
        partings: Disturbed pairs with a significant difference.
        losses: Significant effects of a disturbance.
        reasons: By method, most frequent first.
        margins: Thinnest first.
        at_best_n: Passed checks without a rankable margin.
    """

    pairs: tuple[Paired, ...]
    partings: tuple[Paired, ...]
    losses: tuple[Paired, ...]
    reasons: tuple[Reason, ...]
    gap: Gap | None
    margins: tuple[Margin, ...]
    at_best_n: int


def gather(verdicts: Mapping[str, Verdict], tables: Tables, trials: Sequence[Trial]) -> Facts:
    """Return the analysis; `trials` are the undisturbed ones."""
    rows = verdicts["benchmark"].data.get("comparisons", []) if "benchmark" in verdicts else []
    pairs = read_paired(rows, "comparisons", "condition")
    # Undisturbed pairs are their own Holm family: their result must not depend on which disturbances are run.
    clean = corrected([pair for pair in pairs if pair.family == CLEAN])
    disturbed = corrected([pair for pair in pairs if pair.family != CLEAN])
    margins, at_best = _margins(verdicts)
    return Facts(
        pairs=tuple(clean),
        partings=tuple(pair for pair in disturbed if pair.shown),
        losses=tuple(cell.loss for cell in tables.cells if cell.loss and cell.loss.shown),
        reasons=tuple(_reasons(trials)),
        gap=_gap(verdicts.get("deploy")),
        margins=tuple(margins[:_THINNEST]),
        at_best_n=at_best,
    )


def _reasons(trials: Sequence[Trial]) -> list[Reason]:
    found: list[Reason] = []
    for method in dict.fromkeys(trial.method for trial in trials):
        failed = [trial for trial in trials if trial.method == method and not trial.success]
        for name, times in Counter(trial.failure or "unnamed" for trial in failed).most_common():
            ended = [t.numbers["failed_at_s"] for t in failed if (t.failure or "unnamed") == name]
            ended = [value for value in ended if math.isfinite(value)]
            found.append(Reason(method, name, times, statistics.median(ended) if ended else None))
    return found


def _gap(deploy: Verdict | None) -> Gap | None:
    if deploy is None:
        return None
    known: dict[str, Any] = {**deploy.data, **{check.name: check.observed for check in deploy.checks}}
    held_out = finite(known.get("success_rate"))
    others = [finite(known.get(name)) for name in ("success_low", "success_high", "training_success_rate")]
    return None if held_out is None else Gap(held_out, *others)


def relative_margin(check: Check) -> float | None:
    """Return margin / limit, None if undefined."""
    if check.margin is None or not check.limit or check.op == "==":
        return None
    return finite(check.margin / abs(check.limit))


def _at_its_best(check: Check) -> bool:
    """Return whether a passed check cannot have a margin."""
    share = not check.unit and check.limit is not None and 0.0 < check.limit <= 1.0
    return check.margin == 0.0 or (share and check.op in (">", ">=") and check.observed == 1.0)


def _margins(verdicts: Mapping[str, Verdict]) -> tuple[list[Margin], int]:
    ranked: list[Margin] = []
    at_best = 0
    for stage, verdict in verdicts.items():
        for check in verdict.checks:
            relative = relative_margin(check)
            if relative is not None and relative >= 0.0 and _at_its_best(check):
                at_best += 1
            elif relative is not None:
                ranked.append(Margin(stage, check, relative))
    return sorted(ranked, key=lambda margin: margin.relative), at_best
