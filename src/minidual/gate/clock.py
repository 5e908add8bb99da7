"""Wall-clock times as text."""

from __future__ import annotations

from datetime import UTC, datetime


def now_text() -> str:
    """Return the time as ISO 8601 in UTC, to the second: "2026-01-31T12:00:00Z"."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def now_stamp() -> str:
    """Return the time for a file name: "20260131-120000"."""
    return datetime.now(UTC).strftime("%Y%m%d-%H%M%S")
