"""A program leads over real sockets; old, duplicated and reordered messages are dropped and counted."""

from __future__ import annotations

import json
import random
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.config.leading import NetworkConfig
from minidual.config.scene import SceneConfig
from minidual.demos.leader import Feedback, LeaderSample
from minidual.demos.leaders.network import NetworkLeader
from minidual.demos.station import Button
from minidual.errors import EnvironmentMissingError
from minidual.robot.pair import DUAL_PANDA
from tests.support.carry_trials import sample_trial
from tests.support.leading_program import assert_both_arms_moved, episode_led_by

HOME = DUAL_PANDA.home
EXAMPLE = "lead_over_udp.py"


@pytest.fixture
def leader() -> Iterator[NetworkLeader]:
    made = NetworkLeader(DUAL_PANDA, NetworkConfig(port=0, silence_max_s=1.5))
    yield made
    made.close()


@pytest.fixture
def link(leader: NetworkLeader) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.connect(("127.0.0.1", leader.port))
        made.settimeout(2.0)
        yield made


def message(sequence: int, **fields: Any) -> dict[str, Any]:
    base = {"version": 1, "sender": "me", "sequence": sequence, "stamp_s": time.monotonic()}
    return {**base, "q": HOME.tolist(), **fields}


def send(link: socket.socket, *messages: dict[str, Any]) -> None:
    for one in messages:
        link.send(json.dumps(one).encode())
    time.sleep(0.01)


def q_of(sample: LeaderSample | None) -> np.ndarray:
    assert sample is not None
    assert sample.q is not None
    return sample.q


def test_the_newest_target_leads_with_its_grippers_and_buttons(
    leader: NetworkLeader,
    link: socket.socket,
) -> None:
    assert leader.read(0.0) is None
    moved = (HOME + 0.01).tolist()
    send(link, message(1), message(2, q=moved, openings=[0.25, 1.0], pressed=["start"]))
    sample = leader.read(0.02)
    np.testing.assert_allclose(q_of(sample), moved)
    assert sample is not None
    np.testing.assert_array_equal(sample.openings, [0.25, 1.0])
    assert sample.pressed == (Button.START,)
    assert 0.0 <= (sample.age_s or 0.0) < 1.5
    again = leader.read(0.04)
    assert again is not None
    assert again.pressed == (), "a button is pressed once"


def test_hand_poses_lead_too(leader: NetworkLeader, link: socket.socket) -> None:
    hand = {"position_m": [0.4, 0.2, 0.3], "quaternion_wxyz": [0.0, 1.0, 0.0, 0.0]}
    send(link, message(1, q=None, hands=[hand, hand]))
    sample = leader.read(0.0)
    assert sample is not None
    assert sample.Ts_world_tcp is not None
    left = sample.Ts_world_tcp[0]
    np.testing.assert_allclose(left[:3, 3], (0.4, 0.2, 0.3))
    np.testing.assert_allclose(left[:3, :3], np.diag([1.0, -1.0, -1.0]), atol=1e-12)


def test_joints_in_another_order_are_sorted_by_name(
    leader: NetworkLeader,
    link: socket.socket,
) -> None:
    names = list(reversed(DUAL_PANDA.joint_names))
    send(link, message(1, q=HOME[::-1].tolist(), names=names))
    np.testing.assert_array_equal(q_of(leader.read(0.0)), HOME)


def test_late_and_duplicated_messages_are_dropped_and_counted(
    leader: NetworkLeader,
    link: socket.socket,
) -> None:
    messages = [message(k, q=(HOME + 1e-3 * k).tolist()) for k in range(30)]
    order = [*range(30), 3, 7, 7]
    random.Random(1).shuffle(order)
    newest = -1
    late = duplicated = 0
    for place, k in enumerate(order):
        if k in order[:place]:
            duplicated += 1
        elif k < newest:
            late += 1
        newest = max(newest, k)
        send(link, messages[k])
        np.testing.assert_allclose(q_of(leader.read(0.0)), HOME + 1e-3 * newest)
    assert leader.counts == {"late": late, "duplicated": duplicated}
    assert "duplicated" in leader.hint


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xff\xfe",
        b"{}",
        b"[1, 2]",
        json.dumps({"version": 2, "sequence": 1, "stamp_s": 0.0}).encode(),
        json.dumps({"version": 1, "sequence": 1, "stamp_s": 0.0, "q": [0.1] * 13}).encode(),
        b'{"version": 1, "sequence": 1, "stamp_s": 0.0, "q": [NaN]}',
        json.dumps({"version": 1, "sequence": -1, "stamp_s": 0.0}).encode(),
        json.dumps({"version": 1, "sequence": 1, "stamp_s": 0.0, "speed": 3}).encode(),
    ],
)
def test_a_malformed_message_is_counted_and_moves_nothing(
    leader: NetworkLeader,
    link: socket.socket,
    data: bytes,
) -> None:
    link.send(data)
    time.sleep(0.01)
    assert leader.read(0.0) is None
    assert leader.counts == {"malformed": 1}


def test_silence_is_no_reading_and_a_restarted_program_takes_over_after_it(
    leader: NetworkLeader,
    link: socket.socket,
) -> None:
    send(link, message(100))
    assert leader.read(0.0) is not None
    send(link, message(0, sender="intruder", q=(HOME + 0.1).tolist()))
    np.testing.assert_array_equal(q_of(leader.read(0.0)), HOME)
    assert leader.counts == {"from another sender": 1}
    time.sleep(1.6)
    assert leader.read(0.0) is None
    send(link, message(0, sender="restarted", q=(HOME + 0.1).tolist()))
    np.testing.assert_allclose(q_of(leader.read(0.0)), HOME + 0.1)


def test_the_answer_tells_where_the_arms_are_and_what_they_meet(
    leader: NetworkLeader,
    link: socket.socket,
    scene: SceneConfig,
) -> None:
    trial = sample_trial(scene, 1, "demonstrations", 0)
    leader.align(trial, HOME + 0.05)
    send(link, message(1, q=None))
    assert leader.read(0.0) is None, "a message without a target only asks"
    state = json.loads(link.recv(65535))
    np.testing.assert_allclose(state["q"], HOME + 0.05)
    assert state["names"] == list(DUAL_PANDA.joint_names)
    leader.feedback(Feedback(1.5, HOME, np.zeros(2), np.full(14, 2.0)))
    send(link, message(2))
    leader.read(0.0)
    state = json.loads(link.recv(65535))
    assert (state["sequence"], state["stamp_s"], state["external_nm"][3]) == (2, 1.5, 2.0)


def test_a_port_that_is_taken_is_named(leader: NetworkLeader) -> None:
    with pytest.raises(EnvironmentMissingError, match=f"UDP port {leader.port}"):
        NetworkLeader(DUAL_PANDA, NetworkConfig(port=leader.port))


def test_the_example_program_records_an_episode_in_which_both_arms_move(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    episode = episode_led_by(EXAMPLE, tmp_path, {"port": port})
    assert_both_arms_moved(episode)
