"""Checks with their units, reasons and remedies from checks.yaml."""

import functools

from minidual.gate.check import Check, Rows, checks_of
from minidual.registry import rows_beside


@functools.cache
def _words() -> dict[str, dict[str, dict[str, str]]]:
    return rows_beside(__file__, "checks.yaml")


def worded(stage: str, rows: Rows, prefix: str = "", **names: object) -> list[Check]:
    """See `checks_of`."""
    return checks_of(_words()[stage], rows, prefix, **names)
