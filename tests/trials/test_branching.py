"""Runs that branch: copies begin alike, know nothing of each other, and what breaks is told."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from typing import Any

import psutil
import pytest

from minidual.trials.branching import BranchError, BranchPoint, Forge, Lost, Trunk, Trunks
from minidual.workers import processor_time_s

BUSY_S = 0.3


def _use_processor(seconds: float) -> None:
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


class Counting:
    """Counts from a number to the branch point; from there on, adds what it is told."""

    def __init__(self, step: int) -> None:
        self.step = step
        self.prepared: list[Any] = []

    def prepare(self, request: Any) -> None:
        if request == "bad":
            raise ValueError("nothing can be prepared")
        self.prepared.append(request)

    def run(self, request: Any, branches: BranchPoint) -> str:
        if request == "lost":
            return "it went astray"
        if request == "breaks early":
            raise RuntimeError("no way")
        total = self.step * int(request)
        branches.here()
        while True:
            told = branches.exchange((total, len(self.prepared)))
            if told == "break":
                raise RuntimeError("a copy may break")
            if told == "die":
                os.kill(os.getpid(), signal.SIGKILL)
            if told == "compute":
                _use_processor(BUSY_S)
                told = 0
            if told == "end":
                branches.end(("ended", total))
            total += told


@pytest.fixture(scope="module")
def forge() -> Iterator[Forge]:
    made = Forge(Counting, 10)
    yield made
    made.close()


def waiting(forge: Forge, request: Any = 1) -> Trunk:
    trunk = forge.start(request)
    assert trunk.wait() is None
    return trunk


def told(trunk: Trunk, *messages: Any) -> list[Any]:
    """Return the answers of a new copy to some messages, its first word before them."""
    trunk.branch()
    answers = [trunk.receive()]
    for message in messages:
        trunk.send(message)
        answers.append(trunk.receive())
    return answers


def test_copies_begin_alike_and_know_nothing_of_each_other(forge: Forge) -> None:
    trunk = waiting(forge, 3)
    first = told(trunk, 5, 1, "end")
    second = told(trunk, "end")
    assert [total for total, _ in first[:3]] == [30, 35, 36]
    assert first[3] == ("ended", 36)
    assert second[0][0] == 30
    assert second[1] == ("ended", 30)
    trunk.close()


def test_runs_go_on_beside_each_other(forge: Forge) -> None:
    trunks = [waiting(forge, number) for number in (1, 2)]
    for trunk in trunks:
        trunk.branch()
    assert [trunk.receive()[0] for trunk in trunks] == [10, 20]
    for trunk in trunks:
        trunk.close()


def test_what_the_forge_prepares_is_in_all_later_runs(forge: Forge) -> None:
    earlier = waiting(forge)
    later = waiting(forge)
    (_, before), (_, after) = told(earlier, "end")[0], told(later, "end")[0]
    assert after == before + 1


def test_a_run_that_never_comes_to_its_branch_point_says_why(forge: Forge) -> None:
    trunk = forge.start("lost")
    assert trunk.wait() == Lost("it went astray")
    assert trunk.wait() == Lost("it went astray")


@pytest.mark.parametrize(
    ("request_", "message"),
    [("breaks early", "no way"), ("bad", "nothing can be prepared")],
)
def test_a_run_that_breaks_is_an_error(forge: Forge, request_: str, message: str) -> None:
    with pytest.raises(BranchError, match=message):
        forge.start(request_).wait()


def test_a_copy_that_breaks_is_an_error_and_others_follow(forge: Forge) -> None:
    trunk = waiting(forge)
    with pytest.raises(BranchError, match="a copy may break"):
        told(trunk, "break")
    assert told(trunk, "end")[1] == ("ended", 10)
    with pytest.raises(BranchError, match="a copy ended with -9"):
        told(trunk, "die")
    assert told(trunk, "end")[1] == ("ended", 10)
    trunk.close()


def test_trunks_that_are_given_back_are_used_again(forge: Forge) -> None:
    trunks = Trunks(forge)
    first = trunks.start(4)
    assert first.wait() is None
    told(first, "end")
    trunks.keep(4, first)
    assert trunks.start(4) is first
    other = trunks.start(4)
    assert other is not first
    for trunk in (first, other):
        trunk.close()


def test_the_processor_time_of_runs_counts_while_they_live_and_after(forge: Forge) -> None:
    began_s = processor_time_s()
    trunk = waiting(forge)
    told(trunk, "compute")
    assert processor_time_s() - began_s >= 0.9 * BUSY_S
    trunk.send("end")
    trunk.receive()
    trunk.close()
    of_forge = psutil.Process(forge._process.pid)
    while of_forge.children():
        time.sleep(0.01)
    assert processor_time_s() - began_s >= 0.9 * BUSY_S


def test_a_closed_forge_starts_nothing_and_leaves_no_process() -> None:
    forge = Forge(Counting, 1)
    trunk = waiting(forge)
    trunk.branch()
    trunk.receive()
    trunk.close()
    process = forge._process
    forge.close()
    assert not process.is_alive()
    with pytest.raises(BranchError, match="has ended"):
        forge.start(1)


def test_an_answer_to_a_closed_run_is_an_error(forge: Forge) -> None:
    trunk = waiting(forge)
    trunk.branch()
    trunk.receive()
    trunk.send("end")
    trunk.receive()
    trunk.close()
    time.sleep(0.01)
    with pytest.raises(BranchError):
        trunk.branch()
