"""Random episodes over the supervised stack keep every rule (tests/support/random_driver.py)."""

from __future__ import annotations

import pytest

from minidual.config.scene import SceneConfig
from minidual.control import soft_stop, supervisor
from minidual.control.commands import SOURCES
from minidual.control.loop import ControlLoop
from minidual.errors import MinidualError
from tests.support.random_driver import FAST, FLAKY, RARE, WRONG, Driver


@pytest.fixture
def driver(scene: SceneConfig) -> Driver:
    return Driver(scene)


def test_random_episodes_keep_every_rule(driver: Driver) -> None:
    driver.play(*range(12))
    assert set(driver.did) == {"speak", *RARE}, "something never happened"
    assert {"recovered", "hand", "object", "controller_failed"} <= set(driver.seen)


def test_arms_driven_at_the_table_and_at_one_another_never_get_there(driver: Driver) -> None:
    driver.rare = FAST
    driver.play(22, 23, 41)
    assert driver.seen["clearance.stop"] == 4

    driver.supervisor._space_check.clearance = None  # negative control
    for seed, pair in ((22, "with right"), (23, "with table")):
        with pytest.raises(AssertionError, match=pair):
            driver.play(seed)


def test_a_packet_that_is_wrong_makes_no_stop_faster(
    driver: Driver,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    driver.rare = WRONG
    driver.play(*range(8))
    assert driver.seen["glitch"] > 5

    monkeypatch.setattr(supervisor, "slower", lambda v, before: v)  # negative control
    with pytest.raises(AssertionError, match="makes a stop"):
        driver.play(*range(8))


def test_joints_that_are_measured_now_and_then_draw_out_no_stop(driver: Driver) -> None:
    driver.rare = FLAKY
    driver.play(*range(20_000, 20_024))
    assert driver.seen["flaky"] > 3


@pytest.mark.slow
def test_five_hundred_episodes_of_flaky_joints_keep_every_rule(driver: Driver) -> None:
    driver.rare = FLAKY
    driver.play(*range(20_000, 20_500))
    assert driver.seen["flaky"] > 60


@pytest.mark.slow
def test_a_thousand_episodes_of_wrong_packets_keep_every_rule(driver: Driver) -> None:
    driver.rare = WRONG
    driver.play(*range(10_000, 11_000))
    assert driver.seen["glitch"] > 500


@pytest.mark.slow
@pytest.mark.parametrize("block", range(10))
def test_five_thousand_random_episodes_keep_every_rule(driver: Driver, block: int) -> None:
    driver.play(*range(1000 + 500 * block, 1500 + 500 * block))
    reflexes = {
        "controller_failed",
        "emergency_stop",
        "plant_failed",
        "measurement.clock",
        "measurement.not_finite",
        "measurement.implausible",
        "contact.joint",
        "contact.stuck",
        "gripper_opened",
        "clearance.stop",
    }
    expected = {*reflexes, *SOURCES, "recovered", "object", "hand"}
    assert expected <= {name for name, count in driver.seen.items() if count}


def test_the_driver_sees_a_torque_that_jumps(
    driver: Driver,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(soft_stop, "towards_torque", lambda tau, goal, step: goal)
    with pytest.raises(AssertionError, match="torque steps"):
        driver.play(*range(6, 10))


def test_the_driver_sees_a_lost_torque(driver: Driver, monkeypatch: pytest.MonkeyPatch) -> None:
    def lose(self: ControlLoop, error: Exception) -> None:
        raise error

    monkeypatch.setattr(ControlLoop, "fail", lose)
    with pytest.raises((AssertionError, ZeroDivisionError, MinidualError)):
        driver.play(*range(12))
