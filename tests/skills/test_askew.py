"""What the gap of the fingers tells of a part that stands askew, and which signs are tried in turn."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.control.hand_impedance import HandImpedance, InHand
from minidual.robot.pair import pose, rot_z
from minidual.skills.askew import AskewSearch, Meeting, askew_rad, part_in_hand

SOCKET_M = 0.0443
PEG_M = 0.022


@pytest.mark.parametrize(
    ("gap_mm", "width_m", "angle_deg"),
    [
        (44.68, SOCKET_M, 0.0),
        (45.12, SOCKET_M, 1.65),
        (45.71, SOCKET_M, 3.48),
        (22.73, PEG_M, 1.62),
    ],
)
def test_the_gap_tells_how_askew_a_part_stands(gap_mm, width_m, angle_deg):
    """Gaps as measured in simulation (docs/insertion.md)."""
    assert np.degrees(askew_rad(1e-3 * gap_mm, width_m)) == pytest.approx(angle_deg, abs=0.6)


def test_an_empty_reading_is_no_large_angle():
    assert askew_rad(0.08, PEG_M) == pytest.approx(np.radians(6.0))
    assert askew_rad(0.0, PEG_M) == 0.0


def test_the_camera_gives_the_first_sign():
    held = InHand("peg", pose(np.eye(3), (0.06, 0.0, 0.0)))
    left = part_in_hand(held, 0.0229, PEG_M, [0.01, 0.02])
    right = part_in_hand(held, 0.0229, PEG_M, [-0.01, -0.02])
    assert left.angle == pytest.approx(-right.angle)
    assert left.angle > 0.0
    turned = left.turned(1.0).T_tcp_object
    assert turned == pytest.approx(pose(rot_z(left.angle), (0.0, 0.0, 0.0)) @ held.T_tcp_object)


class Stuck:
    """A law whose object never follows; it notes what it is told that the hands hold."""

    def __init__(self, lag_m: float = 0.02) -> None:
        self.lag_m = lag_m
        self.shift_m = (0.0, 0.0, 0.0)
        self.told: list[tuple[float, float]] = []

    def correct(self, held: InHand, other: InHand) -> None:
        yaws = [np.arctan2(T[1, 0], T[0, 0]) for T in (held.T_tcp_object, other.T_tcp_object)]
        self.told.append((float(yaws[0]), float(yaws[1])))

    def lag(self, q, q_ref) -> np.ndarray:
        return np.array([0.0, self.lag_m, 0.0])


def tried(law: Stuck, peg_mm: float, socket_mm: float) -> tuple[AskewSearch, list[tuple[int, int]]]:
    """Return a search after 10 s, and the signs that it has held for the peg and the socket."""
    peg = part_in_hand(InHand("peg"), 1e-3 * peg_mm, PEG_M, [])
    socket = part_in_hand(InHand("socket"), 1e-3 * socket_mm, SOCKET_M, [])
    search = AskewSearch(Meeting(law, peg, socket, 1, 0.0))
    signs: list[tuple[int, int]] = []
    for now_s in np.arange(0.0, 10.0, 0.02):
        search.update(np.zeros(14), np.zeros(14), now_s)
        if law.shift_m[1] == 0.0:
            sign = (int(np.sign(law.told[-1][0])), int(np.sign(law.told[-1][1])))
            if any(sign) and (not signs or signs[-1] != sign):
                signs.append(sign)
    return search, signs


def test_signs_of_the_part_that_is_more_askew_are_tried_first():
    _, signs = tried(Stuck(), 22.9, 46.0)
    assert signs == [(1, 1), (1, -1), (-1, 1), (-1, -1)]
    _, signs = tried(Stuck(), 23.6, 45.2)
    assert signs == [(1, 1), (-1, 1), (1, -1), (-1, -1)]


def test_aligned_parts_are_left_alone():
    search, signs = tried(Stuck(), 22.3, 44.68)
    assert signs == []
    assert set(search._law.told) == {(0.0, 0.0)}
    assert search.tries_left == 0


def test_one_part_that_is_askew_has_two_signs():
    search, signs = tried(Stuck(), 22.3, 45.9)
    assert signs == [(0, 1), (0, -1)]
    assert search.tries_left == 0


def test_a_part_that_follows_keeps_the_first_signs_and_is_not_drawn_back():
    law = Stuck(lag_m=0.004)
    search, signs = tried(law, 22.9, 46.0)
    assert signs == [(1, 1)]
    assert search.tries_n == 1
    assert not search.busy(0.0)


def test_a_part_that_is_stuck_is_drawn_back_before_it_is_turned():
    law = Stuck()
    part = part_in_hand(InHand("peg"), 0.0236, PEG_M, [])
    socket = part_in_hand(InHand("socket"), 0.0, SOCKET_M, [])
    search = AskewSearch(Meeting(law, part, socket, 1, 0.0))
    for now_s in (0.0, 0.6, 1.62, 1.7):
        search.update(np.zeros(14), np.zeros(14), now_s)
    assert law.shift_m[1] < -law.lag_m
    assert search.busy(1.7)


def test_the_law_takes_another_estimate_without_forgetting_what_it_learnt(kinematics):
    law = HandImpedance(kinematics, 1, 0.001)
    q = kinematics.robot.home
    law.engage(q)
    law._learnt[:] = 1.0
    shifted = InHand("peg", pose(np.eye(3), (0.0, 0.01, 0.0)), pose(np.eye(3), (0.0, 0.0, 0.0)))
    law.correct(shifted, None)
    assert law.lag(q, q) == pytest.approx([0.0, -0.01, 0.0], abs=1e-9)
    assert law._learnt == pytest.approx(1.0)
    law.shift_m = (0.0, -0.02, 0.0)
    assert law.lag(q, q) == pytest.approx([0.0, -0.01, 0.0], abs=1e-9)
