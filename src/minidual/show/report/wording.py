"""Numbers and lists as words."""

from __future__ import annotations

from collections.abc import Sequence

_SMALL = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


def count(n: int, noun: str, plural: str | None = None) -> str:
    """Return "one trial", "three trials", "12 trials"."""
    number = _SMALL[n] if 0 <= n < len(_SMALL) else str(n)
    return f"{number} {noun if n == 1 else plural or noun + 's'}"


def joined(items: Sequence[str], last: str = "and") -> str:
    """Return "a", "a and b" or "a, b and c"."""
    if len(items) < 2:
        return "".join(items)
    return f"{', '.join(items[:-1])} {last} {items[-1]}"


def duration(seconds: float) -> str:
    """Return "12.3 s", "4 min 05 s" or "1 h 02 min"."""
    if seconds < 59.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def percent(share: float) -> str:
    """Return "85 %"; one decimal below one per cent."""
    return f"{share * 100:.1f} %" if 0.0 < share < 0.01 else f"{share * 100:.0f} %"


def points(difference: float) -> str:
    """Return a difference of two shares in points: "+5", "0", "−12"."""
    whole = round(100.0 * difference)
    return f"{whole:+d}".replace("-", "\u2212") if whole else "0"


def sentence(text: str) -> str:
    """Return `text` with a capital and a full stop."""
    return stated(text[:1].upper() + text[1:])


def stated(text: str) -> str:
    """Return `text` with a full stop, its first word as it is: names of methods and stages keep their case."""
    return text + ("" if text.endswith(".") else ".")
