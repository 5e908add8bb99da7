"""What the stages of a search came to: counts and reasons, as a tree."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from minidual.skills.pipeline.stage import Failure

_WIDTH = 220


@dataclass
class StageRecord:
    """One stage.

    Attributes:
        name: Of the stage.
        tried_n: Candidates that it was asked for.
        solved_n: Those that came to something.
        failures: How often each reason, and the first message with it.
        chosen: Label of the candidate in the solution.
    """

    name: str
    tried_n: int = 0
    solved_n: int = 0
    failures: Counter[str] = field(default_factory=Counter)
    messages: dict[str, str] = field(default_factory=dict)
    chosen: str | None = None

    def failed(self, failure: Failure) -> None:
        """Count one failure."""
        self.tried_n += 1
        self.failures[failure.reason] += 1
        self.messages.setdefault(failure.reason, failure.message)

    def solved(self) -> None:
        """Count one candidate that came to something."""
        self.tried_n += 1
        self.solved_n += 1

    def to_json(self) -> dict[str, Any]:
        """Return the counts as plain data."""
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
    """A whole search.

    Attributes:
        stages: In the order of time.
        took_s: Wall time.
        ended: Why it ended without a solution; empty if it has one.
    """

    stages: list[StageRecord]
    took_s: float = 0.0
    ended: str = ""

    def deepest(self) -> StageRecord | None:
        """Return the stage that stopped the search: of those that only failed, the one that failed most."""
        stuck = [s for s in self.stages if s.tried_n > 0 and s.solved_n == 0]
        return max(stuck, key=lambda s: sum(s.failures.values()), default=None)

    def tree(self, title: str) -> str:
        """Return counts and reasons as a tree of text."""
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
        """Return everything as plain data."""
        return {"took_s": self.took_s, "ended": self.ended, "stages": [stage.to_json() for stage in self.stages]}
