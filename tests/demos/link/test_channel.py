"""The simulated network carries packets late, loses some, and lets the newest count."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from minidual.config.link import SimulatedNetwork
from minidual.config.seeds import stream
from minidual.demos.link.channel import Channel

DT_S = 0.001
BAD = SimulatedNetwork(delay=0.05, jitter=0.02, loss=0.1, reorder=0.05)


def received(network: SimulatedNetwork, steps_n: int, seed: int = 0) -> tuple[list[int], Channel]:
    """Return the number of the packet that counts in each step, -1 before the first."""
    channel = Channel([network], DT_S, stream(seed, "test"), np.array([[-1.0]]))
    numbers: list[int] = []
    for k in range(steps_n):
        packet = channel.exchange(np.array([[float(k)]]))
        numbers.append(int(packet[0, 0]))
    return numbers, channel


def test_without_a_network_a_packet_arrives_at_once() -> None:
    numbers, _ = received(SimulatedNetwork(), 20)
    assert numbers == list(range(20))


def test_each_way_takes_half_of_the_round_trip() -> None:
    numbers, _ = received(SimulatedNetwork(delay=0.02), 30)
    assert numbers == [-1] * 10 + list(range(20))


@given(seed=st.integers(0, 10_000))
def test_an_older_packet_never_follows_a_newer_one(seed: int) -> None:
    numbers, _ = received(BAD, 300, seed)
    assert np.all(np.diff(numbers) >= 0)


def test_losses_and_late_packets_are_counted() -> None:
    numbers, channel = received(BAD, 5000)
    assert channel.lost_n[0] == pytest.approx(500, abs=100)
    assert channel.late_n[0] > 100
    assert numbers[-1] > 4900


def test_the_same_seed_gives_the_same_network() -> None:
    assert received(BAD, 500, seed=3)[0] == received(BAD, 500, seed=3)[0]
    assert received(BAD, 500, seed=3)[0] != received(BAD, 500, seed=4)[0]


def test_channels_side_by_side_have_networks_of_their_own() -> None:
    networks = [SimulatedNetwork(), SimulatedNetwork(delay=0.01)]
    channel = Channel(networks, DT_S, stream(0, "test"), np.zeros((2, 1)))
    for k in range(10):
        packets = channel.exchange(np.full((2, 1), float(k + 1)))
    assert packets[:, 0].tolist() == [10.0, 5.0]
