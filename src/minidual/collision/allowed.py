"""Pairs of links that may touch, each with its reason."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from minidual.errors import UsageError


@dataclass(frozen=True, order=True)
class AllowedPair:
    """Two links that may touch, in alphabetical order, and the reason."""

    first: str
    second: str
    reason: str


def allowed_pair(a: str, b: str, reason: str) -> AllowedPair:
    """Return the entry for links a and b in either order."""
    if a == b:
        raise UsageError(f"a link cannot be paired with itself: '{a}'")
    first, second = sorted((a, b))
    return AllowedPair(first, second, reason)


@dataclass(frozen=True)
class AllowedCollisions:
    """An immutable, hashable matrix; `with_pair` and `without_pair` return changed copies."""

    entries: frozenset[AllowedPair] = frozenset()

    @cached_property
    def _reasons(self) -> dict[tuple[str, str], str]:
        return {(e.first, e.second): e.reason for e in self.entries}

    def reason(self, a: str, b: str) -> str | None:
        """Return why a and b may touch, or None if the pair is checked."""
        return self._reasons.get((a, b) if a < b else (b, a))

    def with_pair(self, a: str, b: str, reason: str = "user") -> AllowedCollisions:
        """Return a copy in which a and b may touch."""
        kept = {e for e in self.entries if {e.first, e.second} != {a, b}}
        return AllowedCollisions(frozenset(kept | {allowed_pair(a, b, reason)}))

    def without_pair(self, a: str, b: str) -> AllowedCollisions:
        """Return a copy in which a and b are checked.

        Raises:
            UsageError: The pair was not allowed to begin with.
        """
        if self.reason(a, b) is None:
            raise UsageError(f"the pair {a} and {b} is checked already; it has no entry to remove")
        return AllowedCollisions(frozenset(e for e in self.entries if {e.first, e.second} != {a, b}))

    def table(self) -> list[tuple[str, str, str]]:
        """Return (link, link, reason) of every allowed pair, sorted."""
        return sorted((e.first, e.second, e.reason) for e in self.entries)

    def __iter__(self) -> Iterator[AllowedPair]:
        return iter(sorted(self.entries))

    def __len__(self) -> int:
        return len(self.entries)
