"""A program leads over a real WebSocket; pages of strangers and slow readers harm nothing."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from minidual.config.leading import NetworkConfig
from minidual.demos.leader import LeaderSample
from minidual.demos.leaders.network import NetworkLeader
from minidual.demos.station import Button
from minidual.errors import EnvironmentMissingError
from minidual.robot.pair import DUAL_PANDA
from tests.support.browser import unused_port
from tests.support.leading_program import assert_both_arms_moved, episode_led_by

HOME = DUAL_PANDA.home


def leader_with(**settings: Any) -> NetworkLeader:
    config = {"transport": "websocket", "port": 0, "silence_max_s": 1.5, **settings}
    return NetworkLeader(DUAL_PANDA, NetworkConfig.model_validate(config))


@pytest.fixture
def leader() -> Iterator[NetworkLeader]:
    made = leader_with()
    yield made
    made.close()


@pytest.fixture
def link(leader: NetworkLeader) -> Iterator[ClientConnection]:
    with connect(address_of(leader)) as made:
        yield made


def address_of(leader: NetworkLeader) -> str:
    return f"ws://127.0.0.1:{leader.port}"


def message(sequence: int, **fields: Any) -> str:
    base = {"version": 1, "sender": "me", "sequence": sequence, "stamp_s": time.monotonic()}
    return json.dumps({**base, "q": HOME.tolist(), **fields})


def read_until(
    leader: NetworkLeader,
    holds: Callable[[LeaderSample | None], bool],
    limit_s: float = 10.0,
) -> LeaderSample | None:
    """Return the first reading for which something holds."""
    end_s = time.monotonic() + limit_s
    while True:
        sample = leader.read(0.0)
        if holds(sample):
            return sample
        assert time.monotonic() < end_s, f"it did not happen in time: {sample}, {leader.counts}"
        time.sleep(0.005)


def is_at(q: np.ndarray) -> Callable[[LeaderSample | None], bool]:
    def holds(sample: LeaderSample | None) -> bool:
        return sample is not None and sample.q is not None and bool(np.allclose(sample.q, q))

    return holds


def test_the_newest_target_leads_and_each_message_is_answered(
    leader: NetworkLeader,
    link: ClientConnection,
) -> None:
    moved = HOME + 0.01
    link.send(message(1))
    link.send(message(2, q=moved.tolist(), openings=[0.25, 1.0], pressed=["start"]).encode())
    sample = read_until(leader, is_at(moved))
    assert sample is not None
    np.testing.assert_array_equal(sample.openings, [0.25, 1.0])
    assert sample.pressed == (Button.START,)
    answers = [json.loads(link.recv(5.0)) for _ in range(2)]
    assert [answer["sequence"] for answer in answers] == [1, 2]
    np.testing.assert_allclose(answers[0]["q"], HOME)


def test_old_duplicated_and_malformed_messages_are_dropped_and_counted(
    leader: NetworkLeader,
    link: ClientConnection,
) -> None:
    moved = (HOME + 0.01).tolist()
    for text in (
        message(5, q=moved),
        message(5),
        message(3),
        "{}",
        b"\xff\xfe",
        message(6, q=None),
    ):
        link.send(text)
    expected = {"duplicated": 1, "late": 1, "malformed": 2}
    sample = read_until(leader, lambda _: leader.counts == expected)
    assert is_at(HOME + 0.01)(sample)


def test_a_program_that_hangs_up_falls_silent_and_another_one_takes_over(
    leader: NetworkLeader,
) -> None:
    with connect(address_of(leader)) as first:
        first.send(message(100))
        read_until(leader, is_at(HOME))
    assert read_until(leader, lambda sample: sample is None) is None
    with connect(address_of(leader)) as second:
        second.send(message(0, sender="restarted", q=(HOME + 0.1).tolist()))
        assert read_until(leader, is_at(HOME + 0.1)) is not None


def test_only_pages_that_are_named_may_lead() -> None:
    leader = leader_with(origins=["http://localhost:3000"])
    try:
        with pytest.raises(InvalidStatus, match="403"):
            connect(address_of(leader), origin="http://evil.example")  # type: ignore[arg-type]
        with connect(address_of(leader), origin="http://localhost:3000") as page:  # type: ignore[arg-type]
            page.send(message(1))
            read_until(leader, is_at(HOME))
    finally:
        leader.close()


def test_a_program_that_never_reads_its_answers_holds_nothing_up(leader: NetworkLeader) -> None:
    with connect(address_of(leader), close_timeout=0.1) as link:
        for sequence in range(1500):
            link.send(message(sequence))
            began_s = time.monotonic()
            leader.read(0.0)
            assert time.monotonic() - began_s < 1.0
        link.send(message(1500, q=(HOME + 0.02).tolist()))
        read_until(leader, is_at(HOME + 0.02))


def test_a_message_of_more_than_a_datagram_ends_its_connection_only(
    leader: NetworkLeader,
    link: ClientConnection,
) -> None:
    link.send("x" * 70_000)
    with pytest.raises(ConnectionClosed):
        link.recv(5.0)
    with connect(address_of(leader)) as other:
        other.send(message(1))
        read_until(leader, is_at(HOME))


def test_a_port_that_is_taken_is_named(leader: NetworkLeader) -> None:
    with pytest.raises(EnvironmentMissingError, match=f"TCP port {leader.port}"):
        leader_with(port=leader.port)


def test_a_closed_leader_frees_its_port(leader: NetworkLeader) -> None:
    port = unused_port()
    leader_with(port=port).close()
    with socket.create_server(("127.0.0.1", port)) as listener:
        assert listener.getsockname()[1] == port


def test_the_example_program_records_an_episode_in_which_both_arms_move(tmp_path: Path) -> None:
    settings = {"transport": "websocket", "port": unused_port()}
    episode = episode_led_by("lead_over_websocket.py", tmp_path, settings)
    assert_both_arms_moved(episode)
