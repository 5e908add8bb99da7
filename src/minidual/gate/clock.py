"""Wall-clock times as text."""

from __future__ import annotations

from datetime import UTC, datetime


def now_text() -> str:
    """Return the UTC time in ISO 8601, to the second."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def now_stamp() -> str:
    """Return the UTC time for a file name: "20260131-120000"."""
    return datetime.now(UTC).strftime("%Y%m%d-%H%M%S")
