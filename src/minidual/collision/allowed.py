"""Pairs of links that may touch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from minidual.errors import UsageError


@dataclass(frozen=True, order=True)
class AllowedPair:
    """Two sorted links, and the reason."""

    first: str
    second: str
    reason: str


def allowed_pair(a: str, b: str, reason: str) -> AllowedPair:
    """Sort the names and return the entry."""
    if a == b:
        raise UsageError(f"a link cannot be paired with itself: '{a}'")
    first, second = sorted((a, b))
    return AllowedPair(first, second, reason)


@dataclass(frozen=True)
class AllowedCollisions:
    """An immutable, hashable matrix."""

    entries: frozenset[AllowedPair] = frozenset()

    @cached_property
    def _reasons(self) -> dict[tuple[str, str], str]:
        return {(e.first, e.second): e.reason for e in self.entries}

    def reason(self, a: str, b: str) -> str | None:
        """Return the reason, or None if checked."""
        return self._reasons.get((a, b) if a < b else (b, a))

    def with_pair(self, a: str, b: str, reason: str = "user") -> AllowedCollisions:
        """Return a copy allowing the pair."""
        kept = {e for e in self.entries if {e.first, e.second} != {a, b}}
        return AllowedCollisions(frozenset(kept | {allowed_pair(a, b, reason)}))

    def without_pair(self, a: str, b: str) -> AllowedCollisions:
        """Return a copy that checks the pair; UsageError if already checked."""
        if self.reason(a, b) is None:
            raise UsageError(f"the pair {a} and {b} is checked already; it has no entry to remove")
        return AllowedCollisions(frozenset(e for e in self.entries if {e.first, e.second} != {a, b}))

    def table(self) -> list[tuple[str, str, str]]:
        """Return sorted (link, link, reason)."""
        return sorted((e.first, e.second, e.reason) for e in self.entries)

    def __iter__(self) -> Iterator[AllowedPair]:
        return iter(sorted(self.entries))

    def __len__(self) -> int:
        return len(self.entries)
