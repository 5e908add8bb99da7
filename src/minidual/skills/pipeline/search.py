"""Best-first search over a task's stages; deepest first at equal cost."""

from __future__ import annotations

import heapq
import itertools
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from minidual.collision.errors import PlanningError
from minidual.errors import UsageError
from minidual.skills.pipeline.record import Record, StageRecord
from minidual.skills.pipeline.stage import Candidate, CandidateError, Offer, Stage, Tools
from minidual.skills.states import Segment, State

_CANDIDATE_CHECKS_N = 2_000
"""Charge for a candidate besides its searches: straight motions and their proof take 0.1 s."""


class TaskFailedError(PlanningError, reason="task_failed"):
    """No way through all stages.

    Attributes:
        record: Of the search.
        summary: One line: the blocking stage and its messages.
    """

    def __init__(self, name: str, record: Record) -> None:
        blocking = record.deepest()
        if blocking is None:
            where = "no stage stops it alone"
            self.summary = where
        else:
            where = f"'{blocking.name}' stops it"
            first_messages = [messages[0] for messages in blocking.failures.values()]
            self.summary = f"{where}: {'; '.join(first_messages)}"
        super().__init__(
            f"the task '{name}' failed; {where}\n{record.tree(name)}",
            remedy="offer more grasps or places, make room in the scene, or move start or goal",
        )
        self.record = record


@dataclass(frozen=True, eq=False)
class Solution:
    """A plan through all stages.

    Attributes:
        pipeline: Of the search.
        tools: Of the search.
        parts: Segments of each stage.
        states: Start, then each stage's end.
        record: Of the search.
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


class _Frontier:
    """Nodes, cheapest first; a stage further is worth `keenness` of cost."""

    def __init__(self, keenness: float) -> None:
        self._keenness = keenness
        self._tickets = itertools.count()
        self._heap: list[tuple[float, int, int, _Node]] = []

    def __bool__(self) -> bool:
        return bool(self._heap)

    def push(self, node: _Node) -> None:
        depth = len(node.done)
        order = (node.cost - self._keenness * depth, -depth, next(self._tickets))
        heapq.heappush(self._heap, (*order, node))

    def pop(self) -> _Node:
        return heapq.heappop(self._heap)[-1]


class Pipeline:
    """Stages in time order; a stage further is worth `keenness` of cost.

    Raises:
        UsageError: No stages, or duplicate names.
    """

    def __init__(self, name: str, stages: Sequence[Stage], keenness: float = 0.0) -> None:
        self.name = name
        self.stages = tuple(stages)
        self.keenness = keenness
        names = [stage.name for stage in stages]
        if not names:
            raise UsageError(f"the task '{name}' has no stage")
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise UsageError(f"the task '{name}' has two stages called '{repeated[0]}'")

    def solve(
        self,
        start: State,
        tools: Tools,
        *,
        budget_checks_n: int = 12_000_000,
        tries_max: int = 2000,
    ) -> Solution:
        """Return the first complete plan within the limits of work and candidates.

        Work is counted as in `motion.budget`: the default takes 4 to 20 minutes.

        Raises:
            TaskFailedError: All candidates failed, or a limit was reached.
        """
        record = Record([StageRecord(stage.name) for stage in self.stages])
        began_s = time.perf_counter()
        work = tools.planner.work
        spent_before_n = work.spent_n
        tries = 0
        frontier = _Frontier(self.keenness)
        frontier.push(_Node((), 0.0, self.stages[0].offers(start, tools)))
        while frontier:
            checks_n = work.spent_n - spent_before_n
            if checks_n >= budget_checks_n or tries >= tries_max:
                record.ended = f"gave up after {tries} candidates and {checks_n} state checks"
                break
            node = frontier.pop()
            offer = _next_offer(node, tools)
            if offer is None:
                continue
            tries += 1
            work.spend(_CANDIDATE_CHECKS_N)
            stage_record = record.stages[len(node.done)]
            if isinstance(offer, CandidateError):
                stage_record.add_failure(offer.reason, offer.message)
                frontier.push(node)
                continue
            stage_record.solved_n += 1
            done = (*node.done, offer)
            cost = sum(candidate.cost for candidate in done)
            node.cost = max(node.cost, cost)  # later offers of a stage are assumed to cost no less
            frontier.push(node)
            if len(done) == len(self.stages):
                record.took_s = time.perf_counter() - began_s
                return self._solution(start, tools, done, record)
            next_stage = self.stages[len(done)]
            frontier.push(_Node(done, cost, next_stage.offers(offer.end, tools)))
        record.took_s = time.perf_counter() - began_s
        if not record.ended:
            record.ended = "no way through"
        raise TaskFailedError(self.name, record)

    def _solution(
        self,
        start: State,
        tools: Tools,
        done: Sequence[Candidate],
        record: Record,
    ) -> Solution:
        for stage_record, candidate in zip(record.stages, done, strict=True):
            stage_record.chosen = candidate.label
        parts = tuple(candidate.segments for candidate in done)
        ends = [candidate.end for candidate in done]
        return Solution(self, tools, parts, (start, *ends), record)


def _next_offer(node: _Node, tools: Tools) -> Offer | None:
    """Return the next offer of a node, None after the last; a planner's error is a failure."""
    try:
        offer = next(node.offers, None)
        if isinstance(offer, Candidate) and tools.gap is not None:
            tools.gap.check(offer.segments)
    except PlanningError as error:
        return CandidateError(error.reason, error.message)
    return offer
