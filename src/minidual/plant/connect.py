"""Plants by address: `sim`, `sim-position`, `franka://HOST,HOST`, `module:factory`."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from minidual.config.plant import PlantConfig
from minidual.config.scene import SceneConfig
from minidual.errors import UsageError, check_name
from minidual.plant.lifecycle import Connection
from minidual.registry import Registry, load_target
from minidual.robot.pair import Robot

SIMULATOR = "sim"


@dataclass(frozen=True)
class PlantRequest:
    """Inputs of a row of `PLANTS`.

    Attributes:
        robot: The arms.
        scene: Used by plants that are simulated.
        hosts: What stands after `://`, separated by commas.
        config: Section `plant` of the configuration.
    """

    robot: Robot
    scene: SceneConfig
    hosts: tuple[str, ...]
    config: PlantConfig


PlantFactory = Callable[[PlantRequest], Any]

PLANTS = Registry[PlantFactory](
    "plant",
    {
        SIMULATOR: "minidual.plant.simulated:simulator",
        "sim-position": "minidual.plant.simulated:position_simulator",
        "franka": "minidual.plant.franka.plant:franka",
    },
    group="minidual.plants",
)
"""Plants by scheme; a third party adds one by an entry point."""


def parse_address(address: str) -> tuple[str, tuple[str, ...]]:
    """Return the scheme and the hosts of an address; ("", ()) for `module:factory`.

    Raises:
        UsageError: There is no such scheme, or the address is empty.
    """
    scheme, mark, rest = address.partition("://")
    if mark:
        check_name("plant", scheme, PLANTS)
        hosts = tuple(host.strip() for host in rest.split(",") if host.strip())
        return scheme, hosts
    if ":" in address:
        return "", ()
    check_name("plant", address, PLANTS)
    return address, ()


def connection(
    config: PlantConfig,
    robot: Robot,
    scene: SceneConfig,
    address: str | None = None,
) -> Connection:
    """Return a connection that is not open yet.

    Args:
        config: Section `plant`.
        robot: The arms.
        scene: Used by plants that are simulated.
        address: By default the configured one.

    Raises:
        UsageError: The address is wrong, or its factory fails.
    """
    address = config.address if address is None else address
    scheme, hosts = parse_address(address)
    if scheme:
        plant = PLANTS[scheme](PlantRequest(robot, scene, hosts, config))
        return Connection(address, plant)
    return Connection(address, _from_module(address, robot))


def _from_module(address: str, robot: Robot) -> Any:
    """Return the plant that a factory of a user's module makes."""
    try:
        factory = load_target(address)
    except Exception as error:  # another's module raises anything
        raise UsageError(
            f"plant '{address}' cannot be loaded: {type(error).__name__}: {error}",
            remedy="--plant MODULE:FACTORY, where PYTHONPATH finds the module; "
            "FACTORY(robot) returns the plant",
        ) from error
    try:
        plant = factory(robot)
    except Exception as error:
        raise UsageError(
            f"plant '{address}' cannot be made: {type(error).__name__}: {error}",
            remedy="its factory is called with the robot (minidual.robot.pair.Robot)",
        ) from error
    missing = [name for name in _MEMBERS if not hasattr(plant, name)]
    if missing:
        raise UsageError(
            f"plant '{address}' lacks {', '.join(missing)}",
            remedy="docs/howto-plant.md lists the members of a plant",
        )
    return plant


_MEMBERS = (
    "robot",
    "dt",
    "grip_max_n",
    "health",
    "time",
    "stamp_s",
    "q",
    "v",
    "tau",
    "fingers",
    "grip",
    "brake",
    "step",
)
"""Members that every plant has; `command` or `follow` come with its kind."""
