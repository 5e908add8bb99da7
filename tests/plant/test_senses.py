"""Senses of a plant that brings none: a person says where objects are."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.config.control import SensingConfig
from minidual.errors import UsageError
from minidual.plant.senses import ToldSenses
from minidual.plant.sensing import SimulatedSenses
from minidual.plant.world import World
from tests.support.position_plant import Follower

T = np.eye(4)


def told() -> ToldSenses:
    return ToldSenses("arms:make", Follower(), {"rod": T})


def test_the_told_pose_is_sensed_and_forces_are_not() -> None:
    reading = told().of_object(SensingConfig(), np.random.default_rng(0)).sense()
    assert reading.pose is not None
    assert np.array_equal(reading.pose.T_world_object, T)
    assert np.isnan(reading.hand_forces).all()
    assert np.isnan(reading.pinch).all()


def test_what_nobody_told_and_pictures_are_refused() -> None:
    with pytest.raises(UsageError, match="nobody has said where 'pot' is"):
        told().of_object(SensingConfig(), np.random.default_rng(0), "pot")
    with pytest.raises(UsageError, match="plant 'arms:make' brings no camera 'high'"):
        told().picture("high")


def test_simulated_sensors_count_their_delay_in_the_plants_control_steps(world: World) -> None:
    config = SensingConfig(delay_s=0.04)
    sensors = SimulatedSenses(world, 0.02).of_object(config, np.random.default_rng(0))
    assert sensors.delay_ticks == 2
    usual = SimulatedSenses(world, world.dt).of_object(config, np.random.default_rng(0))
    assert usual.delay_ticks == 40
