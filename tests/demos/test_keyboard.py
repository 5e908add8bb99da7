"""The keyboard leader on a real pseudo-terminal."""

from __future__ import annotations

import os
import pty
import termios
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from minidual.demos.keyboard import KeyboardLeader
from minidual.errors import EnvironmentMissingError
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA

HOME = DUAL_PANDA.home


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


def test_the_keyboard_needs_a_terminal(tmp_path: Path) -> None:
    with (
        (tmp_path / "no_terminal").open("w") as file,
        pytest.raises(EnvironmentMissingError, match="terminal"),
    ):
        KeyboardLeader(Kinematics(), descriptor=file.fileno())


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
