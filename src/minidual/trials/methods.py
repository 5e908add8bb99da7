"""Table of methods.

A method drives a world through one trial: `step()` until `done`, without reading the truth. Others add rows
(docs/howto-method.md).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from minidual.config.root import Config, changed
from minidual.errors import UsageError
from minidual.registry import Registry, load_target, rows_beside
from minidual.tasks.catalogue import TASKS, make_task
from minidual.tasks.task import Task, Trial

if TYPE_CHECKING:  # the table must be readable without importing MuJoCo
    from minidual.plant.world import World
    from minidual.robot.kinematics import Kinematics

_ROWS = rows_beside(__file__)
SENSES: dict[str, str] = _ROWS["senses"]
"""What a method may read of the object, with its name in messages."""


class Method(Protocol):
    """One trial."""

    @property
    def world(self) -> World:
        """The plant."""
        ...

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


type Factory = Callable[[World, Kinematics, Trial], Method]


class MethodInputs(NamedTuple):
    """Inputs of a factory; `trained`: the checkpoint's task, empty for any."""

    config: Config
    seed: int
    checkpoint: Path | None = None
    trained: str = ""


class MethodSpec(NamedTuple):
    """One row of the table.

    Attributes:
        target: `module:function` that returns a `Factory`.
        needs_images: Whether to compile visual meshes.
        demands: Optional conditions of success that it must meet.
        senses: Rows of SENSES that it reads.
        senses_apart: The same where the hands do not hold one object all the way, if others.
        cannot: (task, trained) -> why it cannot do a task, or "".
        settings: {dotted path: value} of the configuration that it changes.
    """

    target: str
    summary: str
    needs_images: bool = False
    demands: Collection[str] = ()
    senses: Collection[str] = tuple(SENSES)
    senses_apart: Collection[str] | None = None
    cannot: Callable[[Task, str], str] = lambda task, trained: ""
    settings: Mapping[str, Any] = MappingProxyType({})

    def reads(self, task: Task) -> Collection[str]:
        """Return the rows of SENSES that it reads in a task."""
        return self.senses if task.together or self.senses_apart is None else self.senses_apart

    def factory(self, inputs: MethodInputs) -> Factory:
        """Return the trial factory."""
        return load_target(self.target)(
            inputs._replace(config=changed(inputs.config, self.settings)),
        )


_CANNOT: dict[str, Callable[[Task, str], str]] = {
    "another_task": lambda task, trained: (
        "" if trained in ("", task.name) else f"its policy is trained on '{trained}'"
    ),
    "held_apart": lambda task, trained: (
        "" if task.together else "the hands hold no object together"
    ),
}
METHODS: Registry[MethodSpec] = Registry("method", group="minidual.methods")
for _name, _row in _ROWS["methods"].items():
    if "cannot" in _row:
        _row["cannot"] = _CANNOT[_row["cannot"]]
    METHODS.add(_name, MethodSpec(**_row))


def check_able(method: str, tasks: Collection[Task], trained: str = "") -> None:
    """Raise UsageError for a method that can do none of these tasks."""
    spec = METHODS[method]
    reasons = [f"'{task.name}': {why}" for task in tasks if (why := spec.cannot(task, trained))]
    if len(reasons) == len(tasks):
        able = [name for name in TASKS if not spec.cannot(make_task(Config(task=name)), trained)]
        raise UsageError(
            f"the method '{method}' cannot do {'; '.join(reasons)}",
            remedy=f"it can do {', '.join(able)}",
        )
