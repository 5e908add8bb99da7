"""Arms that env-check refuses before it measures: too weak, too near, too slow."""

from __future__ import annotations

import dataclasses

import pytest

from minidual.errors import UsageError
from minidual.robot.kinematics import Kinematics
from minidual.robot.models import PANDA
from minidual.robot.pair import DUAL_PANDA, Robot
from minidual.stages.env_check.stage import _check_clearance, _check_strength
from minidual.stages.env_check.tracking import sine_reference


def test_arms_that_cannot_hold_their_hands() -> None:
    _check_strength(Kinematics(DUAL_PANDA))
    weak = dataclasses.replace(PANDA, name="weak", tau_max=(87, 0.5, 87, 87, 12, 12, 12))
    with pytest.raises(
        UsageError, match=r"left_panda_joint2 needs [0-9.]+ Nm .* tau_max is 0.5 Nm"
    ):
        _check_strength(Kinematics(Robot(weak)))


def test_arms_that_stand_in_each_other() -> None:
    _check_clearance(DUAL_PANDA)
    near = dataclasses.replace(PANDA, name="near", base_xy_m=(0.0, 0.05))
    with pytest.raises(UsageError, match=r"at home left_.* with right_.* mm apart; the supervisor"):
        _check_clearance(Robot(near))


def test_joints_that_are_too_slow_or_have_no_room_for_the_swing() -> None:
    slow = dataclasses.replace(PANDA, v_max=(0.5,) * 7)
    with pytest.raises(UsageError, match=r"left_panda_joint1 turns at 0.5 rad/s, the swing at 0.9"):
        sine_reference(Robot(slow), 0.3, 0.5, 0.0)
    with pytest.raises(UsageError, match=r"joint\d has room for 0.\d+ rad"):
        sine_reference(DUAL_PANDA, 2.0, 0.1, 0.0)
