"""A gamepad leads by recorded events; the mapping is a table that people edit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from minidual import emergency
from minidual.config.leading import GamepadConfig
from minidual.config.learning import TeleopConfig
from minidual.demos.leader import LeaderSample
from minidual.demos.leaders import gamepad
from minidual.demos.leaders.gamepad import DEFAULT_MAPPING, GamepadLeader
from minidual.demos.leaders.gamepad_device import Event, GamepadDevice, Range
from minidual.demos.leaders.gamepad_mapping import read_mapping
from minidual.demos.mirror import Mirror
from minidual.demos.station import Button
from minidual.errors import ConfigError
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Array
from tests.support.led_episode import Clock, hands_moved, lead_episode

HOME = DUAL_PANDA.home
CONFIG = GamepadConfig()
STICK = Range(-32768.0, 32767.0)
TRIGGER = Range(0.0, 255.0)


class RecordedEvents(GamepadDevice):
    """Gives events that a pad sent: a list for each reading."""

    def __init__(self, readings: Sequence[Sequence[Event]]) -> None:
        sticks = ("ABS_X", "ABS_Y", "ABS_RX", "ABS_RY")
        self.ranges = {**dict.fromkeys(sticks, STICK), "ABS_Z": TRIGGER, "ABS_RZ": TRIGGER}
        self._readings = list(readings)
        self.unplugged = False

    def read(self) -> Sequence[Event] | None:
        if self.unplugged:
            return None
        return self._readings.pop(0) if self._readings else []


@pytest.fixture(autouse=True)
def _released() -> Iterator[None]:
    yield
    emergency.release()


def leader_of(*readings: Sequence[Event], mapping: Path = DEFAULT_MAPPING) -> GamepadLeader:
    return GamepadLeader(DUAL_PANDA, CONFIG, read_mapping(mapping), RecordedEvents(readings))


def read(leader: GamepadLeader, seconds: float, start_s: float = 0.0) -> list[LeaderSample]:
    samples: list[LeaderSample] = []
    for k in range(1, round(50 * seconds) + 1):
        sample = leader.read(start_s + k / 50)
        assert sample is not None
        samples.append(sample)
    return samples


def moved(sample: LeaderSample) -> list[Array]:
    assert sample.Ts_world_tcp is not None
    home = Kinematics().tcp_poses(HOME)
    return [T[:3, 3] - T0[:3, 3] for T, T0 in zip(sample.Ts_world_tcp, home, strict=True)]


def test_a_stick_moves_its_hand_and_a_trigger_closes_it() -> None:
    leader = leader_of([Event("ABS_Y", -32768), Event("ABS_RZ", 255)])
    sample = read(leader, 0.2)[-1]
    left, right = moved(sample)
    np.testing.assert_allclose(left, (0.2 * CONFIG.speed_m_s, 0.0, 0.0), atol=1e-6)
    np.testing.assert_array_equal(right, 0.0)
    np.testing.assert_array_equal(sample.openings, [1.0, 0.0])


def test_with_the_shoulder_button_the_stick_lifts_and_turns() -> None:
    leader = leader_of([Event("BTN_TR", 1), Event("ABS_RY", -32768), Event("ABS_RX", -32768)])
    sample = read(leader, 0.2)[-1]
    _, right = moved(sample)
    np.testing.assert_allclose(right, (0.0, 0.0, 0.2 * CONFIG.speed_m_s), atol=1e-6)
    assert sample.Ts_world_tcp is not None
    R = sample.Ts_world_tcp[1][:3, :3] @ Kinematics().tcp_poses(HOME)[1][:3, :3].T
    assert np.arctan2(R[1, 0], R[0, 0]) == pytest.approx(0.2 * CONFIG.turn_rad_s, abs=1e-6)
    assert leader.hint == "right hand: up, down, turn"


def test_a_stick_near_its_middle_moves_nothing() -> None:
    leader = leader_of([Event("ABS_X", 3000), Event("ABS_Y", -3000)])
    np.testing.assert_array_equal(moved(read(leader, 0.5)[-1]), 0.0)


def test_a_goal_stays_near_a_hand_that_does_not_follow() -> None:
    leader = leader_of([Event("ABS_Y", -32768)])
    left, _ = moved(read(leader, 3.0)[-1])
    assert np.linalg.norm(left) == pytest.approx(0.06, abs=1e-6)


def test_a_button_is_pressed_once_while_it_is_held() -> None:
    leader = leader_of([Event("BTN_START", 1)], [Event("BTN_START", 2)], [Event("BTN_START", 0)])
    pressed = [set(sample.pressed) for sample in read(leader, 0.1)]
    assert pressed[0] == {Button.START, Button.SUCCESS}
    assert not any(pressed[1:])


def test_the_mode_button_is_the_emergency_stop() -> None:
    read(leader_of([Event("BTN_MODE", 1)]), 0.02)
    assert emergency.pressed() == "button of the gamepad"


def test_an_unplugged_gamepad_gives_no_reading() -> None:
    device = RecordedEvents([])
    leader = GamepadLeader(DUAL_PANDA, CONFIG, read_mapping(DEFAULT_MAPPING), device)
    read(leader, 0.1)
    device.unplugged = True
    assert leader.read(0.2) is None


def test_the_arms_follow_a_gamepad() -> None:
    leader = leader_of([Event("ABS_Y", -32768), Event("ABS_RY", 32767)])
    mirror = Mirror(leader, DUAL_PANDA, TeleopConfig())
    mirror.begin(HOME)
    mirror.poll(0.0)
    for k in range(1, 26):
        reading = mirror.read(k / 50)
    assert reading is not None
    left, right = Kinematics().tcp_poses(reading.target)
    home = Kinematics().tcp_poses(HOME)
    assert left[0, 3] > home[0][0, 3] + 0.03
    assert right[0, 3] < home[1][0, 3] - 0.03


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("axes: {}", "axes"),
        ("axes: {ABS_X: {hand: third, moves: x}}", "axes.ABS_X.hand"),
        ("axes: {ABS_X: {hand: left, moves: x}}\nbuttons: {BTN_A: jump}", "no action 'jump'"),
        ("axes: [", "cannot be read"),
    ],
)
def test_a_wrong_mapping_is_refused_with_its_place(
    tmp_path: Path,
    text: str,
    error: str,
) -> None:
    path = tmp_path / "pad.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=error):
        read_mapping(path)


def test_an_edited_mapping_counts(tmp_path: Path) -> None:
    path = tmp_path / "pad.yaml"
    path.write_text("axes: {ABS_X: {hand: right, moves: z, sign: 1}}\nbuttons: {BTN_A: failure}")
    leader = leader_of([Event("ABS_X", 32767), Event("BTN_A", 1)], mapping=path)
    samples = read(leader, 0.1)
    assert samples[0].pressed == (Button.FAILURE,)
    np.testing.assert_allclose(moved(samples[-1])[1], (0.0, 0.0, 0.1 * CONFIG.speed_m_s), atol=1e-4)


class HandsOnPad(RecordedEvents):
    """Start is pressed, both sticks are pushed for a while, the triggers close, start ends."""

    SCRIPT = (
        (0.3, Event("ABS_Y", -32768)),
        (0.3, Event("ABS_RY", -32768)),
        (0.9, Event("ABS_Y", 0)),
        (0.9, Event("ABS_RY", 0)),
        (1.0, Event("ABS_Z", 255)),
        (1.0, Event("ABS_RZ", 255)),
        (2.2, Event("BTN_START", 1)),
    )

    def __init__(self, clock: Clock) -> None:
        super().__init__([[], [Event("BTN_START", 1)], [Event("BTN_START", 0)]])
        self._clock = clock
        self._pending = list(self.SCRIPT)

    def read(self) -> Sequence[Event] | None:
        due = [event for at_s, event in self._pending if at_s <= self._clock.time_s]
        del self._pending[: len(due)]
        return due or super().read()


def test_a_person_with_a_gamepad_records_an_episode_in_which_both_arms_move(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = Clock()
    monkeypatch.setattr(gamepad, "EvdevGamepad", lambda path: HandsOnPad(clock))
    episode = lead_episode(tmp_path, {"leader": "gamepad"}, clock)
    for moved_m in hands_moved(episode):
        assert moved_m[0] > 0.03
        assert abs(moved_m[1]) < 0.01
    assert episode.gripper[-1].max() < episode.gripper[0].min()
