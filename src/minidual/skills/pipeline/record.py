"""Counts and failure reasons of a search."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

_WIDTH = 220


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

    def reasons(self) -> list[dict[str, Any]]:
        """Return reasons with count and first message, most frequent first."""
        found = [{"reason": reason, "count": len(m), "first": m[0]} for reason, m in self.failures.items()]
        return sorted(found, key=lambda entry: -entry["count"])


@dataclass
class Record:
    """Record of a search; `ended` says why it found nothing."""

    stages: list[StageRecord]
    took_s: float = 0.0
    ended: str = ""

    def deepest(self) -> StageRecord | None:
        """Return the stage without success that has most failures."""
        return max((s for s in self.stages if s.failures and not s.solved_n), key=lambda s: s.failed_n, default=None)

    def tree(self, title: str) -> str:
        """Return a text tree."""
        lines = [f"{title}: {self.ended or 'solved'} ({self.took_s:.2f} s)"]
        for stage in self.stages:
            branch, below = ("└─", "   ") if stage is self.stages[-1] else ("├─", "│  ")
            chosen = f"  -> {stage.chosen}" if stage.chosen else ""
            counts = f"{stage.solved_n} of {stage.tried_n}" if stage.tried_n else "not reached"
            lines.append(f"{branch} {stage.name:14s} {counts}{chosen}")
            for entry in stage.reasons():
                text = f"{entry['count']} x {entry['reason']}: {entry['first']}"
                lines.append(f"{below}    {text if len(text) <= _WIDTH else text[: _WIDTH - 3] + '...'}")
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """Return JSON data."""
        stages = [
            {"stage": s.name, "tried_n": s.tried_n, "solved_n": s.solved_n, "chosen": s.chosen, "failures": s.reasons()}
            for s in self.stages
        ]
        return {"took_s": self.took_s, "ended": self.ended, "stages": stages}
