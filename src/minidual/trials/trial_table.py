"""Count the results in a written table of trials."""

import csv
import math
from collections import Counter
from pathlib import Path
from typing import NamedTuple

from minidual.durable import reading

_REMEDY = "run the stage again with --force"


class Series(NamedTuple):
    """Trials of one method under one condition; `task` is "" in a table without tasks."""

    method: str
    condition: str
    task: str = ""


def count_results(path: Path) -> Counter[Series]:
    """Count each series' results in a table of `TrialMetrics.to_row`.

    A result is a trial index with one row and a finite end. Two rows of an index count as none,
    because one of them belongs to another trial.

    Raises:
        DataError: The table is missing, cut or corrupt.
    """
    rows_n: Counter[tuple[Series, int]] = Counter()
    ended: set[tuple[Series, int]] = set()
    with reading(path, _REMEDY), path.open(encoding="utf-8", newline="") as stream:
        for row in csv.DictReader(stream):
            series = Series(row["method"], row["condition"], row.get("task", ""))
            trial = series, int(row["index"])
            rows_n[trial] += 1
            if math.isfinite(_end_s(row)):
                ended.add(trial)
    return Counter(trial[0] for trial in ended if rows_n[trial] == 1)


def _end_s(row: dict[str, str]) -> float:
    """Return when a trial succeeded or failed [s]; NaN for the words of an absent number."""
    text = row["duration_s"] if row["success"] == str(True) else row["failed_at_s"]
    try:
        return float(text)
    except ValueError:
        return math.nan
