"""Counts and failure reasons of a search."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from minidual.skills.pipeline.stage import Failure

_WIDTH = 220


@dataclass
class StageRecord:
    """Counts of one stage; `failures` and `messages` (the first) are by reason."""

    name: str
    tried_n: int = 0
    solved_n: int = 0
    failures: Counter[str] = field(default_factory=Counter)
    messages: dict[str, str] = field(default_factory=dict)
    chosen: str | None = None

    def failed(self, failure: Failure) -> None:
        """Count a failure."""
        self.tried_n += 1
        self.failures[failure.reason] += 1
        self.messages.setdefault(failure.reason, failure.message)

    def solved(self) -> None:
        """Count a success."""
        self.tried_n += 1
        self.solved_n += 1

    def to_json(self) -> dict[str, Any]:
        """Return JSON data."""
        reasons = [{"reason": r, "count": n, "first": self.messages[r]} for r, n in self.failures.most_common()]
        return {
            "stage": self.name,
            "tried_n": self.tried_n,
            "solved_n": self.solved_n,
            "chosen": self.chosen,
            "failures": reasons,
        }


@dataclass
class Record:
    """Record of a search; `ended` says why it found nothing."""

    stages: list[StageRecord]
    took_s: float = 0.0
    ended: str = ""

    def deepest(self) -> StageRecord | None:
        """Return the stage with most failures among those without success."""
        stuck = [s for s in self.stages if s.tried_n > 0 and s.solved_n == 0]
        return max(stuck, key=lambda s: sum(s.failures.values()), default=None)

    def tree(self, title: str) -> str:
        """Return a text tree."""
        head = f"{title}: {self.ended or 'solved'} ({self.took_s:.2f} s)"
        lines = [head]
        for index, stage in enumerate(self.stages):
            last = index == len(self.stages) - 1
            chosen = f"  -> {stage.chosen}" if stage.chosen else ""
            counts = "not reached" if stage.tried_n == 0 else f"{stage.solved_n} of {stage.tried_n}"
            lines.append(f"{'└─' if last else '├─'} {stage.name:14s} {counts}{chosen}")
            for reason, count in stage.failures.most_common():
                text = f"{count} x {reason}: {stage.messages[reason]}"
                text = text if len(text) <= _WIDTH else f"{text[: _WIDTH - 3]}..."
                lines.append(f"{'   ' if last else '│  '}    {text}")
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """Return JSON data."""
        return {"took_s": self.took_s, "ended": self.ended, "stages": [stage.to_json() for stage in self.stages]}
