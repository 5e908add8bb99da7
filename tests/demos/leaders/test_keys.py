"""Keys from the bytes of a terminal: the same events however the bytes are split or merged."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from minidual.demos.leaders.keys import ESCAPE_WAIT_S, STOP, KeyParser

SEQUENCES = [
    b"\x1b[A",
    b"\x1bOD",
    b"\x1b[1;5C",
    b"\x1b[3~",
    b"\x1b[15;2~",
    b"\x1b[<0;12;7M",
    b"\x1b[<0;12;7m",
    b"\x1b[M #x",
    b"\x1b[?62;22c",
    b"\x1b[200~wwx \nr\x1b[201~",
]
"""Arrows, function keys, reports of a mouse and of the terminal, and a paste."""
PIECES = [*SEQUENCES, b"w", b"x", b" ", b"\t", b"\n", b"\x1b\x1b", b"\x1b\x1bw", b"\xc3\xa9"]


def events_of(chunks: list[bytes], apart_s: float = 0.001) -> list[str]:
    """Return the events of reads a little apart, and of the silence after them."""
    parser = KeyParser()
    now_s = 0.0
    events: list[str] = []
    for chunk in chunks:
        events += parser.feed(chunk, now_s)
        now_s += apart_s
    return events + parser.feed(b"", now_s + ESCAPE_WAIT_S)


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_a_known_sequence_gives_nothing_wherever_it_is_split(sequence: bytes) -> None:
    for cut in range(len(sequence) + 1):
        assert events_of([sequence[:cut], sequence[cut:]]) == []


@pytest.mark.parametrize(
    ("data", "events"),
    [
        (b"\x1b", [STOP]),
        (b"\x1b\x1b\x1b", [STOP, STOP, STOP]),
        (b"ww\x1b", ["w", "w", STOP]),
        (b"\x1bw", [STOP]),
        (b"\x1b[A\x1b", [STOP]),
        (b"\x1b\x1b[A", [STOP]),
        (b"\x1b[\n", [STOP]),
        (b"\x1b[27u", [STOP]),
        (b"\x1b[27;1;27~", [STOP]),
        (b"\x1b[200~ww\x1bq", [STOP]),
        (b"\x1b[M\x1b", [STOP]),
        (b"\x1bX", [STOP]),
    ],
)
def test_any_other_escape_stops(data: bytes, events: list[str]) -> None:
    assert events_of([data]) == events


def test_an_arrow_that_comes_too_late_stops_and_its_letters_move_nothing() -> None:
    parser = KeyParser()
    assert parser.feed(b"\x1b", 0.0) == []
    assert parser.feed(b"", ESCAPE_WAIT_S / 2) == []
    assert parser.feed(b"", ESCAPE_WAIT_S) == [STOP]
    assert parser.feed(b"[", 1.0) == []
    assert parser.feed(b"A", 2.0) == []
    assert parser.feed(b"w", 3.0) == ["w"]


def test_bytes_that_waited_while_the_process_was_busy_are_one_sequence() -> None:
    parser = KeyParser()
    assert parser.feed(b"\x1b", 0.0) == []
    assert parser.feed(b"[Aw", 10 * ESCAPE_WAIT_S) == ["w"]


def test_a_paste_that_never_ends_gives_the_keys_back_after_a_silence() -> None:
    parser = KeyParser()
    assert parser.feed(b"\x1b[200~ww", 0.0) == []
    assert parser.feed(b"w", 0.5) == []
    assert parser.feed(b"", 2.0) == []
    assert parser.feed(b"w", 2.1) == ["w"]


@given(st.data())
def test_random_splits_give_the_same_events(data: st.DataObject) -> None:
    pieces = data.draw(st.lists(st.sampled_from(PIECES) | st.binary(max_size=4), max_size=8))
    stream = b"".join(pieces)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    bounds = [0, *cuts, len(stream)]
    chunks = [stream[a:b] for a, b in itertools.pairwise(bounds)]
    whole = events_of([stream])
    # A read without bytes before the time of an Escape is up changes nothing.
    assert events_of(chunks) == whole
    assert all(event == STOP or len(event) == 1 for event in whole)


@given(st.lists(st.sampled_from(SEQUENCES), max_size=6), st.lists(st.integers(0, 99), max_size=5))
def test_known_sequences_in_any_pieces_neither_move_nor_stop(
    sequences: list[bytes],
    cuts: list[int],
) -> None:
    stream = b"".join(sequences)
    bounds = sorted({0, len(stream), *(min(cut, len(stream)) for cut in cuts)})
    chunks = [stream[a:b] for a, b in itertools.pairwise(bounds)]
    assert events_of(chunks) == []
