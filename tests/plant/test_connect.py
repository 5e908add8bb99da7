"""Plants by address."""

from __future__ import annotations

import pytest

from minidual.config.plant import PlantConfig
from minidual.config.scene import SceneConfig
from minidual.errors import UsageError
from minidual.plant.connect import connection, parse_address
from minidual.plant.lifecycle import CommandKind
from minidual.plant.world import World
from minidual.robot.pair import DUAL_PANDA
from tests.support.position_plant import Follower


def made(address: str):
    return connection(PlantConfig(address=address), DUAL_PANDA, SceneConfig())


@pytest.mark.parametrize(
    ("address", "parsed"),
    [
        ("sim", ("sim", ())),
        ("franka://10.0.0.1, 10.0.0.2", ("franka", ("10.0.0.1", "10.0.0.2"))),
        ("mine:factory", ("", ())),
    ],
)
def test_an_address_has_a_scheme_and_hosts(address: str, parsed: object) -> None:
    assert parse_address(address) == parsed


@pytest.mark.parametrize("address", ["simulator", "frank://10.0.0.1"])
def test_an_unknown_scheme_is_refused_with_those_that_there_are(address: str) -> None:
    with pytest.raises(UsageError, match="there are franka, sim, sim-position"):
        parse_address(address)


def test_the_simulator_is_a_plant_that_takes_torques() -> None:
    link = made("sim")
    assert isinstance(link.plant, World)
    assert link.kinds == (CommandKind.TORQUE,)
    assert link.place == "simulator"


def test_a_factory_of_a_module_is_called_with_the_robot() -> None:
    link = made("tests.support.position_plant:Follower")
    assert isinstance(link.plant, Follower)
    assert link.plant.robot is DUAL_PANDA
    assert link.place == "test double"


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("no_such_module:plant", "cannot be loaded: ModuleNotFoundError"),
        ("tests.support.position_plant:Nothing", "cannot be loaded: AttributeError"),
        ("builtins:int", "cannot be made: TypeError"),
        ("builtins:id", "lacks robot, dt"),
    ],
)
def test_a_factory_that_gives_no_plant_is_refused_by_name(address: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        made(address)
