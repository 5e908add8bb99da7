"""Table of methods.

A method drives a world through one trial: `step()` until `done`, without reading the truth. Other
distributions add rows through the entry point group `minidual.methods` (docs/howto-method.md).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from minidual.config.base import StrictModel
from minidual.config.methods import RlConfig
from minidual.config.root import Config, changed
from minidual.errors import UsageError
from minidual.plant.lifecycle import CommandKind, planned_robot
from minidual.policies.rl.lesson import LESSONS, title_of
from minidual.registry import Deferred, Registry
from minidual.robot.pair import Robot, robot_from
from minidual.tasks.catalogue import TASKS, make_task
from minidual.tasks.task import Task, Trial
from minidual.trials.trainer import Trainer

if TYPE_CHECKING:  # the table must be readable without importing MuJoCo
    from minidual.plant.protocol import Plant
    from minidual.plant.senses import Senses
    from minidual.robot.kinematics import Kinematics

SENSES: dict[str, str] = {
    "pose": "sensed pose of the object",
    "feedback": "pose or contact force during the motion",
    "picture": "picture",
}
"""Readings of the object that a method may use, with their name in messages."""


class Method(Protocol):
    """One trial."""

    @property
    def aborted(self) -> str | None:
        """Why it stopped itself, or None."""
        ...

    @property
    def phase(self) -> str:
        """Current phase."""
        ...

    @property
    def done(self) -> bool:
        """Whether it has ended."""
        ...

    def step(self) -> None:
        """Run one control step."""


type Factory = Callable[[Plant, Kinematics, Trial], Method]
"""Makes the method of one trial, which drives a plant."""


class TrainedPolicy(NamedTuple):
    """A checkpoint, and the task that it is trained on; empty for any."""

    checkpoint: Path
    task: str = ""


class MethodInputs(NamedTuple):
    """Inputs of a method.

    Attributes:
        checkpoint: Its policy, if it has one.
        trained: The task of the checkpoint, empty for any.
        policies: {learned method: its policy}, where several run; `of` chooses.
        senses: Of objects and pictures, where the trials take place.
        plant: What is driven there; None: the simulator.
    """

    config: Config
    seed: int
    checkpoint: Path | None = None
    trained: str = ""
    policies: Mapping[str, TrainedPolicy] = MappingProxyType({})
    senses: Senses | None = None
    plant: Plant | None = None

    @property
    def period_s(self) -> float:
        """Control period."""
        timestep_s = self.config.scene.physics.timestep_s
        return timestep_s if self.plant is None else self.plant.dt

    @property
    def robot(self) -> Robot:
        """The arms, with the limits that the plant allows."""
        return robot_from(self.config.robot) if self.plant is None else self.plant.robot

    @property
    def planned_robot(self) -> Robot:
        """The arms, with the limits that plans keep to."""
        return self.robot if self.plant is None else planned_robot(self.plant)

    @property
    def sensed(self) -> Senses:
        """Sensors of objects, and cameras.

        Raises:
            UsageError: Nothing does.
        """
        if self.senses is None:
            raise UsageError(
                "the method senses objects or takes pictures, and its inputs have no senses",
                remedy="MethodInputs(..., senses=SimulatedSenses(world, world.dt))",
            )
        return self.senses

    def of(self, method: str) -> MethodInputs:
        """Return the inputs of one method: `checkpoint` and `trained` are those of its policy."""
        policy = self.policies.get(method)
        if policy is None:
            return self
        return self._replace(checkpoint=policy.checkpoint, trained=policy.task)


type Build = Callable[[MethodInputs], Factory]
"""Builds the shared state of one process's trials, and returns the factory of trials."""
type Title = Callable[[str], str]
type Cannot = Callable[[Task, str], str]
"""(task, trained) -> why a method cannot do a task, or ""."""


def _drives_it_all(task: str) -> str:
    return ""


def _can_any_task(task: Task, trained: str) -> str:
    return ""


def _can_the_task_it_is_trained_on(task: Task, trained: str) -> str:
    if trained in ("", task.name):
        return ""
    return f"its policy is trained on '{trained}'"


def _can_what_is_learned_by_trying(task: Task, trained: str) -> str:
    if task.name not in LESSONS:
        return f"nobody has written a lesson for it; there are {', '.join(LESSONS) or 'none'}"
    return _can_the_task_it_is_trained_on(task, trained)


def _can_hold_one_object_together(task: Task, trained: str) -> str:
    return "" if task.together else "the hands hold no object together"


class MethodSpec(NamedTuple):
    """One row of the table.

    Attributes:
        build: Builds a factory of trials.
        needs_images: Whether to compile visual meshes.
        demands: Optional conditions of success that it must meet.
        senses: Rows of SENSES that it reads.
        senses_apart: The same where the hands do not hold one object all the way, if others.
        cannot: (task, trained) -> why it cannot do a task, or "".
        settings: {dotted path: value} of the configuration that it changes.
        config: Model of its own settings, `methods.NAME...`; `inputs.config.methods.of` returns
            them.
        learned: Whether it drives a trained policy.
        trainer: Trains its policy from an environment; that of `act` is the stage train-act.
        title: Task -> what drives there, where the name of the method says too much, or "".
        kinds: Kinds of command that it can give.
    """

    build: Build
    summary: str
    needs_images: bool = False
    demands: Collection[str] = ()
    senses: Collection[str] = tuple(SENSES)
    senses_apart: Collection[str] | None = None
    cannot: Cannot = _can_any_task
    settings: Mapping[str, Any] = MappingProxyType({})
    config: type[StrictModel] | None = None
    learned: bool = False
    trainer: Deferred[Trainer] | None = None
    title: Title = _drives_it_all
    kinds: Collection[CommandKind] = tuple(CommandKind)

    def reads(self, task: Task) -> Collection[str]:
        """Return the rows of SENSES that it reads in a task."""
        if task.together or self.senses_apart is None:
            return self.senses
        return self.senses_apart

    def factory(self, inputs: MethodInputs) -> Factory:
        """Return the factory of trials, with the method's settings."""
        config = changed(inputs.config, self.settings)
        return self.build(inputs._replace(config=config))


# Factories import planner, controllers and policies: they are loaded when a method is built.


def _planned(inputs: MethodInputs) -> Factory:
    from minidual.trials import factories

    return factories.planned(inputs)


def _impedance(inputs: MethodInputs) -> Factory:
    from minidual.trials import factories

    return factories.impedance(inputs)


def _policy(inputs: MethodInputs) -> Factory:
    from minidual.trials import factories

    return factories.policy(inputs)


def _learned_by_trying(inputs: MethodInputs) -> Factory:
    from minidual.trials import reinforced

    return reinforced.driven(inputs)


@Deferred
def _rl_trainer() -> Trainer:
    from minidual.trials.reinforced import RlTrainer

    return RlTrainer()


def _replayed(inputs: MethodInputs) -> Factory:
    from minidual.trials import factories

    return factories.replayed(inputs)


def _resting(inputs: MethodInputs) -> Factory:
    from minidual.trials import factories

    return factories.resting(inputs)


MOVEIT = MethodSpec(
    _planned,
    "planned and timed path (OMPL, TOPP-RA), joint trajectory control",
    senses=("pose",),
)
IMPEDANCE = MethodSpec(
    _impedance,
    "impedance of what the hands hold, and internal force control",
    demands=("squeezed",),
    senses=("pose", "feedback"),
    senses_apart=("pose",),
    kinds=(CommandKind.TORQUE,),
)
IMPEDANCE_OPEN = IMPEDANCE._replace(
    summary="impedance without feedback of the internal force",
    cannot=_can_hold_one_object_together,
    settings={"carry.impedance.force_gain": 0.0},
)
IMPEDANCE_WORLD = IMPEDANCE._replace(
    summary="impedance with an internal force of fixed direction in world axes",
    cannot=_can_hold_one_object_together,
    settings={"carry.impedance.squeeze_axes": "world"},
)
ACT = MethodSpec(
    _policy,
    "trained policy, from camera and joints",
    needs_images=True,
    senses=("picture",),
    cannot=_can_the_task_it_is_trained_on,
    learned=True,
)
RL = MethodSpec(
    _learned_by_trying,
    "policy learned by reinforcement (PPO), from sensed poses, joints and grips",
    senses=("pose", "feedback"),
    cannot=_can_what_is_learned_by_trying,
    config=RlConfig,
    learned=True,
    trainer=_rl_trainer,
    title=title_of,
    kinds=(CommandKind.TORQUE,),
)
REPLAY = MethodSpec(_replayed, "the plan of one demonstration, driven blind", senses=())
HOLD = MethodSpec(_resting, "the arms rest", senses=())

METHODS: Registry[MethodSpec] = Registry(
    "method",
    {
        "moveit": MOVEIT,
        "impedance": IMPEDANCE,
        "impedance_open": IMPEDANCE_OPEN,
        "impedance_world": IMPEDANCE_WORLD,
        "act": ACT,
        "rl": RL,
        "replay": REPLAY,
        "hold": HOLD,
    },
    group="minidual.methods",
)


def shown_as(method: str, task: str) -> str:
    """Return a method's name, with the driver of the rest where its policy does only a part of a task."""
    title = METHODS[method].title(task) if method in METHODS else ""
    return f"{method} ({title})" if title else method


def check_able(method: str, tasks: Collection[Task], trained: str = "") -> None:
    """Raise UsageError for a method that can do none of these tasks."""
    spec = METHODS[method]
    reasons: list[str] = []
    for task in tasks:
        reason = spec.cannot(task, trained)
        if reason:
            reasons.append(f"'{task.name}': {reason}")
    if len(reasons) < len(tasks):
        return
    able = [name for name in TASKS if not spec.cannot(make_task(Config(task=name)), trained)]
    raise UsageError(
        f"the method '{method}' cannot do {'; '.join(reasons)}",
        remedy=f"it can do {', '.join(able)}",
    )
