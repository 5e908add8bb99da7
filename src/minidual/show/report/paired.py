"""Paired success differences on shared starts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from minidual.errors import DataError
from minidual.trials.statistics import holm

CERTAIN = 0.05
"""Two-sided significance level after Holm's correction."""
_NUMBERS = {
    "starts": "trials_n",
    "only_first": "only_first_n",
    "only_second": "only_second_n",
    "difference": "rate_difference",
    "low": "rate_difference_low",
    "high": "rate_difference_high",
    "p_value": "p_value",
}
_FASTER = ("duration_difference_s", "duration_difference_low_s", "duration_difference_high_s")


@dataclass(frozen=True)
class Paired:
    """Success of `first` minus `second` on shared starts.

    Attributes:
        family: Shared condition or method.
        difference: Of the rates, with 95 % interval `low` to `high`.
        p_value: Exact McNemar.
        p_holm: Holm-corrected.
        slower_s: Median difference of completion time with 95 % interval [s], None without a shared success.
    """

    family: str
    first: str
    second: str
    starts: float
    only_first: float
    only_second: float
    difference: float
    low: float
    high: float
    p_value: float
    p_holm: float = math.nan
    slower_s: tuple[float, float, float] | None = None

    @property
    def shown(self) -> bool:
        """Whether the difference is significant."""
        return self.p_holm < CERTAIN


def read_paired(rows: Any, name: str, family: str) -> list[Paired]:
    """Return the complete rows, uncorrected; `name` and `family` are keys.

    Raises:
        DataError: Malformed rows or p values.
    """
    if not isinstance(rows, Sequence) or not all(isinstance(row, Mapping) for row in rows):
        raise DataError(f"the benchmark's data has no list '{name}' of mappings")
    found: list[Paired] = []
    for row in rows:
        lacking = [key for key in (family, "first", "second") if not isinstance(row.get(key), str)]
        if lacking:
            raise DataError(f"a row of '{name}' in the benchmark's data lacks '{lacking[0]}'")
        numbers = {key: row.get(column) for key, column in _NUMBERS.items()}
        if not all(_is_number(value) for value in numbers.values()):
            continue
        if not 0.0 <= row["p_value"] <= 1.0:
            raise DataError(
                f"a row of '{name}' in the benchmark's data has p_value {row['p_value']:g}; it must be 0 to 1"
            )
        slower = tuple(row.get(column) for column in _FASTER)
        known = slower if all(_is_number(value) for value in slower) else None
        found.append(Paired(row[family], row["first"], row["second"], **numbers, slower_s=known))
    return found


def corrected(pairs: Sequence[Paired]) -> list[Paired]:
    """Return `pairs` after Holm's correction over all."""
    return [replace(pair, p_holm=p) for pair, p in zip(pairs, holm([pair.p_value for pair in pairs]), strict=True)]


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
