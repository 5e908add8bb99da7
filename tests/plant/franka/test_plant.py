"""Two Franka arms as a plant, on a client library without a network."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator

import numpy as np
import pytest

from minidual.config.plant import PlantConfig
from minidual.config.scene import SceneConfig
from minidual.errors import EnvironmentMissingError, UsageError
from minidual.plant.connect import connection
from minidual.plant.franka import link, plant
from minidual.plant.franka.link import client_library, described
from minidual.plant.lifecycle import CommandKind, Connection
from minidual.robot.models import UR5
from minidual.robot.pair import DUAL_PANDA, Robot
from tests.support import fake_franky

HOSTS = ("10.0.0.1", "10.0.0.2")


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> fake_franky.Cell:
    shared = fake_franky.Cell()
    library = fake_franky.module(shared)
    monkeypatch.setattr(link, "client_library", lambda: library)
    monkeypatch.setattr(plant, "client_library", lambda: library)
    return shared


def made(address: str = "franka://10.0.0.1,10.0.0.2", robot: Robot = DUAL_PANDA) -> Connection:
    return connection(PlantConfig(address=address), robot, SceneConfig())


@pytest.fixture
def open_link(cell: fake_franky.Cell) -> Iterator[Connection]:
    with made() as opened:
        yield opened


def test_hardware_and_emulator_are_told_apart(cell: fake_franky.Cell) -> None:
    for hardware, place in ((True, "hardware"), (False, "emulator")):
        cell.hardware = hardware
        with made() as opened:
            assert opened.place == place


def test_the_vendors_limits_and_thresholds_are_set(
    cell: fake_franky.Cell, open_link: Connection
) -> None:
    options = cell.robots[HOSTS[0]].options
    assert options["relative_dynamics_factor"] == (0.8, 0.4, 0.4)
    assert options["default_torque_threshold"] == 25.0
    assert options["realtime_config"] == "ignore"


def test_both_arms_are_measured_on_one_clock(open_link: Connection) -> None:
    driven = open_link.plant
    assert np.allclose(driven.q, DUAL_PANDA.home)
    before_s = driven.time
    driven.step()
    assert driven.time == pytest.approx(before_s + 0.02, abs=5e-3)
    assert np.abs(driven.stamps_s - driven.time).max() < 9e-3
    assert np.allclose(driven.tau, 1.0)


def test_targets_are_pursued_by_their_velocity_which_ends_in_rest(
    cell: fake_franky.Cell, open_link: Connection
) -> None:
    driven = open_link.plant
    v = np.full(14, 0.5)
    q = DUAL_PANDA.home + 0.01 + 0.02 * v
    driven.follow(q, v, np.full(2, np.nan))
    for host in HOSTS:
        (motion,) = cell.robots[host].motions
        first, rest = motion.waypoints
        assert np.allclose(first.target, 0.5 + 8.0 * 0.01)
        assert first.hold.milliseconds == 40
        assert not rest.target.any()
        assert rest.hold.milliseconds > 1_000_000
    assert np.array_equal(open_link.sent.q, q)


def test_a_far_target_is_pursued_within_the_share_of_the_speed(
    cell: fake_franky.Cell, open_link: Connection
) -> None:
    driven = open_link.plant
    driven.follow(DUAL_PANDA.home + 1.0, np.zeros(14), np.full(2, np.nan))
    share = PlantConfig().velocity_share
    for index, host in enumerate(HOSTS):
        (motion,) = cell.robots[host].motions
        v_max = DUAL_PANDA.v_max[DUAL_PANDA.joints_of(index)]
        assert np.allclose(motion.waypoints[0].target, 0.95 * share * v_max)


def test_a_target_is_reached(cell: fake_franky.Cell, open_link: Connection) -> None:
    driven = open_link.plant
    target = DUAL_PANDA.home + 0.05
    for _ in range(60):
        driven.follow(target, np.zeros(14), np.full(2, np.nan))
        driven.step()
    assert np.abs(driven.q - target).max() < 1e-3


def test_an_error_of_one_arm_is_named_and_the_arm_gets_no_more_targets(
    cell: fake_franky.Cell, open_link: Connection
) -> None:
    right = cell.robots[HOSTS[1]]
    right.errors = {"cartesian_reflex"}
    driven = open_link.plant
    driven.step()
    assert driven.health == f"right arm: {described('cartesian_reflex')}"
    assert "contact" in driven.health
    driven.follow(driven.q, np.zeros(14), np.ones(2))
    assert right.motions == []
    assert len(cell.robots[HOSTS[0]].motions) == 1
    open_link.recover()
    assert driven.health == ""


def test_a_recovery_waits_for_the_state_that_shows_it(
    cell: fake_franky.Cell, open_link: Connection
) -> None:
    left = cell.robots[HOSTS[0]]
    left.errors = {"cartesian_reflex"}
    left.clears_after = 3
    open_link.plant.step()
    open_link.recover()
    assert open_link.plant.health == ""


def test_clocks_are_compared_after_both_arms_have_answered(cell: fake_franky.Cell) -> None:
    cell.pause_ms = 80.0  # while the right arm connects
    with made() as opened:
        opened.plant.catch_up()
        left_s, right_s = opened.plant.stamps_s
        assert abs(left_s - right_s) < 0.005


def test_arms_are_measured_together_though_the_machine_pauses_between_them(
    cell: fake_franky.Cell, open_link: Connection
) -> None:
    driven = open_link.plant
    for _ in range(5):
        cell.pause_ms = 50.0
        driven.catch_up()
        left_s, right_s = driven.stamps_s
        assert abs(left_s - right_s) < 0.005


def test_an_error_that_does_not_clear_stays(
    cell: fake_franky.Cell, open_link: Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link, "_RECOVERY_S", 0.05)
    left = cell.robots[HOSTS[0]]
    left.errors = {"joint_position_limits_violation"}
    left.recoverable = False
    open_link.plant.step()
    open_link.recover()
    assert "joint_position_limits_violation" in open_link.plant.health


def test_the_exception_of_a_motion_is_named(cell: fake_franky.Cell, open_link: Connection) -> None:
    left = cell.robots[HOSTS[0]]
    left.raises = fake_franky.ControlException(
        'libfranka: Move command aborted: motion aborted by reflex! ["joint_reflex"]'
    )
    open_link.plant.step()
    assert open_link.plant.health == f"left arm: {described('joint_reflex')}"
    open_link.recover()
    left.raises = fake_franky.ControlException("libfranka: UDP receive: Timeout")
    open_link.plant.step()
    assert "ControlException: libfranka: UDP receive: Timeout" in open_link.plant.health


def test_our_own_stop_is_no_fault(cell: fake_franky.Cell, open_link: Connection) -> None:
    left = cell.robots[HOSTS[0]]
    open_link.plant.brake((0,))
    open_link.plant.brake((0,))
    assert left.calls == ["stop", "join"]
    left.raises = fake_franky.ControlException("libfranka: Move command preempted!")
    open_link.plant.step()
    assert open_link.plant.health == ""


def test_a_pressed_stop_button_is_a_fault(cell: fake_franky.Cell, open_link: Connection) -> None:
    cell.robots[HOSTS[0]].mode = "UserStopped"
    open_link.plant.step()
    assert "user_stopped (emergency_stop" in open_link.plant.health


def test_a_controller_that_falls_silent_leaves_its_stamp_behind(
    cell: fake_franky.Cell, open_link: Connection
) -> None:
    driven = open_link.plant
    cell.robots[HOSTS[1]].silent = True
    for _ in range(3):
        driven.step()
    assert driven.time - driven.stamp_s > 0.05
    assert driven.stamps_s[0] > driven.stamps_s[1]


@pytest.mark.parametrize(
    ("error", "is_patient"),
    [(fake_franky.NetworkException, False), (fake_franky.ControlException, True)],
)
def test_a_lost_connection_does_not_hold_up_the_other_arm(
    cell: fake_franky.Cell,
    open_link: Connection,
    monkeypatch: pytest.MonkeyPatch,
    error: type[Exception],
    is_patient: bool,
) -> None:
    """A step waits long for a slow controller, and a period for one that is gone, until it recovers."""
    driven = open_link.plant
    clock_s = [0.0]
    monkeypatch.setattr(plant.time, "perf_counter", lambda: clock_s[0])
    monkeypatch.setattr(plant.time, "sleep", lambda s: clock_s.__setitem__(0, clock_s[0] + s))
    cell.robots[HOSTS[1]].raises = error("libfranka: UDP receive: Timeout")
    driven.step()  # the fault is noticed
    cell.robots[HOSTS[1]].silent = True
    began_s = clock_s[0]
    driven.step()
    waited_s = clock_s[0] - began_s
    assert (waited_s > 2.0 * driven.dt) == is_patient
    cell.robots[HOSTS[1]].silent = False
    open_link.recover()
    assert not driven._arms[1].is_lost


def test_hands_close_with_the_set_force_and_open(
    cell: fake_franky.Cell, open_link: Connection
) -> None:
    driven = open_link.plant
    hand = cell.hands[HOSTS[0]]

    def told(opening: float, word: str) -> tuple:
        driven.follow(driven.q, np.zeros(14), np.array([opening, np.nan]))
        until_s = time.monotonic() + 10.0
        while time.monotonic() < until_s:
            if hand.calls and hand.calls[-1][0] == word:
                return hand.calls[-1]
            time.sleep(0.01)
        raise AssertionError(f"the hand was not told to {word}: {hand.calls}")

    _, width, _, force, *_ = told(0.0, "grasp")
    assert (width, force) == (0.0, 40.0)
    until_s = time.monotonic() + 10.0
    while driven.grip[0] == 0.0 and time.monotonic() < until_s:
        time.sleep(0.01)
    assert driven.grip.tolist() == [40.0, 0.0]
    count = len(hand.calls)
    driven.follow(driven.q, np.zeros(14), np.array([0.1, np.nan]))  # still closed
    time.sleep(0.1)
    assert len(hand.calls) == count
    assert told(1.0, "move")[1] == pytest.approx(0.08)


def test_torques_are_refused_with_the_reason(cell: fake_franky.Cell) -> None:
    with pytest.raises(UsageError, match="takes no torque commands") as error:
        made().open(CommandKind.TORQUE)
    assert "controller C" in (error.value.remedy or "")
    assert "366 to 421 Hz" in (error.value.remedy or "")


@pytest.mark.parametrize("address", ["franka", "franka://10.0.0.1", "franka://10.0.0.1,10.0.0.1"])
def test_two_different_hosts_are_needed(cell: fake_franky.Cell, address: str) -> None:
    with pytest.raises(UsageError, match="needs the addresses of two controllers"):
        made(address).open()


def test_other_arms_are_refused(cell: fake_franky.Cell) -> None:
    with pytest.raises(UsageError, match="'ur5' has 6"):
        made(robot=Robot(UR5)).open()


def test_a_controller_that_does_not_answer_is_named(cell: fake_franky.Cell) -> None:
    cell.refuse = {HOSTS[1]}
    with pytest.raises(
        EnvironmentMissingError, match=r"no Franka controller answers at 10\.0\.0\.2"
    ):
        made().open()


def test_without_the_extra_its_name_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "franky", None)
    with pytest.raises(EnvironmentMissingError) as error:
        client_library()
    assert error.value.remedy == "pip install 'minidual[franka]'"
