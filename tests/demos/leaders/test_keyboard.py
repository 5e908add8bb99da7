"""The keyboard leader on a real pseudo-terminal."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from minidual import emergency
from minidual.config.learning import TeleopConfig
from minidual.demos.episode import read_episode
from minidual.demos.leader import LeaderSample
from minidual.demos.leaders.keyboard import STEPS_M, KeyboardLeader
from minidual.demos.quality import rms_jerk
from minidual.demos.station import Button
from minidual.errors import EnvironmentMissingError
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Array

ROOT = Path(__file__).resolve().parents[3]
HOME = DUAL_PANDA.home
CONFIG = TeleopConfig()
STEP_M = STEPS_M[1]


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    keys, screen = pty.openpty()
    yield keys, screen
    emergency.release()
    os.close(keys)
    os.close(screen)


@pytest.fixture
def leader(terminal: tuple[int, int]) -> Iterator[KeyboardLeader]:
    made = KeyboardLeader(DUAL_PANDA, CONFIG, descriptor=terminal[1])
    yield made
    made.close()


def hold(leader: KeyboardLeader, start_s: float, seconds: float) -> list[LeaderSample]:
    """Read at 50 Hz for a while."""
    samples: list[LeaderSample] = []
    for k in range(1, round(50 * seconds) + 1):
        sample = leader.read(start_s + k / 50)
        assert sample is not None
        samples.append(sample)
    return samples


def hands(sample: LeaderSample) -> list[Array]:
    assert sample.q is not None
    return [T.copy() for T in Kinematics().tcp_poses(sample.q)]


def test_the_keyboard_needs_a_terminal(tmp_path: Path) -> None:
    with (
        (tmp_path / "no_terminal").open("w") as file,
        pytest.raises(EnvironmentMissingError, match="terminal"),
    ):
        KeyboardLeader(DUAL_PANDA, CONFIG, descriptor=file.fileno())


def test_keys_jog_the_hands_and_the_terminal_is_given_back(terminal: tuple[int, int]) -> None:
    keys, screen = terminal
    before = termios.tcgetattr(screen)
    leader = KeyboardLeader(DUAL_PANDA, CONFIG, descriptor=screen)
    home = [T.copy() for T in Kinematics().tcp_poses(HOME)]
    os.write(keys, b"wwwf")  # both hands: three steps away, one down
    last = hold(leader, 0.0, 1.0)[-1]
    for T, T_home in zip(hands(last), home, strict=True):
        moved = T[:3, 3] - T_home[:3, 3]
        np.testing.assert_allclose(moved, (3 * STEP_M, 0.0, -STEP_M), atol=1e-5)
    np.testing.assert_array_equal(last.openings, [1.0, 1.0])

    os.write(keys, b"\t.a ")  # the left hand alone, a larger step to the left; close
    last = hold(leader, 1.0, 1.0)[-1]
    left, right = hands(last)
    assert left[1, 3] - home[0][1, 3] == pytest.approx(STEPS_M[2], abs=1e-5)
    assert right[1, 3] - home[1][1, 3] == pytest.approx(0.0, abs=1e-5)
    np.testing.assert_array_equal(last.openings, [0.0, 1.0])
    assert leader.hint == "left hand, steps of 10 mm"

    leader.close()
    assert termios.tcgetattr(screen) == before


@pytest.mark.parametrize(
    ("key", "buttons"),
    [
        (b"\n", {Button.START, Button.SUCCESS}),
        (b"b", {Button.FAILURE}),
        (b"u", {Button.DISCARD}),
        (b"n", {Button.NEXT}),
        (b"p", {Button.PAUSE}),
    ],
)
def test_keys_are_buttons(
    leader: KeyboardLeader,
    terminal: tuple[int, int],
    key: bytes,
    buttons: set[Button],
) -> None:
    os.write(terminal[0], key)
    assert set(hold(leader, 0.0, 0.02)[-1].pressed) == buttons
    assert hold(leader, 0.02, 0.02)[-1].pressed == ()
    assert key.decode().strip() in leader.usage


def test_both_hands_turn_about_the_point_between_them(
    leader: KeyboardLeader,
    terminal: tuple[int, int],
) -> None:
    os.write(terminal[0], b"qqqqq")
    left, right = hands(hold(leader, 0.0, 1.5)[-1])
    left_home, right_home = Kinematics().tcp_poses(HOME)
    middle = (left[:3, 3] + right[:3, 3]) / 2.0
    np.testing.assert_allclose(middle, (left_home[:3, 3] + right_home[:3, 3]) / 2.0, atol=1e-4)
    span = left[:3, 3] - right[:3, 3]
    assert np.arctan2(-span[0], span[1]) == pytest.approx(5 * 6.0 * STEP_M, abs=1e-3)
    # A rod between them keeps its length and turns with them.
    T_left_right = np.linalg.inv(left) @ right
    np.testing.assert_allclose(T_left_right, np.linalg.inv(left_home) @ right_home, atol=1e-3)


def test_one_joint_moves_alone_and_the_hands_go_on_from_there(
    leader: KeyboardLeader,
    terminal: tuple[int, int],
) -> None:
    os.write(terminal[0], b"\t4ww")  # joint 4 of the left arm
    sample = hold(leader, 0.0, 1.0)[-1]
    assert sample.q is not None
    moved = sample.q - HOME
    assert moved[3] == pytest.approx(2 * 6.0 * STEP_M, abs=1e-4)
    assert np.abs(np.delete(moved, 3)).max() == 0.0
    assert leader.hint.startswith("joint 4, left")
    os.write(terminal[0], b"0")
    after = hold(leader, 1.0, 0.5)
    assert after[-1].q is not None
    np.testing.assert_allclose(hands(after[-1])[0], hands(sample)[0], atol=1e-4)


def test_keys_before_the_start_move_nothing_until_time_runs(
    leader: KeyboardLeader,
    terminal: tuple[int, int],
) -> None:
    os.write(terminal[0], b"ww")
    for _ in range(5):
        waiting = leader.read(0.0)
        assert waiting is not None
        np.testing.assert_array_equal(waiting.q, HOME)
    moved = hands(hold(leader, 0.0, 1.0)[-1])[0][:3, 3] - Kinematics().tcp_poses(HOME)[0][:3, 3]
    assert moved[0] == pytest.approx(2 * STEP_M, abs=1e-5)


def test_a_key_held_down_moves_smoothly_at_a_bounded_speed_and_stops_at_the_reach(
    leader: KeyboardLeader,
    terminal: tuple[int, int],
) -> None:
    os.write(terminal[0], b"." + b"w" * 200)  # two metres
    samples = hold(leader, 0.0, 3.0)
    places = np.array([hands(sample)[0][:3, 3] for sample in samples])
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) * 50.0
    assert speeds.max() <= CONFIG.mirror.hand_speed_max_m_s + 1e-6
    assert 0.4 < places[-1][0] < 0.9, "stops where the arm ends"
    assert "out of reach" not in leader.hint, "the goal is where the hand is"


def test_a_careful_typist_is_smooth_enough(
    leader: KeyboardLeader,
    terminal: tuple[int, int],
) -> None:
    """Eight keys a second."""
    rows: list[Array] = []
    for k in range(1, 501):
        if k % 6 == 0:
            os.write(terminal[0], b"wwwwffffaaaasssrrrddd"[k // 6 % 21 :][:1])
        sample = leader.read(k / 50)
        assert sample is not None
        assert sample.q is not None
        rows.append(sample.q)
    assert rms_jerk(np.array(rows), 50.0) < 0.5 * CONFIG.jerk_max_rad_s3


def test_the_table_stops_the_hands(leader: KeyboardLeader, terminal: tuple[int, int]) -> None:
    os.write(terminal[0], b"." + b"f" * 60)
    lowest = hands(hold(leader, 0.0, 3.0)[-1])[0][2, 3]
    assert lowest == pytest.approx(CONFIG.mirror.hand_height_min_m, abs=1e-4)
    os.write(terminal[0], b"r")
    assert hands(hold(leader, 3.0, 1.0)[-1])[0][2, 3] == pytest.approx(lowest + 0.01, abs=1e-3)


@pytest.mark.parametrize("data", [b"x", b"\x1b\x1b\x1b", b"ww\x1b", b"\x1b[200~w\x1b"])
def test_the_emergency_key_is_never_lost(
    leader: KeyboardLeader,
    terminal: tuple[int, int],
    data: bytes,
) -> None:
    os.write(terminal[0], data)
    now_s = 0.0
    while not emergency.pressed() and now_s < 1.0:
        now_s += 0.02
        leader.read(now_s)
        time.sleep(0.02)
    assert emergency.pressed() == "key of the keyboard"


def test_a_terminal_that_is_gone_gives_no_reading(terminal: tuple[int, int]) -> None:
    keys, screen = pty.openpty()
    leader = KeyboardLeader(DUAL_PANDA, CONFIG, descriptor=screen)
    os.close(keys)
    assert leader.read(0.02) is None
    leader.close()
    os.close(screen)


def test_a_person_at_a_terminal_records_an_episode_in_which_both_arms_move(tmp_path: Path) -> None:
    keys, screen = pty.openpty()
    environment = {**os.environ, "PYTHONPATH": f"{ROOT / 'src'}{os.pathsep}{ROOT}"}
    command = [sys.executable, "-m", "tests.support.lead_once", "keyboard", str(tmp_path)]
    with subprocess.Popen(
        command,
        cwd=ROOT,
        env=environment,
        stdin=screen,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        said: list[str] = []
        for line in process.stdout:
            said.append(line.strip())
            if line.startswith("press start"):
                os.write(keys, b"..fff\n")
            elif line.startswith("leading; both hands, steps of 10 mm"):
                time.sleep(2.5)
                os.write(keys, b"\x1b[A\x1b[200~www\x1b[201~\n")
    os.close(keys)
    os.close(screen)
    assert process.returncode == 0, said
    assert said[-1].startswith("attempt: "), said
    assert "the leader" not in said[-1]
    [path] = tmp_path.glob("rejected/*.hdf5")
    episode = read_episode(path, cameras=())
    kinematics = Kinematics()
    first = [T.copy() for T in kinematics.tcp_poses(episode.qpos[0])]
    last = kinematics.tcp_poses(episode.qpos[-1])
    for hand in range(2):
        moved = last[hand][:3, 3] - first[hand][:3, 3]
        np.testing.assert_allclose(moved, (0.0, 0.0, -0.03), atol=0.004)
