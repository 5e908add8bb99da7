"""The network that a recording simulates, as a person types it."""

from __future__ import annotations

import pytest

from minidual.config.link import EXAMPLE, SimulatedNetwork


def test_every_part_is_read() -> None:
    network = SimulatedNetwork.parse("delay=100ms,jitter=0.02s,loss=5%,reorder=1%")
    assert network == SimulatedNetwork(0.1, 0.02, 0.05, 0.01)


def test_what_is_left_out_is_none() -> None:
    assert SimulatedNetwork.parse("loss=2.5%") == SimulatedNetwork(loss=0.025)


def test_the_text_is_read_again() -> None:
    network = SimulatedNetwork.parse(EXAMPLE)
    assert SimulatedNetwork.parse(network.text) == network


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("lag=3ms", "there are delay, jitter, loss, reorder"),
        ("", "there are delay"),
        ("delay=100", "expected a number with ms or s"),
        ("delay=-5ms", "expected a number with ms or s"),
        ("loss=0.1", "expected a number with %"),
        ("delay=3s", "at most 2s"),
        ("loss=60%", "at most 50%"),
        ("loss=1%,loss=2%", "given twice"),
    ],
)
def test_what_is_wrong_is_named(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        SimulatedNetwork.parse(text)
