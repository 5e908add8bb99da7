"""Pairs of links that may touch."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from minidual.errors import UsageError


@dataclass(frozen=True)
class AllowedCollisions:
    """An immutable, hashable matrix; `rows` are (link, link, reason) with sorted names."""

    rows: frozenset[tuple[str, str, str]] = frozenset()

    @cached_property
    def _reasons(self) -> dict[tuple[str, str], str]:
        return {(a, b): reason for a, b, reason in self.rows}

    def reason(self, a: str, b: str) -> str | None:
        """Return the reason, or None if checked."""
        return self._reasons.get((a, b) if a < b else (b, a))

    def with_pair(self, a: str, b: str, reason: str = "user") -> AllowedCollisions:
        """Return a copy allowing the pair."""
        if a == b:
            raise UsageError(f"a link cannot be paired with itself: '{a}'")
        first, second = sorted((a, b))
        return AllowedCollisions(self._others(a, b) | {(first, second, reason)})

    def without_pair(self, a: str, b: str) -> AllowedCollisions:
        """Return a copy checking the pair; UsageError if checked already."""
        if self.reason(a, b) is None:
            raise UsageError(f"the pair {a} and {b} is checked already; it has no entry to remove")
        return AllowedCollisions(self._others(a, b))

    def _others(self, a: str, b: str) -> frozenset[tuple[str, str, str]]:
        return frozenset(row for row in self.rows if {a, b} != {*row[:2]})

    def table(self) -> list[tuple[str, str, str]]:
        """Return sorted (link, link, reason)."""
        return sorted(self.rows)
