"""The arbiter under random interleavings of proposals, switches, delays and faults.

Never two sources in one tick, never a jump over the bound, never silence. The same checks are then turned on
arbiters that were broken on purpose, to show that they can say no.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from minidual.config.control import ArbiterConfig
from minidual.control.arbiter import ArbiterOutput, CommandArbiter
from minidual.control.commands import HOLD, SOURCES, ArbiterState, JointCommand
from minidual.control.mailbox import Mailbox
from minidual.robot.pair import DUAL_PANDA
from tests.support.panda import A_MAX, GROUPS, HOME, Q_LOWER, Q_UPPER

CONFIG = ArbiterConfig()
DRIVEN = (ArbiterState.ALIGNING, ArbiterState.ACTIVE)
Event = tuple[Any, ...]
TICK: Event = ("tick", 0.02, 0.0)


class Witness:
    """Plays events to an arbiter and its make-believe arms, and checks every output."""

    def __init__(self, arbiter: CommandArbiter) -> None:
        self.arbiter = arbiter
        self.now = 0.0
        self.q = HOME.copy()
        self.v = np.zeros(14)
        self.sequence = 0
        self.offered: dict[str, list[JointCommand]] = {source: [] for source in SOURCES}
        self.confirmed: str | None = None
        self.flushed_at = -np.inf
        self.last: np.ndarray | None = None
        self.outputs: list[ArbiterOutput] = []
        arbiter.on_flush.append(self._flushed)

    def _flushed(self, mode: str) -> None:
        self.flushed_at = self.now
        self.confirmed = None
        for commands in self.offered.values():
            commands.clear()

    def play(self, events: Sequence[Event]) -> None:
        for event in events:
            getattr(self, event[0])(*event[1:])

    def request(self, mode: str) -> None:
        self.arbiter.request(mode)

    def propose(self, source: str, group: str, offset: float, age: float, fault: str) -> None:
        self.sequence += 1
        # Each source lives in its own corner, so that a mixture would show.
        q = HOME[GROUPS[group]] + 0.15 * (SOURCES.index(source) - 1) + offset
        sequence = self.sequence
        if fault == "nan":
            q = np.where(np.arange(len(q)) == 2, np.nan, q)
        elif fault == "zero":
            q = np.zeros(len(q))
        elif fault == "limits":
            q = q + 4.0
        elif fault == "repeat":
            sequence -= 2
        command = JointCommand(q, np.array([0.5, 0.5]), self.now - age, sequence, group)
        if self.arbiter.propose(source, command) is None:
            assert fault in ("", "repeat")
            assert command.stamp_s >= self.flushed_at, "a command from before the switch was taken"
            self.offered[source].append(command)

    def burst(self, source: str, group: str, offset: float, times: int, follow: float) -> None:
        """A source at work: a command and a tick, again and again."""
        for _ in range(times):
            self.propose(source, group, offset, 0.0, "")
            self.tick(0.02, follow)

    def switch(self, source: str, offset: float) -> None:
        """A switch that the arms, at rest, let happen, and the source's first commands."""
        self.request(source)
        for _ in range(3):
            self.tick(0.02, 0.0)
        self.burst(source, "both_arms", offset, 2, 0.5)

    def tick(self, dt: float, follow: float) -> None:
        self.now += dt
        if self.last is not None:
            moved = follow * (self.last - self.q)
            self.q = self.q + moved
            self.v = moved / dt
        out = self.arbiter.tick(self.now, self.q, self.v)
        self.outputs.append(out)
        self._check(out)
        self.last = out.q_target

    def _check(self, out: ArbiterOutput) -> None:
        q = out.q_target
        assert q.shape == (14,), "silence"
        assert np.isfinite(q).all()
        assert (q >= Q_LOWER).all()
        assert (q <= Q_UPPER).all()
        assert np.isfinite(out.gripper).all()
        # A confirmed switch begins at the measured posture: the first step is bounded from there.
        last = self.q if self.last is None or out.switched_to is not None else self.last
        # Moving arms are held where they can come to rest with half of their acceleration limits.
        room = self.v**2 / A_MAX + 1e-12
        held_as_measured = (np.abs(q - self.q) <= room).reshape(2, 7).all(axis=1)  # of each arm
        steps = np.abs(q - last).reshape(2, 7).max(axis=1)
        assert ((steps <= CONFIG.switch_step_max_rad + 1e-12) | held_as_measured).all(), (
            f"jumped by {steps.max()}"
        )
        if out.switched_to is not None:
            self.confirmed = None if out.switched_to == HOLD else out.switched_to
        assert (out.active_source is not None) == (out.state in DRIVEN)
        if out.active_source is None:
            assert (held_as_measured | (steps == 0.0)).all(), "a held posture moved"
            return
        assert out.active_source == self.confirmed, (
            "driven by a source whose switch was not confirmed"
        )
        if out.state == ArbiterState.ACTIVE:
            self._check_provenance(out, last)

    def _check_provenance(self, out: ArbiterOutput, last: np.ndarray) -> None:
        """Each arm's target is the newest command of the one active source for it, or stays as it was."""
        assert out.active_source is not None
        for arm in range(2):
            part = slice(7 * arm, 7 * arm + 7)
            newest = next(
                (c for c in reversed(self.offered[out.active_source]) if arm in c.arms),
                None,
            )
            offered = newest is not None and (
                newest.q[part] if newest.group == "both_arms" else newest.q
            )
            from_source = newest is not None and np.array_equal(out.q_target[part], offered)
            fresh = newest is not None and self.now - newest.stamp_s <= CONFIG.stale_s + 1e-9
            # An arm whose commands have ended goes to where it can stop: never farther from the arm than there, or before.
            room = np.maximum(np.abs(last - self.q), self.v**2 / A_MAX) + 1e-12
            stops = not fresh and bool((np.abs(out.q_target - self.q) <= room)[part].all())
            stays = stops or np.array_equal(out.q_target[part], last[part])
            assert (from_source and fresh) or stays, "another source leaked in"


proposals = st.tuples(
    st.just("propose"),
    st.sampled_from(SOURCES),
    st.sampled_from(sorted(GROUPS)),
    st.sampled_from([0.0, 0.01, 0.05, -0.09, 0.3]),
    st.sampled_from([0.0, 0.0, 0.0, 0.03, 0.2, -3.0]),
    st.sampled_from(["", "", "", "", "nan", "zero", "limits", "repeat"]),
)
requests = st.tuples(st.just("request"), st.sampled_from((*SOURCES, HOLD)))
ticks = st.tuples(
    st.just("tick"),
    st.sampled_from([0.001, 0.02, 0.02, 0.15, 1.2]),
    st.sampled_from([0.0, 0.02, 1.0]),
)
offsets = st.sampled_from([0.0, 0.05, -0.09, 0.3])
bursts = st.tuples(
    st.just("burst"),
    st.sampled_from(SOURCES),
    st.sampled_from(sorted(GROUPS)),
    offsets,
    st.integers(1, 30),
    st.sampled_from([0.0, 0.3, 1.0]),
)
switches = st.tuples(st.just("switch"), st.sampled_from(SOURCES), offsets)
histories = st.lists(st.one_of(proposals, ticks, requests, bursts, switches), max_size=40)


@settings(max_examples=250)
@given(histories)
def test_one_source_bounded_steps_and_never_silence(events: list[Event]) -> None:
    witness = Witness(CommandArbiter(DUAL_PANDA, CONFIG))
    witness.play([TICK, *events])  # holds every output to the rules as it comes
    ticks_asked = 1 + sum(event[0] == "tick" for event in events)
    assert len(witness.outputs) >= ticks_asked, "a tick without an output"


def test_random_histories_reach_every_state() -> None:
    seen: Counter[ArbiterState] = Counter()

    @settings(max_examples=150, derandomize=True, database=None)
    @given(histories)
    def collect(events: list[Event]) -> None:
        witness = Witness(CommandArbiter(DUAL_PANDA, CONFIG))
        witness.play([TICK, *events])
        seen.update({out.state for out in witness.outputs})

    collect()
    assert set(seen) == set(ArbiterState)
    assert seen[ArbiterState.ACTIVE] > 40


@settings(max_examples=50)
@given(histories)
def test_the_same_history_gives_the_same_output(events: list[Event]) -> None:
    first = Witness(CommandArbiter(DUAL_PANDA, CONFIG))
    second = Witness(CommandArbiter(DUAL_PANDA, CONFIG))
    for witness in (first, second):
        witness.play([TICK, *events])
    for a, b in zip(first.outputs, second.outputs, strict=True):
        np.testing.assert_array_equal(a.q_target, b.q_target)
        assert (a.state, a.active_source, a.refusals) == (b.state, b.active_source, b.refusals)


def _say(source: str, offset: float = 0.0) -> Event:
    return ("propose", source, "both_arms", offset, 0.0, "")


# Teleop drives, policy talks over it, and then policy is asked for while its old command is still fresh.
HISTORY: list[Event] = [
    TICK,
    ("request", "teleop"),
    TICK,
    TICK,
    _say("teleop"),
    TICK,
    _say("policy", -0.14),
    TICK,
    _say("teleop", 0.05),
    TICK,
    _say("policy", -0.14),
    ("request", "policy"),
    TICK,
    TICK,
    TICK,
    _say("policy", 0.3),
    TICK,
    TICK,
]


def test_the_crafted_history_passes_an_arbiter_that_is_whole() -> None:
    witness = Witness(CommandArbiter(DUAL_PANDA, CONFIG))
    witness.play(HISTORY)
    assert [o.active_source for o in witness.outputs].count("teleop") == 3
    assert witness.outputs[-1].active_source == "policy"


def test_the_witness_sees_a_mailbox_that_is_not_flushed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Mailbox, "flush", lambda self, now_s: None)
    with pytest.raises(AssertionError, match=r"leaked|before the switch|jumped"):
        Witness(CommandArbiter(DUAL_PANDA, CONFIG)).play(HISTORY)


def test_the_witness_sees_a_missing_bound() -> None:
    with pytest.raises(AssertionError, match="jumped by"):
        Witness(
            CommandArbiter(
                DUAL_PANDA,
                ArbiterConfig().model_copy(update={"switch_step_max_rad": 0.5}),
            ),
        ).play(HISTORY)


def test_the_witness_sees_two_sources_in_one_tick(monkeypatch: pytest.MonkeyPatch) -> None:
    arbiter = CommandArbiter(DUAL_PANDA, CONFIG)
    everyone = arbiter._mailboxes["teleop"]  # all sources drop their commands into one box
    for source in SOURCES:
        monkeypatch.setitem(arbiter._mailboxes, source, everyone)
    with pytest.raises(AssertionError, match="leaked"):
        Witness(arbiter).play(HISTORY)
