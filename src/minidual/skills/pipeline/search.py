"""Best-first search over a task's stages; deepest first at equal cost."""

from __future__ import annotations

import heapq
import itertools
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from minidual.collision.errors import PlanningError
from minidual.errors import UsageError
from minidual.skills.phases import Segment, State
from minidual.skills.pipeline.stage import Candidate, CandidateError, Offer, Stage, Tools

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

    def to_json(self) -> dict[str, Any]:
        """Return JSON data; reasons with count and first message, most frequent first."""
        reasons = [
            {"reason": reason, "count": len(m), "first": m[0]}
            for reason, m in self.failures.items()
        ]
        reasons.sort(key=lambda entry: -entry["count"])
        counts = {"tried_n": self.solved_n + self.failed_n, "solved_n": self.solved_n}
        return {"stage": self.name, **counts, "chosen": self.chosen, "failures": reasons}


@dataclass
class Record:
    """Record of a search; `ended` says why it found nothing."""

    stages: list[StageRecord]
    took_s: float = 0.0
    ended: str = ""

    def deepest(self) -> StageRecord | None:
        """Return the stage without success that has most failures."""
        return max(
            (s for s in self.stages if s.failures and not s.solved_n),
            key=lambda s: s.failed_n,
            default=None,
        )

    def tree(self, title: str) -> str:
        """Return a text tree."""
        lines = [f"{title}: {self.ended or 'solved'} ({self.took_s:.2f} s)"]
        for stage in self.stages:
            branch, below = ("└─", "   ") if stage is self.stages[-1] else ("├─", "│  ")
            chosen = f"  -> {stage.chosen}" if stage.chosen else ""
            row = stage.to_json()
            counts = f"{stage.solved_n} of {row['tried_n']}" if row["tried_n"] else "not reached"
            lines.append(f"{branch} {stage.name:14s} {counts}{chosen}")
            for entry in row["failures"]:
                text = f"{entry['count']} x {entry['reason']}: {entry['first']}"
                lines.append(
                    f"{below}    {text if len(text) <= _WIDTH else text[: _WIDTH - 3] + '...'}",
                )
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """Return JSON data."""
        return {
            "took_s": self.took_s,
            "ended": self.ended,
            "stages": [stage.to_json() for stage in self.stages],
        }


class TaskFailedError(PlanningError, reason="task_failed"):
    """No way through all stages."""

    def __init__(self, name: str, record: Record) -> None:
        blocking = record.deepest()
        where = "no stage stops it alone" if blocking is None else f"'{blocking.name}' stops it"
        what = f"the task '{name}' failed; {where}\n{record.tree(name)}"
        super().__init__(
            what,
            remedy="offer more grasps or places, make room in the scene, or move start or goal",
        )
        self.record = record
        messages = [] if blocking is None else ["; ".join(m[0] for m in blocking.failures.values())]
        self.summary = ": ".join([where, *messages])
        """One line: the blocking stage and its messages."""


@dataclass(frozen=True, eq=False)
class Solution:
    """A plan through all stages.

    Attributes:
        pipeline, tools: Of the search.
        parts: Segments of each stage.
        states: Start, then each stage's end.
    """

    pipeline: Pipeline
    tools: Tools
    parts: tuple[tuple[Segment, ...], ...]
    states: tuple[State, ...]
    record: Record

    @property
    def segments(self) -> tuple[Segment, ...]:
        """In time order."""
        return tuple(itertools.chain(*self.parts))

    @property
    def duration_s(self) -> float:
        """Execution time [s]."""
        return sum(segment.trajectory.duration_s for segment in self.segments)


@dataclass
class _Node:
    """A partial solution and the next stage's offers."""

    done: tuple[Candidate, ...]
    cost: float
    offers: Iterator[Offer]


class Pipeline:
    """Stages in time order; a stage further is worth `keenness` of cost.

    Raises:
        UsageError: No stages, or duplicate names.
    """

    def __init__(self, name: str, stages: Sequence[Stage], keenness: float = 0.0) -> None:
        self.name = name
        self.stages = tuple(stages)
        self.keenness = keenness
        if not (names := [stage.name for stage in stages]):
            raise UsageError(f"the task '{name}' has no stage")
        if twice := sorted({n for n in names if names.count(n) > 1}):
            raise UsageError(f"the task '{name}' has two stages called '{twice[0]}'")

    def solve(
        self,
        start: State,
        tools: Tools,
        *,
        budget_s: float = 300.0,
        tries_max: int = 2000,
    ) -> Solution:
        """Return the first complete plan within the limits of wall time [s] and candidates.

        Raises:
            TaskFailedError: All candidates failed, or a limit was reached.
        """
        record = Record([StageRecord(stage.name) for stage in self.stages])
        began = time.perf_counter()
        ticket = itertools.count()
        tries = 0
        heap: list[tuple[float, int, int, _Node]] = []

        def push(node: _Node) -> None:
            depth = len(node.done)
            heapq.heappush(heap, (node.cost - self.keenness * depth, -depth, next(ticket), node))

        push(_Node((), 0.0, self.stages[0].offers(start, tools)))
        while heap:
            record.took_s = time.perf_counter() - began
            if record.took_s > budget_s or tries >= tries_max:
                record.ended = f"gave up after {tries} candidates and {record.took_s:.1f} s"
                break
            node = heapq.heappop(heap)[-1]
            stage = record.stages[len(node.done)]
            try:
                offer = next(node.offers, None)
                if isinstance(offer, Candidate) and tools.gap is not None:
                    tools.gap.check(offer.segments)
            except PlanningError as error:
                offer = CandidateError(error.reason, error.message)
            if offer is None:
                continue
            tries += 1
            if isinstance(offer, CandidateError):
                stage.failures.setdefault(offer.reason, []).append(offer.message)
                push(node)
                continue
            stage.solved_n += 1
            done = (*node.done, offer)
            total = sum(candidate.cost for candidate in done)
            node.cost = max(node.cost, total)  # later offers of a stage are assumed to cost no less
            push(node)
            if len(done) == len(self.stages):
                record.took_s = time.perf_counter() - began
                for found, candidate in zip(record.stages, done, strict=True):
                    found.chosen = candidate.label
                parts, states = zip(
                    *((candidate.segments, candidate.end) for candidate in done),
                    strict=True,
                )
                return Solution(self, tools, parts, (start, *states), record)
            push(_Node(done, total, self.stages[len(done)].offers(offer.end, tools)))
        record.took_s = time.perf_counter() - began
        record.ended = record.ended or "no way through"
        raise TaskFailedError(self.name, record)
