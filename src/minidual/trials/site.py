"""Where trials take place: the plant that a method drives, and the world that the judge sees.

A method gets the plant and its senses only.
"""

from collections.abc import Collection
from typing import Protocol

from minidual.config.root import Config
from minidual.errors import UsageError
from minidual.motion.api import Planner
from minidual.plant.lifecycle import CommandKind, Connection, catch_up, planned_robot
from minidual.plant.protocol import Plant
from minidual.plant.senses import Senses
from minidual.plant.sensing import SimulatedSenses
from minidual.plant.world import World
from minidual.skills.plant_home import bring_home
from minidual.tasks.judge import Judge, begin, begin_here
from minidual.tasks.task import Task, Trial
from minidual.trials.methods import METHODS


class Site(Protocol):
    """A place for trials.

    Attributes:
        plant: What methods drive.
        senses: What else they may know.
        world: The truth, for the judge and for pictures; as it was at the last control step.
    """

    plant: Plant
    senses: Senses
    world: World

    def begin(self, task: Task, trial: Trial, demands: Collection[str]) -> Judge:
        """Put arms and objects at a trial's start; return its judge."""
        ...

    def start(self, judge: Judge) -> None:
        """Start the trial's time: its method is ready."""
        ...


class SimulatedSite:
    """A simulated world that is driven by torques."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.plant: Plant = world
        self.senses: Senses = SimulatedSenses(world, world.dt)

    def begin(self, task: Task, trial: Trial, demands: Collection[str]) -> Judge:
        """See `Site`."""
        return begin(self.world, task, trial, demands)

    def start(self, judge: Judge) -> None:
        """See `Site`; simulated time has stood still."""


class PlantSite:
    """Any plant behind which a simulated world stands: only the objects are put at their start.

    The arms are driven home.

    Args:
        link: Open.
        config: Of the control of the arms.
        seed: Of the plans that lead home.

    Raises:
        UsageError: No simulated world stands behind the plant: nothing knows where objects are.
    """

    def __init__(self, link: Connection, config: Config, seed: int) -> None:
        twin = link.twin()
        if twin is None:
            raise UsageError(
                f"nothing can judge a trial on plant '{link.address}' ({link.place}): "
                "it gives no true poses of objects",
                remedy="a person has to; see docs/hardware.md",
            )
        self._link = link
        self._twin = twin
        self._config = config
        self._seed = seed
        self._planner = Planner(config=config.plan.planner, robot=planned_robot(link.plant))
        self.world = twin.world
        self.plant: Plant = link.plant
        self.senses: Senses = SimulatedSenses(twin.world, link.plant.dt)

    def begin(self, task: Task, trial: Trial, demands: Collection[str]) -> Judge:
        """See `Site`."""
        bring_home(self._link, self._config, self._planner, self._seed)
        self._twin.place(trial.start)
        return begin_here(self.world, task, trial, demands)

    def start(self, judge: Judge) -> None:
        """See `Site`."""
        catch_up(self.plant)
        judge.truth.began_s = self.world.time


def check_takes(method: str, link: Connection) -> None:
    """Raise UsageError for a method whose commands a plant does not take."""
    kinds = METHODS[method].kinds
    if set(kinds) & set(link.kinds):
        return
    produced = " or ".join(kinds)
    taken = " and ".join(link.kinds)
    able = [name for name, spec in METHODS.items() if set(spec.kinds) & set(link.kinds)]
    why_not = getattr(link.plant, "why_not", {}).get(CommandKind.TORQUE, "")
    raise UsageError(
        f"the method '{method}' gives {produced} commands, and plant '{link.address}' takes {taken}"
        f"{'; ' if why_not else ''}{why_not}",
        remedy=f"it can be driven by {', '.join(able)}",
    )
