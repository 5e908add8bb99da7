"""docs/howto-plant.md: its code runs, and its plant is driven like the simulator."""

from __future__ import annotations

import pytest

from minidual.robot.models import ARM_MODELS
from minidual.robot.pair import Robot
from tests.support import howto


@pytest.fixture(scope="module")
def page():
    names: dict = {}
    for block in howto.blocks("howto-plant.md"):
        exec(compile(block, "howto-plant.md", "exec"), names)
    return names


def test_every_plant_reaches_the_target(page):
    assert page["error_rad"] < 1e-3
    assert page["own_rad"] < 1e-3
    assert page["late_rad"] < 0.05


@pytest.mark.parametrize("arm", ["xarm7", "ur5"])
def test_the_same_plant_and_stack_drive_other_arms(page, arm):
    plant = page["RigidArms"](Robot(ARM_MODELS[arm]))
    assert page["reach"](plant, 0.08, 1.0) < 1e-3


def test_a_plant_that_is_ill_is_not_driven(page):
    from minidual.errors import UsageError
    from minidual.robot.pair import DUAL_PANDA

    plant = page["RigidArms"](DUAL_PANDA)
    plant.health = "the brakes are closed"
    with pytest.raises(UsageError, match="brakes are closed"):
        page["reach"](plant, 0.08, 0.1)
