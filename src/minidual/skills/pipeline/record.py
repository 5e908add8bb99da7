"""Record of a search over stages."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

_WIDTH = 220
"""Longest failure in a tree, in characters."""


@dataclass
class StageRecord:
    """Counts of one stage; `failures` holds the messages by reason."""

    name: str
    solved_n: int = 0
    failures: dict[str, list[str]] = field(default_factory=dict)
    chosen: str | None = None

    @property
    def failed_n(self) -> int:
        """Number of failed candidates."""
        return sum(map(len, self.failures.values()))

    @property
    def tried_n(self) -> int:
        """Number of candidates."""
        return self.solved_n + self.failed_n

    def add_failure(self, reason: str, message: str) -> None:
        """Count a failed candidate."""
        self.failures.setdefault(reason, []).append(message)

    def frequent_failures(self) -> list[tuple[str, list[str]]]:
        """Return reasons and messages, most frequent first."""
        return sorted(self.failures.items(), key=lambda failure: -len(failure[1]))

    def to_json(self) -> dict[str, Any]:
        """Return JSON data; reasons with count and first message, most frequent first."""
        return {
            "stage": self.name,
            "tried_n": self.tried_n,
            "solved_n": self.solved_n,
            "chosen": self.chosen,
            "failures": [
                {"reason": reason, "count": len(messages), "first": messages[0]}
                for reason, messages in self.frequent_failures()
            ],
        }


@dataclass
class Record:
    """Record of a search; `ended` says why it found nothing."""

    stages: list[StageRecord]
    took_s: float = 0.0
    ended: str = ""

    def deepest(self) -> StageRecord | None:
        """Return the stage without success that has most failures."""
        blocking = [stage for stage in self.stages if stage.failures and not stage.solved_n]
        return max(blocking, key=lambda stage: stage.failed_n, default=None)

    def tree(self, title: str) -> str:
        """Return a text tree."""
        lines = [f"{title}: {self.ended or 'solved'} ({self.took_s:.2f} s)"]
        for stage in self.stages:
            is_last = stage is self.stages[-1]
            branch = "└─" if is_last else "├─"
            below = "   " if is_last else "│  "
            chosen = f"  -> {stage.chosen}" if stage.chosen else ""
            tried_n = stage.tried_n
            counts = f"{stage.solved_n} of {tried_n}" if tried_n else "not reached"
            lines.append(f"{branch} {stage.name:14s} {counts}{chosen}")
            for reason, messages in stage.frequent_failures():
                failure = f"{len(messages)} x {reason}: {messages[0]}"
                lines.append(f"{below}    {_shortened(failure)}")
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """Return JSON data."""
        return {
            "took_s": self.took_s,
            "ended": self.ended,
            "stages": [stage.to_json() for stage in self.stages],
        }


def _shortened(text: str) -> str:
    return text if len(text) <= _WIDTH else f"{text[: _WIDTH - 3]}..."
