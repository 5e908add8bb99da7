"""Checks with their units, reasons and remedies from checks.yaml."""

from minidual.gate.check import Check, Rows, checks_of
from minidual.registry import rows_beside

_WORDS: dict[str, dict[str, dict[str, str]]] = rows_beside(__file__, "checks.yaml")


def worded(stage: str, rows: Rows, prefix: str = "", **names: object) -> list[Check]:
    """See `checks_of`."""
    return checks_of(_WORDS[stage], rows, prefix, **names)
