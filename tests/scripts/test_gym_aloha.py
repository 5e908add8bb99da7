"""The parts of the gym-aloha proof that need no gym-aloha: the hands' ways, and the client."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from websockets.sync.client import connect

from scripts.gym_aloha.client import BLEND_STEPS, STEPS_OF_CHUNK, Policy
from scripts.gym_aloha.way import Hand, Waypoint, pointing, waypoint_at, ways
from tests.support.policy_server import served

CUBE_M = np.array([0.1, 0.45, 0.02])
LEFT = Hand(np.array([-0.47, 0.5, 0.0]), np.array([-0.17, 0.5, 0.31]), -0.1)
RIGHT = Hand(np.array([0.47, 0.5, 0.0]), np.array([0.17, 0.5, 0.31]), -0.1)
PICTURE = np.zeros((120, 160, 3), np.uint8)
CHUNK = 40
HELLO = {
    "protocol": 1,
    "cameras": {"top": [120, 160]},
    "dim": 14,
    "chunk_size": CHUNK,
}


@pytest.mark.parametrize(("pitch", "roll"), [(0.0, 0.0), (1.0, 0.0), (0.0, 1.5), (-0.1, -2.0)])
def test_a_hand_points_away_from_its_base(pitch: float, roll: float) -> None:
    tip_m = np.array([0.1, 0.45, 0.2])
    R = pointing(RIGHT.base_m, Waypoint(0.0, tip_m, pitch, roll, 1.0))
    assert pytest.approx(np.eye(3)) == R.T @ R
    assert np.linalg.det(R) == pytest.approx(1.0)
    ahead = R[:, 0]
    away_m = (tip_m - RIGHT.base_m)[:2]
    assert ahead[:2] / np.linalg.norm(ahead[:2]) == pytest.approx(away_m / np.linalg.norm(away_m))
    assert np.arcsin(-ahead[2]) == pytest.approx(pitch)
    assert R[2, 1] == pytest.approx(np.sin(roll) * np.cos(pitch)), "roll 0 opens horizontally"


def test_a_hand_is_at_each_waypoint_at_its_time_and_stays_at_the_last() -> None:
    way = [
        Waypoint(0.0, np.zeros(3), 0.0, 0.0, 1.0),
        Waypoint(2.0, np.array([0.1, 0.0, 0.0]), 0.4, -1.0, 1.0),
        Waypoint(3.0, np.array([0.1, 0.0, 0.2]), 0.4, -1.0, 0.0),
    ]
    for point in way:
        there = waypoint_at(way, point.at_s)
        assert there.tip_m == pytest.approx(point.tip_m)
        assert (there.pitch, there.roll, there.opening) == point[2:]
    middle = waypoint_at(way, 1.0)
    assert middle.tip_m == pytest.approx([0.05, 0.0, 0.0])
    assert (middle.pitch, middle.roll) == pytest.approx((0.2, -0.5))
    assert waypoint_at(way, 9.0).tip_m == pytest.approx([0.1, 0.0, 0.2])
    early_m = waypoint_at(way, 0.01).tip_m[0]
    assert early_m < 0.1 * 0.01 / 2.0, "a hand starts slowly"


def test_the_left_hand_closes_after_the_right_one_has_brought_the_cube() -> None:
    left, right = ways(CUBE_M, LEFT, RIGHT)
    for way, hand in ((left, LEFT), (right, RIGHT)):
        assert way[0].tip_m == pytest.approx(hand.tip_m)
        assert way[0].pitch == hand.pitch
        times_s = [point.at_s for point in way]
        assert times_s == sorted(times_s)
    grasp = next(point for point in right if point.opening == 0.0)
    assert np.linalg.norm(grasp.tip_m - CUBE_M) <= 0.011
    brought = next(point for point in right if point.tip_m[2] > 0.2 and point.opening == 0.0)
    takes = next(point for point in left if point.opening == 0.0)
    assert takes.at_s > brought.at_s
    assert np.linalg.norm(takes.tip_m - brought.tip_m) <= 0.011
    left_opens = pointing(LEFT.base_m, takes)[:, 1]
    right_opens = pointing(RIGHT.base_m, brought)[:, 1]
    across = abs(float(left_opens @ right_opens))
    assert across == pytest.approx(0.0, abs=1e-9), "the hands pinch other faces"


class Counting:
    """A server whose k-th answer commands k everywhere."""

    def __init__(self) -> None:
        self.answers_n = 0

    def __call__(self, message: dict[str, Any]) -> dict[str, Any]:
        self.answers_n += 1
        return {"actions": np.full((CHUNK, 14), float(self.answers_n))}


def test_a_chunk_is_asked_for_when_the_last_one_is_used_up_and_blends_in() -> None:
    with (
        served(Counting(), hello=HELLO) as (address, messages),
        connect(address, max_size=None) as connection,
    ):
        client = Policy(connection, (120, 160))
        actions = [client.act(np.zeros(14), PICTURE)[0] for _ in range(2 * STEPS_OF_CHUNK)]
        client.reset()
        first = client.act(np.ones(14), PICTURE)
    assert [message["reset"] for message in messages] == [True, False, True]
    assert messages[2]["state"] == pytest.approx(np.ones(14))
    assert messages[0]["images"]["top"].shape == PICTURE.shape
    assert actions[:STEPS_OF_CHUNK] == [1.0] * STEPS_OF_CHUNK
    blended = actions[STEPS_OF_CHUNK:][:BLEND_STEPS]
    assert blended == pytest.approx(1.0 + (np.arange(BLEND_STEPS) + 1.0) / (BLEND_STEPS + 1.0))
    assert actions[STEPS_OF_CHUNK + BLEND_STEPS :] == [2.0] * (STEPS_OF_CHUNK - BLEND_STEPS)
    assert first == pytest.approx(np.full(14, 3.0)), "a new episode blends in nothing"


def test_what_the_server_refuses_ends_the_trials() -> None:
    with (
        served(lambda message: {"error": "no such task"}, hello=HELLO) as (address, _),
        connect(address, max_size=None) as connection,
        pytest.raises(SystemExit, match="no such task"),
    ):
        Policy(connection, (120, 160)).act(np.zeros(14), PICTURE)


def test_wrong_pictures_are_refused() -> None:
    hello = {**HELLO, "cameras": {"top": [96, 128]}}
    with (
        served(hello=hello) as (address, _),
        connect(address) as connection,
        pytest.raises(SystemExit, match="here is one picture of"),
    ):
        Policy(connection, (120, 160))
