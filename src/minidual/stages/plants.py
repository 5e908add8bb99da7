"""Which plants each stage and tool can use."""

from minidual.config.root import Config
from minidual.errors import UsageError
from minidual.plant.connect import SIMULATOR, parse_address

TAKE_ANY_PLANT = ("env-check", "migrate", "modes", "lead", "try")
"""Stages and tools that drive any plant; `try` asks its methods which commands they give."""

_WHY_NOT = {
    "carry": "controller C gives motor torques, and its recordings are the simulator's",
    "teleop-record": "its cameras and the judge of each episode are the simulator's; "
    "`lead` lets a leader drive any plant",
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
    able = ", ".join(TAKE_ANY_PLANT)
    raise UsageError(
        f"{stage} runs on the simulator only, not on plant '{config.plant.address}': "
        f"{_WHY_NOT[stage]}",
        remedy=f"leave plant.address out; other plants are driven by {able}",
    )
