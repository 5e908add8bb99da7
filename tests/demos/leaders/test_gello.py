"""GELLO arms on buses that are emulated on pseudo-terminals."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from minidual.cli.app import run_command_line
from minidual.config.leading import MirrorConfig
from minidual.demos.alignment import AlignmentGate
from minidual.demos.leader import LeaderSample
from minidual.demos.leaders.dynamixel_bus import DynamixelBus
from minidual.demos.leaders.gello import GelloLeader
from minidual.demos.leaders.gello_calibration import calibrate
from minidual.demos.leaders.gello_file import read_gello_file
from minidual.errors import ConfigError, EnvironmentMissingError
from minidual.robot.pair import DUAL_PANDA, Array
from minidual.stages.registry import STAGES, TOOLS
from tests.support.dynamixel_bus import EmulatedBus
from tests.support.led_episode import TimedStation, lead_episode

pytest.importorskip("dynamixel_sdk", reason="the extra minidual[gello] is not installed")

HOME = DUAL_PANDA.home
IDS = tuple(range(1, 8))
SIGNS = (1, -1, 1, 1, -1, 1, 1)
OFFSETS = np.pi / 2.0 * np.array([0, 1, 2, -1, 4, 3, 0])
"""As horns are screwed on."""


def ticks_of(angle_rad: float) -> int:
    return round(2048 + angle_rad * 4096 / (2.0 * np.pi))


def pose_bus(bus: EmulatedBus, q: Array, opening: float = 1.0) -> None:
    """Bring the servos of a chain to joints (7,) [rad]."""
    for servo, sign, offset, angle in zip(IDS, SIGNS, OFFSETS, q, strict=True):
        bus.positions[servo] = ticks_of(sign * angle + offset)
    bus.positions[8] = ticks_of(0.2 + 0.6 * (1.0 - opening))


@pytest.fixture
def buses() -> Iterator[list[EmulatedBus]]:
    made = [EmulatedBus(dict.fromkeys((*IDS, 8), 2048)) for _ in range(2)]
    for arm, bus in enumerate(made):
        pose_bus(bus, HOME[DUAL_PANDA.joints_of(arm)])
    yield made
    for bus in made:
        bus.close()


def file_of(buses: list[EmulatedBus], folder: Path, **changes: Any) -> Path:
    """Write the file of a pair; `changes` are of the left arm."""
    arms = []
    for bus in buses:
        arm: dict[str, Any] = {
            "port": bus.port,
            "ids": list(IDS),
            "signs": list(SIGNS),
            "offsets_rad": OFFSETS.tolist(),
            "gripper": {"id": 8, "open_rad": 0.2, "closed_rad": 0.8},
        }
        arms.append(arm)
    arms[0] |= changes
    path = folder / "gello.yaml"
    path.write_text(yaml.safe_dump({"baud_rate": 57600, "left": arms[0], "right": arms[1]}))
    return path


@pytest.fixture
def leader(buses: list[EmulatedBus], tmp_path: Path) -> Iterator[GelloLeader]:
    made = GelloLeader(read_gello_file(file_of(buses, tmp_path), DUAL_PANDA), 0.3)
    yield made
    made.close()


def newest(leader: GelloLeader, wait_s: float = 0.4) -> LeaderSample:
    time.sleep(wait_s)
    sample = leader.read(0.0)
    assert sample is not None
    return sample


def test_joints_and_grippers_of_both_arms_are_read(
    leader: GelloLeader,
    buses: list[EmulatedBus],
) -> None:
    np.testing.assert_allclose(newest(leader).q, HOME, atol=1e-3)
    moved = HOME[:7] + np.linspace(-0.3, 0.3, 7)
    pose_bus(buses[0], moved, opening=0.25)
    sample = newest(leader)
    assert sample.q is not None
    np.testing.assert_allclose(sample.q[:7], moved, atol=1e-3)
    np.testing.assert_allclose(sample.openings, (0.25, 1.0), atol=5e-3)
    assert sample.age_s is not None
    assert sample.age_s < 0.3


def test_a_position_whose_bytes_look_like_a_header_is_stuffed_and_read(
    buses: list[EmulatedBus],
) -> None:
    buses[0].positions[1] = 0x00FDFFFF
    buses[0].positions[2] = -5
    bus = DynamixelBus(buses[0].port, 57600, (1, 2))
    angles = bus.read()
    bus.close()
    assert angles is not None
    assert [ticks_of(angle) for angle in angles] == [0x00FDFFFF, -5]


def test_a_lost_or_damaged_answer_is_no_reading_and_is_counted(buses: list[EmulatedBus]) -> None:
    bus = DynamixelBus(buses[0].port, 57600, IDS)
    buses[0].drop = {4}
    assert bus.read() is None
    buses[0].drop = set()
    buses[0].damage = {7}
    assert bus.read() is None
    buses[0].damage = set()
    assert bus.read() is not None
    assert bus.lost_n == 2
    bus.close()


def test_a_bus_that_is_slow_for_a_moment_is_read(buses: list[EmulatedBus]) -> None:
    buses[0].deaf_n = 7
    bus = DynamixelBus(buses[0].port, 57600, IDS)
    assert buses[0].deaf_n == 0
    assert bus.read() is not None
    assert bus.lost_n == 0
    bus.close()


def test_servos_that_answer_a_ping_but_no_reading_are_told_from_missing_ones(
    buses: list[EmulatedBus],
) -> None:
    buses[0].deaf_n = 1000
    with pytest.raises(EnvironmentMissingError, match="one by one, but never all at once"):
        DynamixelBus(buses[0].port, 57600, IDS)


def test_a_chain_that_loses_some_answers_still_leads(
    leader: GelloLeader,
    buses: list[EmulatedBus],
) -> None:
    buses[1].lose_every = 13
    pose_bus(buses[1], HOME[7:] + 0.05)
    sample = newest(leader, 0.6)
    assert sample.q is not None
    np.testing.assert_allclose(sample.q[7:], HOME[7:] + 0.05, atol=1e-3)
    assert leader.lost_n > 0


def test_an_id_that_does_not_answer_is_named_with_those_that_do(
    buses: list[EmulatedBus],
    tmp_path: Path,
) -> None:
    path = file_of(buses, tmp_path, ids=[1, 2, 3, 4, 5, 6, 17])
    with pytest.raises(
        EnvironmentMissingError,
        match=r"no answer from servo 17 .* answer: 1, 2, 3, 4, 5, 6, 7, 8",
    ):
        GelloLeader(read_gello_file(path, DUAL_PANDA), 0.3)


def test_a_cable_pulled_in_motion_gives_no_reading(
    leader: GelloLeader,
    buses: list[EmulatedBus],
) -> None:
    newest(leader)
    buses[0].unplug()
    time.sleep(0.6)
    assert leader.read(0.0) is None


def test_a_missing_port_is_named(buses: list[EmulatedBus], tmp_path: Path) -> None:
    path = file_of(buses, tmp_path, port="/dev/ttyUSB_none")
    with pytest.raises(EnvironmentMissingError, match="/dev/ttyUSB_none cannot be opened"):
        GelloLeader(read_gello_file(path, DUAL_PANDA), 0.3)


def test_calibration_finds_the_quarter_turns_and_writes_them(
    buses: list[EmulatedBus],
    tmp_path: Path,
) -> None:
    path = file_of(buses, tmp_path, offsets_rad=[0.0] * 7)
    pose_bus(buses[0], HOME[:7] + 0.1)  # held by hand
    found = calibrate(path, DUAL_PANDA)
    np.testing.assert_allclose(found["left"].off_rad, 0.1, atol=2e-3)
    written = read_gello_file(path, DUAL_PANDA)
    for arm in written.arms:
        np.testing.assert_allclose(arm.offsets_rad, OFFSETS, atol=1e-5)
    leader = GelloLeader(written, 0.3)
    np.testing.assert_allclose(newest(leader).q, HOME + np.repeat((0.1, 0.0), 7), atol=2e-3)
    leader.close()


def test_calibration_of_another_posture_writes_nothing(
    buses: list[EmulatedBus],
    tmp_path: Path,
) -> None:
    path = file_of(buses, tmp_path)
    before = path.read_text()
    pose_bus(buses[1], HOME[7:] + np.eye(7)[2] * 0.6)
    with pytest.raises(EnvironmentMissingError, match=r"right_panda_joint3 is .* off the home"):
        calibrate(path, DUAL_PANDA)
    assert path.read_text() == before


def test_servos_that_count_from_another_turn_after_a_restart_lead_the_same(
    leader: GelloLeader,
    buses: list[EmulatedBus],
) -> None:
    buses[0].positions[3] += 4096
    gate = AlignmentGate(DUAL_PANDA, MirrorConfig())
    gate.begin(HOME)
    q = newest(leader).q
    assert q is not None
    np.testing.assert_allclose(gate.admit(q), HOME, atol=1e-3)


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"ids": [1, 2, 3]}, "signs has 7 entries, ids has 3"),
        ({"signs": [1, 1, 1, 1, 1, 1, 2]}, "signs are 1 or -1"),
        ({"ids": [1, 1, 3, 4, 5, 6, 7]}, "an id stands twice"),
        ({"gripper": {"id": 8, "open_rad": 0.2, "closed_rad": 0.2}}, "the same within"),
        ({"speed": 3}, "left.speed"),
    ],
)
def test_a_file_that_does_not_fit_is_refused_with_its_place(
    buses: list[EmulatedBus],
    tmp_path: Path,
    changes: dict[str, Any],
    error: str,
) -> None:
    with pytest.raises(ConfigError, match=error):
        read_gello_file(file_of(buses, tmp_path, **changes), DUAL_PANDA)


def test_the_command_writes_the_offsets_and_says_how_far_each_joint_was_off(
    buses: list[EmulatedBus],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = file_of(buses, tmp_path, offsets_rad=[0.0] * 7)
    words = ["leader", "calibrate", str(path), "--json", "--runs-dir", str(tmp_path / "runs")]
    assert run_command_line(words, STAGES, TOOLS) == 0
    document = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(document["arms"]["left"]["offsets_rad"], OFFSETS, atol=1e-5)
    np.testing.assert_allclose(document["arms"]["right"]["off_rad"], 0.0, atol=2e-3)
    assert read_gello_file(path, DUAL_PANDA).left.offsets_rad[1] == pytest.approx(np.pi / 2)


def test_the_command_names_a_file_that_is_missing(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["leader", "calibrate", str(tmp_path / "none.yaml")]
    assert run_command_line([*words, "--runs-dir", str(tmp_path / "runs")], STAGES, TOOLS) == 2
    assert "none.yaml cannot be read" in capsys.readouterr().err


def test_a_person_with_two_gello_arms_records_an_episode_in_which_both_arms_move(
    buses: list[EmulatedBus],
    tmp_path: Path,
) -> None:
    """The person bends both second joints and closes the hands."""
    ends = threading.Event()
    station = TimedStation(3.0)

    def lead() -> None:
        while not ends.wait(0.02):
            share = min(max(np.nan_to_num(station.time_s) - 0.3, 0.0), 2.0) / 2.0
            for arm, bus in enumerate(buses):
                q = HOME[DUAL_PANDA.joints_of(arm)].copy()
                q[1] += 0.15 * np.sin(0.5 * np.pi * share) ** 2
                pose_bus(bus, q, opening=1.0 - share)

    hand = threading.Thread(target=lead)
    hand.start()
    try:
        settings = {"leader": "gello", "gello": {"file": str(file_of(buses, tmp_path))}}
        episode = lead_episode(tmp_path, settings, station)
    finally:
        ends.set()
        hand.join()
    for arm in range(2):
        moved_rad = episode.qpos[-1] - episode.qpos[0]
        assert moved_rad[DUAL_PANDA.joints_of(arm)][1] == pytest.approx(0.15, abs=0.02)
    assert episode.gripper[-1].max() < episode.gripper[0].min()
