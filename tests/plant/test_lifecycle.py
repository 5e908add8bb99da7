"""The life cycle of a plant: what it says itself, and what a connection says in its place."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from minidual.control.stack import ControlStack
from minidual.errors import UsageError
from minidual.plant.lifecycle import (
    ArmHealth,
    CommandKind,
    Connection,
    catch_up,
    planned_robot,
    runs_on,
)
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, slower_robot
from tests.support.position_plant import Follower


def test_a_plant_is_connected_activated_and_closed_in_this_order() -> None:
    plant = Follower()
    with Connection("mine:Follower", plant):
        assert plant.calls == ["connect", "activate position"]
    assert plant.calls[-1] == "close"


def test_a_plant_that_says_nothing_has_defaults() -> None:
    plant = SimpleNamespace(dt=0.001, stamp_s=2.0, health="", close=lambda: None)
    link = Connection("mine:Bare", plant).open()
    assert link.kinds == (CommandKind.TORQUE,)
    assert link.stamps_s.tolist() == [2.0, 2.0]
    assert [health.well for health in link.healths] == [True, True]
    assert link.sent is None
    assert link.place == "external plant"
    plant.health = "the brakes are closed"
    assert link.healths == [
        ArmHealth("left", ("the brakes are closed",)),
        ArmHealth("right", ("the brakes are closed",)),
    ]


def test_what_a_plant_says_itself_is_passed_on() -> None:
    plant = Follower()
    plant.late_arm_s = 0.01
    plant.faults = [(), ("joint_reflex",)]
    link = Connection("mine:Follower", plant)
    assert np.allclose(link.stamps_s, [0.0, -0.01])
    assert [health.faults for health in link.healths] == [(), ("joint_reflex",)]
    assert link.sent is not None
    link.recover()
    assert all(health.well for health in link.healths)


def test_a_kind_of_command_that_a_plant_does_not_take_is_refused_with_its_reason() -> None:
    plant = Follower()
    plant.why_not = {CommandKind.TORQUE: "its loop is not ours"}
    with pytest.raises(UsageError, match="takes no torque commands; it takes position") as error:
        Connection("mine:Follower", plant).open(CommandKind.TORQUE)
    assert error.value.remedy == "its loop is not ours"
    assert plant.calls == []


@pytest.mark.parametrize(("dt", "hz"), [(0.1, "10"), (0.0005, "2000")])
def test_a_rate_outside_the_kinds_bounds_is_refused_and_the_plant_is_closed(
    dt: float, hz: str
) -> None:
    plant = Follower(dt=dt)
    with pytest.raises(UsageError, match=f"at {hz} Hz; position commands come at 50 to 1000 Hz"):
        Connection("mine:Follower", plant).open()
    assert plant.calls[-1] == "close"


def test_a_plant_without_a_twin_or_a_clock_of_its_own_says_so() -> None:
    plant = Follower()
    assert Connection("mine:Follower", plant).twin() is None
    assert not runs_on(plant)
    catch_up(plant)
    plant.catch_up = lambda: plant.calls.append("catch up")  # type: ignore[attr-defined]
    assert runs_on(plant)
    catch_up(plant)
    assert plant.calls == ["catch up"]


def test_switches_wait_longer_for_a_plant_that_brakes_gently() -> None:
    plant = Follower()
    usual = ControlStack(plant, Kinematics(plant.robot))
    plant.braking_share = 0.4
    gentle = ControlStack(plant, Kinematics(plant.robot))
    usual_s = usual.arbiter.config.settle_timeout_s
    assert gentle.arbiter.config.settle_timeout_s == pytest.approx(usual_s / 0.4)


def test_plans_leave_a_plant_that_brakes_gently_room_to_stop() -> None:
    plant = Follower()
    assert planned_robot(plant) is plant.robot
    plant.braking_share = 0.4
    assert np.allclose(planned_robot(plant).a_max, 0.5 * plant.robot.a_max)
    assert np.array_equal(planned_robot(plant).v_max, plant.robot.v_max)


def test_slower_arms_are_the_same_arms_with_lower_limits() -> None:
    slow = slower_robot(DUAL_PANDA, 0.8, 0.4)
    assert np.allclose(slow.v_max, 0.8 * DUAL_PANDA.v_max)
    assert np.allclose(slow.a_max, 0.4 * DUAL_PANDA.a_max)
    assert np.allclose(slow.jerk_max, 0.4 * DUAL_PANDA.jerk_max)
    assert np.array_equal(slow.q_lower, DUAL_PANDA.q_lower)
    assert slow.name == DUAL_PANDA.name
    assert slow != DUAL_PANDA
    assert slow.arms[0] is slow.arms[1]
