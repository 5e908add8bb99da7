"""The arms move only when leader and follower agree, or a clutch was used; whole turns agree."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from minidual.config.leading import MirrorConfig
from minidual.demos.alignment import AlignmentGate
from minidual.robot.models import ARM_MODELS
from minidual.robot.pair import DUAL_PANDA, Array, Robot

HOME = DUAL_PANDA.home
TURN = 2.0 * np.pi
XARMS = Robot(ARM_MODELS["xarm7"])
"""Their joints have room for more than a turn."""


@pytest.fixture
def gate() -> AlignmentGate:
    made = AlignmentGate(DUAL_PANDA, MirrorConfig())
    made.begin(HOME)
    return made


def with_joint(joint: int, change_rad: float, q: Array = HOME) -> Array:
    changed = q.copy()
    changed[joint] += change_rad
    return changed


def test_it_opens_when_each_joint_agrees_and_names_the_one_that_does_not(
    gate: AlignmentGate,
) -> None:
    target = gate.admit(with_joint(10, 0.25))
    np.testing.assert_array_equal(target, HOME)
    assert not gate.is_open
    assert gate.held == (
        "right_panda_joint4 is +0.25 rad from the arms (1 of 14 joints are further than 0.1 rad)"
    )
    gate.admit(with_joint(10, 0.09))
    assert gate.is_open
    assert gate.held == ""
    np.testing.assert_array_equal(gate.admit(with_joint(10, 0.2)), with_joint(10, 0.2))


@settings(max_examples=50)
@given(st.lists(st.integers(-3, 3), min_size=14, max_size=14))
def test_encoders_that_count_from_another_turn_agree(turns: list[int]) -> None:
    gate = AlignmentGate(DUAL_PANDA, MirrorConfig())
    gate.begin(HOME)
    np.testing.assert_allclose(gate.admit(HOME + TURN * np.array(turns)), HOME, atol=1e-9)
    assert gate.is_open


def test_a_reading_that_wraps_in_motion_goes_on(gate: AlignmentGate) -> None:
    """Each joint in turn passes where its encoder wraps."""
    for k in range(40):
        q = HOME + 0.02 * k
        reading = q.copy()
        wrapped = np.arange(14) < k // 3
        reading[wrapped] -= TURN
        target = gate.admit(reading)
        np.testing.assert_allclose(
            target,
            np.clip(q, DUAL_PANDA.q_lower, DUAL_PANDA.q_upper),
            atol=1e-9,
        )
        assert gate.is_open


def test_a_joint_with_room_for_a_turn_does_not_follow_a_whole_turn() -> None:
    gate = AlignmentGate(XARMS, MirrorConfig())
    gate.begin(XARMS.home)
    gate.admit(XARMS.home)
    moved = gate.admit(with_joint(0, TURN, XARMS.home))
    np.testing.assert_allclose(moved, XARMS.home, atol=1e-9)
    assert gate.is_open


def test_a_jump_is_not_followed_and_is_named_until_leader_and_arms_agree(
    gate: AlignmentGate,
) -> None:
    gate.admit(HOME)
    for _ in range(3):
        target = gate.admit(with_joint(6, 2.9 - HOME[6]))
        np.testing.assert_array_equal(target, HOME)
        assert gate.held.startswith("the reading of left_panda_joint7 jumped by +")
    assert gate.admit(with_joint(6, 0.05))[6] == pytest.approx(HOME[6] + 0.05)
    assert gate.held == ""


def test_a_clutch_lets_the_arms_follow_from_where_they_are(gate: AlignmentGate) -> None:
    away = with_joint(3, -0.7)
    np.testing.assert_array_equal(gate.admit(away, clutch=True), HOME)
    assert gate.held == "the clutch is held"
    np.testing.assert_allclose(gate.admit(away), HOME, atol=1e-12)
    assert gate.is_open
    np.testing.assert_allclose(gate.admit(with_joint(3, -0.6)), with_joint(3, 0.1), atol=1e-12)


def test_a_check_closes_without_moving_the_target(gate: AlignmentGate) -> None:
    gate.check(HOME)
    assert gate.is_open
    gate.check(with_joint(0, 0.3))
    assert not gate.is_open
    np.testing.assert_array_equal(gate.target, HOME)


def test_targets_stay_inside_the_limits(gate: AlignmentGate) -> None:
    gate.admit(HOME)
    q = HOME.copy()
    for _ in range(30):
        q[5] += 0.1
        target = gate.admit(q)
    assert target[5] == DUAL_PANDA.q_upper[5]
