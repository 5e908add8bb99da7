"""Which plants each stage and tool can use."""

from minidual.config.root import Config
from minidual.errors import UsageError
from minidual.plant.connect import SIMULATOR, parse_address
from minidual.plant.lifecycle import CommandKind

STAGE_PLANTS: dict[str, tuple[CommandKind, ...]] = {
    "env-check": (CommandKind.TORQUE, CommandKind.POSITION),
    "migrate": (CommandKind.TORQUE, CommandKind.POSITION),
}
"""Stages and tools that drive any plant, with the kinds of command that they send."""

_WHY_NOT = {
    "carry": "controller C gives motor torques, and its judge needs the object's true pose",
    "teleop-record": "its cameras and the judge of each episode are the simulator's",
    "deploy": "its judge needs the object's true pose",
    "benchmark": "its judge needs the object's true pose, and conditions change the simulation",
}


def check_plant(config: Config) -> None:
    """Raise UsageError for the address of a plant that there is not."""
    parse_address(config.plant.address)


def simulator_only(config: Config, stage: str) -> None:
    """Raise UsageError if another plant than the simulator is configured."""
    if config.plant.address == SIMULATOR:
        return
    able = ", ".join(STAGE_PLANTS)
    raise UsageError(
        f"{stage} runs on the simulator only, not on plant '{config.plant.address}': "
        f"{_WHY_NOT[stage]}",
        remedy=f"leave plant.address out; other plants are driven by {able}",
    )
