"""A random driver over the supervised stack: sources, joints, hands and objects, halts, faults, recoveries, lost motors.

In every tick one source at most, a bounded target, a finite torque that is near the last one, and speeds within the
limits; a latched stop ends at rest. An arm whose motors are off falls, so that its speed is not checked. One that is
pushed, or has its power back, may pass the limits for 200 ms: a push of 26 Nm rises at once, the motors' torque by 1 Nm
a tick.
"""

from __future__ import annotations

import pytest
from minidual.control.senses import JointSense

from minidual.config.scene import SceneConfig
from minidual.control.commands import (
    SOURCES,
)
from minidual.control.soft_stop import SupervisedStop, TorqueRate
from minidual.control.stack import ControlStack
from minidual.errors import MinidualError
from tests.support.random_driver import FAST, FLAKY, RARE, WRONG, Driver


@pytest.fixture
def driver(scene: SceneConfig) -> Driver:
    return Driver(scene)


def test_random_episodes_keep_every_rule(driver: Driver) -> None:
    driver.play(*range(12))
    assert set(driver.did) == {"speak", *RARE}, "something never happened"
    assert {"recovered", "switched off", "hand", "object", "controller_failed"} <= set(driver.seen)


def test_arms_driven_at_the_table_and_at_one_another_never_get_there(driver: Driver) -> None:
    driver.rare = FAST
    driver.play(22, 23, 41)
    assert driver.seen["clearance.stop"] == 4

    driver.supervisor._clearance = None  # negative control
    for seed, what in ((22, "with right"), (23, "with table")):
        with pytest.raises(AssertionError, match=what):
            driver.play(seed)


def test_a_packet_that_is_wrong_makes_no_stop_faster(
    driver: Driver,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    driver.rare = WRONG
    driver.play(*range(8))
    assert driver.seen["glitch"] > 5

    monkeypatch.setattr(JointSense, "v_slower", property(lambda self: self.v))  # negative control
    with pytest.raises(AssertionError, match="makes a stop"):
        driver.play(*range(8))


def test_joints_that_are_measured_now_and_then_draw_out_no_stop(
    driver: Driver,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    driver.rare = FLAKY
    driver.play(*range(20_000, 20_024))
    assert driver.seen["flaky"] > 3

    begin = (
        SupervisedStop.begin
    )  # negative control: each packet that comes back begins the stop anew
    monkeypatch.setattr(
        SupervisedStop,
        "begin",
        lambda self, q, v, tau, anew=None: begin(self, q, v, tau),
    )
    with pytest.raises(AssertionError, match="unmeasured in"):
        driver.play(*range(20_000, 20_024))


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
        "clock",
        "not_finite",
        "measurement.implausible",
    }
    reflexes |= {"contact.joint", "contact.stuck", "gripper_opened", "clearance.stop"}
    assert {*reflexes, *SOURCES, "recovered", "object", "hand", "switched off"} <= {
        name for name, count in driver.seen.items() if count
    }


def test_the_driver_sees_a_torque_that_jumps(
    driver: Driver,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(TorqueRate, "limit", lambda self, tau: setattr(self, "tau", tau) or tau)
    with pytest.raises(AssertionError, match="torque steps"):
        driver.play(*range(6, 10))


def test_the_driver_sees_a_lost_torque(driver: Driver, monkeypatch: pytest.MonkeyPatch) -> None:
    def lose(self: ControlStack, error: Exception) -> None:
        raise error

    monkeypatch.setattr(ControlStack, "fail", lose)
    with pytest.raises((AssertionError, ZeroDivisionError, MinidualError)):
        driver.play(*range(12))
