"""Chunks: played one after the other, and as late as their answers come."""

from __future__ import annotations

import numpy as np

from minidual.policies.chunks import ChunkQueue

HOLD = np.array([-1.0])


def chunk(first: float, n: int = 10) -> np.ndarray:
    return first + np.arange(n, dtype=float)[:, None]


def played(queue: ChunkQueue, ticks: int) -> list[float]:
    return [float(queue.next(HOLD)[0]) for _ in range(ticks)]


def test_an_answer_at_once_is_played_from_its_first_action() -> None:
    queue = ChunkQueue(steps=4, blend_ticks=0)
    assert queue.is_due
    queue.add(chunk(100.0), 0)
    assert played(queue, 4) == [100.0, 101.0, 102.0, 103.0]
    assert queue.is_due
    queue.add(chunk(200.0), 0)
    assert played(queue, 2) == [200.0, 201.0]


def test_before_the_first_answer_the_arms_hold_and_the_late_actions_are_skipped() -> None:
    queue = ChunkQueue(steps=6, blend_ticks=0)
    queue.add(chunk(100.0), 3)
    assert not queue.is_due
    assert played(queue, 5) == [-1.0, -1.0, -1.0, 103.0, 104.0]


def test_while_an_answer_is_on_its_way_the_chunk_before_goes_on() -> None:
    queue = ChunkQueue(steps=4, blend_ticks=0)
    queue.add(chunk(100.0), 0)
    played(queue, 4)
    queue.add(chunk(200.0), 2)
    assert not queue.is_due
    assert played(queue, 4) == [104.0, 105.0, 202.0, 203.0]


def test_the_last_action_is_held_when_a_chunk_ends_before_the_next_comes() -> None:
    queue = ChunkQueue(steps=3, blend_ticks=0)
    queue.add(chunk(100.0, 3), 0)
    played(queue, 3)
    queue.add(chunk(200.0), 2)
    assert played(queue, 3) == [102.0, 102.0, 202.0]


def test_a_late_chunk_is_blended_from_when_it_comes() -> None:
    queue = ChunkQueue(steps=4, blend_ticks=1)
    queue.add(chunk(100.0), 0)
    played(queue, 4)
    queue.add(chunk(200.0), 1)
    assert played(queue, 3) == [104.0, 0.5 * 201.0 + 0.5 * 105.0, 202.0]


def test_a_reset_drops_what_is_on_its_way() -> None:
    queue = ChunkQueue(steps=4, blend_ticks=2)
    queue.add(chunk(100.0), 0)
    played(queue, 2)
    queue.add(chunk(200.0), 1)
    queue.reset()
    assert queue.is_due
    assert played(queue, 2) == [-1.0, -1.0]
