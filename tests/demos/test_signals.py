"""Signals of a tick: contact wrenches, internal force, codes, lost pictures."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from minidual.config.learning import TeleopConfig
from minidual.control.commands import ArbiterState
from minidual.control.stack import ControlStack
from minidual.demos.signals import (
    ARBITER_STATES,
    DRIVERS,
    REFLEX_NAMES,
    Driver,
    Signals,
    recorded_signals,
)
from minidual.plant.render import StampedImage
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Array

HOME = DUAL_PANDA.home


def stack_with(external_nm: Array, reflex: str = "") -> ControlStack[World]:
    """Return what stands for a stack whose arms at home feel torques (14,) [Nm]."""
    stopped = SimpleNamespace(reflex=SimpleNamespace(name=reflex)) if reflex else None
    stack: Any = SimpleNamespace(
        plant=SimpleNamespace(robot=DUAL_PANDA, q=HOME, stamp_s=1.5),
        supervisor=SimpleNamespace(touch=external_nm),
        state=ArbiterState.ACTIVE,
        reflex=stopped,
    )
    return cast("ControlStack[World]", stack)


def torques(left_n: tuple[float, float, float], right_n: tuple[float, float, float]) -> Array:
    """Return the joint torques (14,) of forces on both hands [N]."""
    external_nm = np.zeros(14)
    for J, force in zip(Kinematics().tcp_jacobians(HOME), (left_n, right_n), strict=True):
        external_nm += J[:3].T @ np.array(force)
    return external_nm


def test_wrenches_are_those_that_load_the_joints() -> None:
    stack = stack_with(torques((3.0, 0.0, 8.0), (0.0, -5.0, 0.0)))
    values = Signals(stack, ("hand_wrench",)).measure({}, Driver.LEADER, 0.0)
    assert values["hand_wrench"].shape == (2, 6)
    assert values["hand_wrench"][0] == pytest.approx([3, 0, 8, 0, 0, 0], abs=0.6)
    assert values["hand_wrench"][1] == pytest.approx([0, -5, 0, 0, 0, 0], abs=0.6)
    assert values["signal_timestamps"] == 1.5


@pytest.mark.parametrize(
    ("left_y_n", "right_y_n", "internal_n"),
    [(20.0, -20.0, 20.0), (20.0, -12.0, 12.0), (-20.0, 20.0, 0.0), (0.0, 0.0, 0.0)],
)
def test_hands_that_press_towards_each_other_have_an_internal_force(
    left_y_n: float,
    right_y_n: float,
    internal_n: float,
) -> None:
    """The left hand is at +y: what is between them pushes it to +y."""
    stack = stack_with(torques((0.0, left_y_n, 0.0), (0.0, right_y_n, 0.0)))
    values = Signals(stack, ("internal_force",)).measure({}, Driver.LEADER, 0.0)
    assert float(values["internal_force"]) == pytest.approx(internal_n, abs=1.0)


def test_codes_say_state_reflex_and_driver() -> None:
    names = ("arbiter_state", "reflex", "driver", "late_s")
    signals = Signals(stack_with(np.zeros(14), "speed"), names)
    values = signals.measure({}, Driver.CORRECTION, 0.03)
    assert ARBITER_STATES[int(values["arbiter_state"])] is ArbiterState.ACTIVE
    assert REFLEX_NAMES[int(values["reflex"])] == "speed"
    assert DRIVERS[int(values["driver"])] is Driver.CORRECTION
    assert float(values["late_s"]) == 0.03
    calm = Signals(stack_with(np.zeros(14)), names).measure({}, Driver.LEADER, 0.0)
    assert float(calm["reflex"]) == 0.0


def test_a_camera_that_repeats_its_picture_is_counted() -> None:
    signals = Signals(stack_with(np.zeros(14)), ("lost_pictures",))
    image = np.zeros((2, 2, 3), np.uint8)

    def lost(high_s: float, left_s: float) -> float:
        pictures = {"high": StampedImage(image, high_s), "left": StampedImage(image, left_s)}
        return float(signals.measure(pictures, Driver.LEADER, 0.0)["lost_pictures"])

    assert lost(0.0, 0.0) == 0.0
    assert lost(0.02, 0.0) == 1.0
    assert lost(0.02, 0.0) == 2.0
    signals.reset()
    assert lost(0.02, 0.0) == 0.0


def test_nothing_is_measured_that_was_not_chosen() -> None:
    assert Signals(stack_with(np.zeros(14)), ()).measure({}, Driver.LEADER, 0.0) == {}
    assert recorded_signals(TeleopConfig()) == ()
    assert recorded_signals(TeleopConfig(correct="checkpoint")) == ("driver",)
