"""Trials of `minidual try` on a plant that is not the simulator."""

from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from minidual.config.root import Config
from minidual.errors import UsageError
from minidual.motion.api import Planner
from minidual.plant.connect import SIMULATOR, connection
from minidual.plant.lifecycle import Connection, planned_robot
from minidual.plant.senses import ToldSenses
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import robot_from
from minidual.skills.plant_home import bring_home
from minidual.tasks.task import Task, Trial, placement, pose_of
from minidual.trials.conditions import CLEAN
from minidual.trials.methods import METHODS, MethodInputs
from minidual.trials.site import PlantSite, check_takes


@contextmanager
def opened(config: Config, condition: str = CLEAN) -> Generator[Connection | None]:
    """Yield an open connection to the configured plant; None for the simulator.

    Args:
        config: Of the task.
        condition: Of the trials.

    Raises:
        UsageError: A condition of the simulator is asked for.
    """
    address = config.plant.address
    if address == SIMULATOR:
        yield None
        return
    if condition != CLEAN:
        raise UsageError(
            f"condition '{condition}' changes the simulation; plant '{address}' has none",
            remedy="leave --condition out",
        )
    with connection(config.plant, robot_from(config.robot), config.scene) as link:
        yield link


def site_of(
    link: Connection | None,
    methods: Sequence[str],
    config: Config,
    seed: int,
) -> PlantSite | None:
    """Return where trials are judged; None for the simulator.

    Raises:
        UsageError: The plant does not take a method's commands, or nothing can judge there.
    """
    if link is None:
        return None
    for method in methods:
        check_takes(method, link)
    return PlantSite(link, config, seed)


@dataclass(frozen=True)
class Unscored:
    """A trial that only a person can judge.

    Attributes:
        ended: How it ended, as far as the arms know.
        confirm: What a person has to look at.
    """

    ended: str
    confirm: tuple[str, ...]


def check_placed(placed_by: str, link: Connection, task: Task, trials: Sequence[Trial]) -> None:
    """Raise UsageError unless a person says that the objects of one trial stand at its start."""
    trial = trials[0]
    places = "; ".join(
        f"{name} at x {x:.3f} m, y {y:.3f} m, yaw {yaw:.3f} rad"
        for name, (x, y, yaw) in _places(trial).items()
    )
    only = f"--first {trial.index} --trials 1 --placed-by NAME"
    if not placed_by:
        raise UsageError(
            f"plant '{link.address}' ({link.place}) gives no true poses: nothing can score there. "
            f"A person puts the objects down ({places}) and judges the end",
            remedy=f"put them there, then add {only}",
        )
    if len(trials) > 1:
        raise UsageError(
            f"--trials is {len(trials)}; a person puts the objects down before each trial: one a call",
            remedy=only,
        )


def _places(trial: Trial) -> dict[str, tuple[float, float, float]]:
    return {name: placement(pose) for name, pose in trial.start.items()}


def drive_unscored(
    link: Connection, method: str, task: Task, inputs: MethodInputs, trial: Trial
) -> Unscored:
    """Drive one trial, whose objects a person has put at their start.

    Raises:
        UsageError: The plant does not take the method's commands, or the method needs pictures.
    """
    check_takes(method, link)
    plant = link.plant
    config = task.config
    planner = Planner(config=config.plan.planner, robot=planned_robot(plant))
    bring_home(link, config, planner, inputs.seed)
    poses = {name: pose_of(task.objects[name].body, start) for name, start in trial.start.items()}
    senses = ToldSenses(link.address, plant, poses)
    factory = METHODS[method].factory(
        inputs.of(method)._replace(config=config, senses=senses, plant=plant),
    )
    running = factory(plant, Kinematics(plant.robot), trial)
    began_s = plant.time
    while not running.done and plant.time < began_s + task.time_limit_s:
        running.step()
    ended = running.aborted or ("ended by itself" if running.done else "the time is over")
    return Unscored(ended, tuple(condition.name for condition in task.success(task, trial)))
