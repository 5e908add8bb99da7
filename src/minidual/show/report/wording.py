"""Numbers, lists and fault names as words."""

import math
from collections.abc import Sequence
from typing import Any

from minidual.gate.check import Number, with_unit
from minidual.registry import rows_beside

WORDS: dict[str, Any] = rows_beside(__file__, "templates/words.yaml")
"""Words of the checks, captions by stage and file, and faults by violated condition of success."""


def fault(name: str) -> str:
    """Return a violated condition in words."""
    return WORDS["faults"].get(name, name.replace("_", " ") or "unnamed")


def joined(items: Sequence[str]) -> str:
    """Return "a, b and c"."""
    return " and ".join([", ".join(items[:-1]), items[-1]] if len(items) > 1 else items)


def moment(stamp: str) -> str:
    """Return an ISO time as "2026-01-31 12:00:00 UTC"."""
    return stamp.replace("T", " ").replace("Z", " UTC")


def commit(name: str | None) -> str:
    """Return the short name of a commit, with its mark of changes."""
    identifier, plus, changes = (name or "unknown").partition("+")
    return identifier[:10] + plus + changes


def duration(seconds: float) -> str:
    """Return e.g. "4 min 05 s"."""
    if seconds < 59.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def percent(share: float) -> str:
    """Return "85 %"; one decimal below 1 % and above 99 %."""
    return (
        f"{share * 100:.1f} %"
        if 0.0 < share < 0.01 or 0.99 < share < 1.0
        else f"{share * 100:.0f} %"
    )


def points(difference: float) -> str:
    """Return percentage points: "+5", "0", "−12"."""
    whole = round(100.0 * difference)
    return f"{whole:+d}".replace("-", "\u2212") if whole else "0"


def quantity(value: Number | None, unit: str) -> str:
    """Return a value with its unit, angles in degrees too."""
    text = with_unit(value, unit)
    if (
        unit == "rad"
        and isinstance(value, float)
        and math.isfinite(value)
        and abs(math.degrees(value)) >= 0.01
    ):
        text += f" ({math.degrees(value):.3g}°)"
    return text
