"""Rows of benchmark.csv: one trial of one method."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from minidual.errors import DataError
from minidual.show.report.indicators import INDICATORS

CLEAN = "clean"
"""Condition of the trials that nothing disturbs; limits, ranks and figures of single trials are theirs."""

_NUMBERS = tuple(item.column for item in INDICATORS if item.column is not None)
_COLUMNS = (*_NUMBERS, "failed_at_s")
_REQUIRED = ("method", "condition", "index", "success", "failure", *_COLUMNS)


@dataclass(frozen=True)
class Trial:
    """One trial.

    Attributes:
        method: Who drove the arms.
        condition: What the world did to it, "clean" for nothing.
        index: Number of the start; methods share them.
        success: The task's one success test.
        failure: Name of the first fault, "" on success.
        numbers: Columns of the indicators and failed_at_s; NaN where the trial has no such value.
    """

    method: str
    condition: str
    index: int
    success: bool
    failure: str
    numbers: dict[str, float] = field(default_factory=dict)


def read_trials(path: Path) -> list[Trial]:
    """Return the trials in `path`.

    Raises:
        DataError: the file is missing, lacks a column, or a row cannot be read; names file and line.
    """
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            reader = csv.DictReader(stream)
            columns = reader.fieldnames or ()
            lacking = [name for name in _REQUIRED if name not in columns]
            if lacking:
                raise DataError(f"{path} lacks column '{lacking[0]}'; there are {', '.join(columns) or 'none'}")
            return [_trial(row, path, reader.line_num) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{path} cannot be read: {error}") from error


def _trial(row: dict[str, str | None], path: Path, line: int) -> Trial:
    success = (row["success"] or "").strip().lower()
    if success not in ("true", "false", "1", "0"):
        raise DataError(f"{path}, line {line}: success is '{row['success']}', must be True or False")
    try:
        index = int(row["index"] or "")
    except ValueError as error:
        raise DataError(f"{path}, line {line}: index is '{row['index']}', must be a whole number") from error
    return Trial(
        method=row["method"] or "",
        condition=row["condition"] or "",
        index=index,
        success=success in ("true", "1"),
        failure=row["failure"] or "",
        numbers={name: _number(row[name]) for name in _COLUMNS},
    )


def _number(text: str | None) -> float:
    """Return the number, NaN for the words that stand where a number does not exist."""
    try:
        return float(text or "nan")
    except ValueError:
        return math.nan


def of_method(trials: Sequence[Trial], method: str) -> list[Trial]:
    """Return the trials of `method`."""
    return [trial for trial in trials if trial.method == method]


def undisturbed(trials: Sequence[Trial]) -> list[Trial]:
    """Return the trials that nothing disturbed."""
    return [trial for trial in trials if trial.condition == CLEAN]


def values(trials: Sequence[Trial], column: str) -> list[float]:
    """Return the finite values of `column`."""
    return [v for trial in trials if math.isfinite(v := trial.numbers[column])]
