"""Trials, summaries and paired tests as CSV, JSON and Markdown."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from minidual import durable
from minidual.demos.smoothness import JERK_FILTER
from minidual.errors import DataError, NothingEvaluatedError, UsageError
from minidual.trials.comparisons import compare_all, compare_with_clean
from minidual.trials.metrics import MethodSummary, TrialMetrics
from minidual.trials.statistics import CONFIDENCE

#: Meaning of table columns whose names do not say it.
DEFINITIONS: dict[str, str] = {
    "jerk_filter": JERK_FILTER,
    "success_interval": f"Wilson score, {CONFIDENCE:.0%}",
    "median_interval": f"percentile bootstrap of the median over trials, {CONFIDENCE:.0%}: *_low and *_high",
    "over_successful_trials": "duration, path length, least internal force, least pinch force",
    "over_all_trials": "torque, jerk, tilt, goal error",
    "paired_test": "McNemar, exact, two-sided, on shared starts",
    "paired_rate_interval": f"Newcombe's score interval of paired proportions (1998, method 10), {CONFIDENCE:.0%}",
    "paired_duration_interval": "percentile bootstrap of the median difference over starts that both completed",
}


def write_csv(path: Path | str, rows: Sequence[TrialMetrics | MethodSummary]) -> Path:
    """Write one row per trial or method; raise NothingEvaluatedError without rows."""
    if not rows:
        raise NothingEvaluatedError(f"no rows for {path}: nothing was evaluated")
    return write_rows(Path(path), [row.to_row() for row in rows])


def write_json(
    path: Path | str,
    summaries: Sequence[MethodSummary],
    trials: Sequence[TrialMetrics],
    extra: Mapping[str, Any] | None = None,
    *,
    seed: int = 0,
) -> Path:
    """Write definitions, summaries, comparisons and trials as one document; `extra` adds top-level entries.

    Raises:
        NothingEvaluatedError: No trials.
        UsageError: `extra` repeats an entry.
        DataError: The file cannot be written, or a value is NaN or infinite.
    """
    if not trials:
        raise NothingEvaluatedError(f"no trials for {path}: nothing was evaluated")
    document: dict[str, Any] = {
        "definitions": DEFINITIONS,
        "methods": [_with_failures(summary) for summary in summaries],
        "comparisons": compare_all(trials, seed),
        "losses": compare_with_clean(trials, seed),
        "trials": [trial.to_row() for trial in trials],
    }
    clash = set(document) & set(extra or {})
    if clash:
        raise UsageError(f"the document already has an entry {', '.join(sorted(clash))}")
    try:
        text = json.dumps({**document, **(extra or {})}, indent=1, allow_nan=False)
    except ValueError as error:
        raise DataError(f"{path}: {error}") from error
    return write_text(Path(path), text + "\n")


def _with_failures(summary: MethodSummary) -> dict[str, Any]:
    return {**summary.to_row(), "failures": dict(summary.failures)}


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]], *, missing: str = "") -> Path:
    """Write CSV; `missing` fills absent values."""
    text = io.StringIO()
    names = list(dict.fromkeys(name for row in rows for name in row))
    writer = csv.DictWriter(text, fieldnames=names, restval=missing, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return write_text(path, text.getvalue())


def markdown(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return rows of equal keys as a Markdown table."""
    heads = [head.replace("_", " ") for head in rows[0]]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    return lines + ["| " + " | ".join(str(v) for v in row.values()) + " |" for row in rows]


def write_text(path: Path, text: str) -> Path:
    """Write a file atomically; raise DataError if that fails."""
    durable.make_folder(path.parent)
    try:
        durable.write_text(path, text)
    except OSError as error:
        raise DataError(
            f"{path} could not be written: {error}", remedy="free space on the disk or choose another folder"
        ) from error
    return path
