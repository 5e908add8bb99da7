"""Tables as Markdown."""

from collections.abc import Mapping, Sequence
from typing import Any


def markdown(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return rows of equal keys as a Markdown table."""
    heads = [head.replace("_", " ") for head in rows[0]]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    return lines + ["| " + " | ".join(str(v) for v in row.values()) + " |" for row in rows]
