"""Checks with their units, reasons and remedies from checks.yaml."""

import functools
from collections.abc import Mapping

from minidual.gate.check import Check, Number, Op
from minidual.registry import rows_beside

Rows = Mapping[str, Number | tuple[Number, Op, Number | None]]
"""{check: observed value, or (observed value, operator, limit)}; without a limit it is only reported."""


@functools.cache
def _words() -> dict[str, dict[str, dict[str, str]]]:
    return rows_beside(__file__, "checks.yaml")


def worded(stage: str, rows: Rows, prefix: str = "", **names: object) -> list[Check]:
    """Return a check per row, called `prefix` and its name; `names` are filled into the texts."""
    checks = []
    for name, row in rows.items():
        observed, op, limit = row if isinstance(row, tuple) else (row, None, None)
        words = {key: text.format(**names) for key, text in _words()[stage][name].items()}
        checks.append(Check(f"{prefix}{name}", observed, None if limit is None else op, limit, **words))
    return checks
