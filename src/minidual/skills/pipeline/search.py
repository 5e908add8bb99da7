"""Search a task's stages: preferred candidates first, going back where a stage comes to nothing, connectors last."""

from __future__ import annotations

import heapq
import itertools
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from minidual.collision.errors import PlanningError
from minidual.errors import UsageError
from minidual.skills.pipeline.record import Record, StageRecord
from minidual.skills.pipeline.stage import (
    Backward,
    Candidate,
    Connector,
    Failure,
    Forward,
    Generator,
    Offer,
    Stage,
    Tools,
)
from minidual.skills.pipeline.state import Segment, State


class TaskFailedError(PlanningError):
    """No way through all stages; `record` holds counts and reasons."""

    reason = "task_failed"

    def __init__(self, message: str, *, remedy: str | None = None, record: Record | None = None) -> None:
        super().__init__(message, remedy=remedy)
        self.record = record


@dataclass(frozen=True, eq=False)
class Solution:
    """A way through all stages.

    Attributes:
        segments: In the order of time.
        states: Interface states: the start, then the end of every stage.
        record: What was tried.
        cost: Sum of the preferences.
    """

    segments: tuple[Segment, ...]
    states: tuple[State, ...]
    record: Record
    cost: float

    @property
    def duration_s(self) -> float:
        """Time that it takes to drive [s]."""
        return sum(segment.duration_s for segment in self.segments)


class _Shared:
    """Offers of one stage for one input, made once however many partial solutions lead to that input."""

    def __init__(self, offers: Iterator[Offer], inputs: tuple[State, ...]) -> None:
        self._offers = offers
        self._inputs = inputs  # kept, so that their identity stays theirs
        self._made: list[Offer] = []

    def get(self, position: int) -> tuple[Offer | None, bool]:
        """Return the offer at a position (None: there is none) and whether it was made just now."""
        if position < len(self._made):
            return self._made[position], False
        offer = next(self._offers, None)
        if offer is not None:
            self._made.append(offer)
        return offer, offer is not None


@dataclass
class _Node:
    """A partial solution and the offers of the stage that comes next in the order of solving."""

    done: Mapping[int, Candidate]
    depth: int
    cost: float
    offers: _Shared
    position: int = 0


class Task:
    """Stages in the order of time.

    Between two connectors there is one generator (none before the first connector, where the start is given);
    what stands before it leads up to it (Backward), what stands after it goes on from it (Forward).

    Args:
        name: For people.
        stages: In the order of time.

    Raises:
        UsageError: Stages that cannot be solved in any order, or two of one name.
    """

    def __init__(self, name: str, stages: Sequence[Stage]) -> None:
        self.name = name
        self.stages = tuple(stages)
        names = [stage.name for stage in stages]
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise UsageError(f"the task '{name}' has two stages called '{twice[0]}'")
        self.order = solve_order(self.stages)

    def solve(self, start: State, tools: Tools, *, budget_s: float = 60.0, tries_max: int = 2000) -> Solution:
        """Return the first whole way, in the order of preference.

        Args:
            start: Where everything is.
            tools: Planners and scene.
            budget_s: Wall time after which to give up.
            tries_max: Candidates after which to give up.

        Raises:
            TaskFailedError: Every candidate failed, or budget or tries ended; its message is the tree.
        """
        record = Record([StageRecord(stage.name) for stage in self.stages])
        began = time.perf_counter()
        ticket = itertools.count()
        known: dict[tuple[int, ...], _Shared] = {}
        root = _Node({}, 0, 0.0, self._offers({}, 0, start, tools, known))
        heap: list[tuple[float, int, int, _Node]] = [(0.0, 0, next(ticket), root)]
        tries = 0
        while heap:
            record.took_s = time.perf_counter() - began
            if record.took_s > budget_s or tries >= tries_max:
                record.ended = f"gave up after {tries} candidates and {record.took_s:.1f} s"
                break
            _, _, _, node = heapq.heappop(heap)
            index = self.order[node.depth]
            offer, is_new = node.offers.get(node.position)
            node.position += 1
            tries += is_new
            if offer is None:
                continue
            if isinstance(offer, Failure):
                if is_new:
                    record.stages[index].failed(offer)
                heapq.heappush(heap, (node.cost, -node.depth, next(ticket), node))
                continue
            if is_new:
                record.stages[index].solved()
            done = {**node.done, index: offer}
            total = _total(done)
            # The next offer of the same stage is no better than this one.
            node.cost = max(node.cost, total)
            heapq.heappush(heap, (node.cost, -node.depth, next(ticket), node))
            if len(done) == len(self.stages):
                record.took_s = time.perf_counter() - began
                return self._solution(start, done, record)
            depth = node.depth + 1
            child = _Node(done, depth, total, self._offers(done, depth, start, tools, known))
            heapq.heappush(heap, (total, -depth, next(ticket), child))
        record.took_s = time.perf_counter() - began
        stuck = record.deepest()
        record.ended = record.ended or "no way through"
        where = f"'{stuck.name}' stops it" if stuck is not None else "no stage stops it alone"
        raise TaskFailedError(
            f"the task '{self.name}' failed; {where}\n{record.tree(self.name)}",
            remedy="offer more candidates, make room in the scene, or move start or goal",
            record=record,
        )

    def _offers(
        self,
        done: Mapping[int, Candidate],
        depth: int,
        start: State,
        tools: Tools,
        known: dict[tuple[int, ...], _Shared],
    ) -> _Shared:
        """Return the offers of the next stage; those for the same input states are the same ones."""
        index = self.order[depth]
        stage = self.stages[index]
        before = start if index == 0 or index - 1 not in done else done[index - 1].end
        match stage:
            case Generator():
                inputs: tuple[State, ...] = (self._before_block(done, index, start),)
            case Backward():
                inputs = (done[index + 1].start,)
            case Connector():
                inputs = (before, done[index + 1].start)
            case _:
                inputs = (before,)
        key = (index, *(id(state) for state in inputs))
        if key not in known:
            known[key] = _Shared(stage.offers(*inputs, tools), inputs)
        return known[key]

    def _before_block(self, done: Mapping[int, Candidate], index: int, start: State) -> State:
        """Return the end of the block before a generator's, or the start of all."""
        while index > 0 and not isinstance(self.stages[index], Connector):
            index -= 1
        return done[index - 1].end if index > 0 else start

    def _solution(self, start: State, done: Mapping[int, Candidate], record: Record) -> Solution:
        segments: list[Segment] = []
        states = [start]
        for index in range(len(self.stages)):
            segments += done[index].segments
            states.append(done[index].end)
            record.stages[index].chosen = done[index].label
        return Solution(tuple(segments), tuple(states), record, _total(done))


def _total(done: Mapping[int, Candidate]) -> float:
    return sum(candidate.cost for candidate in done.values())


def solve_order(stages: Sequence[Stage]) -> tuple[int, ...]:
    """Return the indices of the stages in the order of solving: block by block, then the connectors.

    A block is solved outward from its generator: what leads up to it, then what goes on from it.

    Raises:
        UsageError: A block without its one generator, or a stage on the wrong side of it.
    """
    order: list[int] = []
    connectors = [i for i, stage in enumerate(stages) if isinstance(stage, Connector)]
    bounds = [-1, *connectors, len(stages)]
    for first, last in itertools.pairwise(bounds):
        block = list(range(first + 1, last))
        makers = [i for i in block if isinstance(stages[i], Generator)]
        if first == -1 and not makers:  # goes on from the given start
            makers, pivot = [], -1
        elif len(makers) == 1:
            pivot = makers[0]
        else:
            names = ", ".join(stages[i].name for i in block) or "nothing"
            raise UsageError(
                f"{len(makers)} generators in the stages after '{stages[first].name if first >= 0 else 'the start'}' "
                f"({names}); there must be one"
            )
        for i in block:
            wanted = Backward if i < pivot else Forward
            if i != pivot and not isinstance(stages[i], wanted):
                raise UsageError(
                    f"stage '{stages[i].name}' stands {'before' if i < pivot else 'after'} the generator and must be "
                    f"a {wanted.__name__} stage"
                )
        order += [*makers, *(i for i in reversed(block) if i < pivot), *(i for i in block if i > pivot)]
    for i in connectors:
        if i == len(stages) - 1:
            raise UsageError(f"connector '{stages[i].name}' leads nowhere: a state must follow it")
    return (*order, *connectors)
