"""Fixtures of the tests of `env-check`."""

import pytest

from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.stages.env_check.rig import TrackingRig
from tests.support.env_check_samples import rig_of


@pytest.fixture
def rig(world: World, kinematics: Kinematics) -> TrackingRig:
    """A rig with the default bounds, arms at home."""
    return rig_of(world, kinematics)
