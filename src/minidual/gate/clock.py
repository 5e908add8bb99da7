"""Wall-clock times as text."""

from datetime import UTC, datetime


def now_text() -> str:
    """Return the UTC time in ISO 8601, to the second."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
