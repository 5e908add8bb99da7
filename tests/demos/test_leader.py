"""Leaders and the mirror: alignment at the start, offsets, the keyboard on a real pseudo-terminal."""

from __future__ import annotations

import os
import pty
import termios
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from minidual.config.learning import MirrorConfig, TeleopConfig
from minidual.config.scene import SceneConfig
from minidual.demos.keyboard import KeyboardLeader
from minidual.demos.leader import LEADERS, LeaderSetup
from minidual.demos.session import check_start, follower_target
from minidual.errors import EnvironmentMissingError, UsageError
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA
from tests.support.carry_trials import carry_task, sample_trial

HOME = DUAL_PANDA.home


def test_a_leader_that_stands_elsewhere_is_refused_and_the_joint_named() -> None:
    leader = HOME.copy()
    leader[10] += 0.25
    with pytest.raises(
        UsageError,
        match=r"\+0\.250 rad away from the follower at right_panda_joint4",
    ) as error:
        check_start(DUAL_PANDA, MirrorConfig(), leader, HOME)
    assert "joint order" in (error.value.remedy or "")
    leader[10] = HOME[10] + 0.09
    check_start(DUAL_PANDA, MirrorConfig(), leader, HOME)


def test_targets_stay_inside_the_limits_and_what_is_no_posture_is_left_for_the_arbiter() -> None:
    leader = HOME.copy()
    leader[5] = DUAL_PANDA.q_upper[5] + 0.2
    assert follower_target(DUAL_PANDA, leader)[5] == DUAL_PANDA.q_upper[5]
    for odd in (np.nan, np.inf, -np.inf, np.degrees(HOME[5]), HOME[5] + 2.0 * np.pi):
        leader[5] = odd  # before, all but NaN drove the joint to its limit at 1 rad/s
        np.testing.assert_equal(follower_target(DUAL_PANDA, leader)[5], odd)
    np.testing.assert_array_equal(follower_target(DUAL_PANDA, np.zeros(14)), np.zeros(14))
    with pytest.raises(UsageError, match=r"shape \(7,\)"):
        follower_target(DUAL_PANDA, HOME[:7])


def test_leaders_are_found_by_name(scene: SceneConfig) -> None:
    setup = LeaderSetup(DUAL_PANDA, carry_task(scene), TeleopConfig(), 1)
    trial = sample_trial(scene, 1, "demonstrations", 0)
    leader = LEADERS["scripted"].for_trial(setup, trial)
    reading = leader.read(0.0)
    assert reading is not None
    np.testing.assert_allclose(reading[0], HOME, atol=1e-6)
    assert not leader.finished(5.0)
    assert leader.finished(8.7)
    with pytest.raises(
        UsageError,
        match=r"(?s)no leader 'keybord'; there are keyboard, scripted.*'keyboard'",
    ):
        LEADERS["keybord"]
    assert sorted(LEADERS) == ["keyboard", "scripted"]


def test_the_keyboard_needs_a_terminal(tmp_path: Path) -> None:
    with (
        (tmp_path / "no_terminal").open("w") as file,
        pytest.raises(EnvironmentMissingError, match="terminal"),
    ):
        KeyboardLeader(Kinematics(), descriptor=file.fileno())


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    keys, screen = pty.openpty()
    yield keys, screen
    os.close(keys)
    os.close(screen)


def _hold(leader: KeyboardLeader, start_s: float, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Read at 50 Hz for a while; return the last joints and openings."""
    for k in range(1, round(50 * seconds) + 1):
        reading = leader.read(start_s + k / 50)
        assert reading is not None
    return reading


def test_keys_jog_the_hands_and_the_terminal_is_given_back(terminal: tuple[int, int]) -> None:
    keys, screen = terminal
    before = termios.tcgetattr(screen)
    kinematics = Kinematics()
    leader = KeyboardLeader(kinematics, descriptor=screen)
    home = [T.copy() for T in kinematics.tcp_poses(HOME)]
    os.write(keys, b"wwwf")  # both hands: 3 cm away, 1 cm down
    q, gripper = _hold(leader, 0.0, 0.5)
    for T, T_home in zip(kinematics.tcp_poses(q), home, strict=True):
        np.testing.assert_allclose(T[:3, 3] - T_home[:3, 3], (0.03, 0.0, -0.01), atol=1e-5)
    np.testing.assert_array_equal(gripper, [1.0, 1.0])

    os.write(keys, b"\ta ")  # the left hand alone: 1 cm to the left, and close
    q, gripper = _hold(leader, 0.5, 0.5)
    left, right = kinematics.tcp_poses(q)
    assert left[1, 3] - home[0][1, 3] == pytest.approx(0.01, abs=1e-5)
    assert right[1, 3] - home[1][1, 3] == pytest.approx(0.0, abs=1e-5)
    np.testing.assert_array_equal(gripper, [0.0, 1.0])

    assert not leader.finished(1.0)
    os.write(keys, b"\n")
    leader.read(1.02)
    assert leader.finished(1.02)
    leader.close()
    assert termios.tcgetattr(screen) == before


def test_a_key_held_down_moves_at_a_bounded_speed_and_stops_at_the_reach(
    terminal: tuple[int, int],
) -> None:
    keys, screen = terminal
    leader = KeyboardLeader(Kinematics(), descriptor=screen)
    os.write(keys, b"w" * 200)  # two metres
    kinematics = Kinematics()
    last = None
    for k in range(1, 150):
        reading = leader.read(k / 50)
        assert reading is not None
        place = kinematics.tcp_poses(reading[0])[0][:3, 3]
        if last is not None:
            assert np.linalg.norm(place - last) <= 0.25 / 50 + 1e-6
        last = place.copy()
    assert last is not None
    assert 0.4 < last[0] < 0.9, "stops where the arm ends"
    leader.close()
