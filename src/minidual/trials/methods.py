"""Who does a task: one table of methods, each row a lazy target.

A method drives a world through one trial: `step()` until `done`. It may read joints, cameras and contact sensors; the
judge alone reads the truth. Other distributions add rows through the entry point group `minidual.methods`
(docs/howto-method.md).
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from minidual.config.root import Config
from minidual.errors import UsageError
from minidual.registry import Registry
from minidual.tasks.task import Trial

if TYPE_CHECKING:  # MuJoCo is not loaded to read the table
    from minidual.plant.world import World
    from minidual.robot.kinematics import Kinematics

SENSES: dict[str, str] = {
    "pose": "sensed pose of the object",
    "feedback": "pose or contact force during the motion",
    "picture": "picture",
}
"""What a method may read of the object, and what it is called in a sentence; joints are read by all."""


class Method(Protocol):
    """One trial of one method."""

    @property
    def world(self) -> World:
        """The plant that it drives."""
        ...

    @property
    def aborted(self) -> str | None:
        """Why it stopped itself, or None."""
        ...

    @property
    def phase(self) -> str:
        """Name of the phase the trial is in."""
        ...

    @property
    def done(self) -> bool:
        """Return whether the method has nothing left to do."""
        ...

    def step(self) -> None:
        """Run one control and physics step."""
        ...


type Factory = Callable[[World, Kinematics, Trial], Method]


@dataclass(frozen=True)
class MethodInputs:
    """What a factory may use.

    Attributes:
        config: The resolved configuration.
        seed: The run's seed.
        checkpoint: Folder of the trained policy, for methods that need one.
    """

    config: Config
    seed: int
    checkpoint: Path | None = None


@dataclass(frozen=True)
class MethodSpec:
    """One row of the table.

    Attributes:
        target: `module:function`, or the function; called with the inputs it returns a `Factory`, loading what all
            trials share (a policy, a planner) once.
        summary: One line for people.
        needs_images: The world must be compiled with visual meshes.
        demands: Optional conditions of success that its trials must meet too.
        senses: Rows of SENSES: what it reads of the object. Disturbances of other senses do not apply.
    """

    target: str | Callable[[MethodInputs], Factory]
    summary: str
    needs_images: bool = False
    demands: frozenset[str] = frozenset()
    senses: frozenset[str] = frozenset(SENSES)

    def factory(self, inputs: MethodInputs) -> Factory:
        """Return the trial factory."""
        make: Any = self.target
        if isinstance(make, str):
            module, _, function = make.partition(":")
            make = getattr(importlib.import_module(module), function)
        return make(inputs)


METHODS: Registry[MethodSpec] = Registry(
    "method",
    {
        "moveit": MethodSpec(
            "minidual.trials.model_based:planned",
            "OMPL in MoveIt 2's role, joint trajectory control",
            senses=frozenset({"pose"}),
        ),
        "impedance": MethodSpec(
            "minidual.trials.model_based:impedance",
            "object impedance with internal force control",
            demands=frozenset({"squeezed"}),
            senses=frozenset({"pose", "feedback"}),
        ),
        "act": MethodSpec(
            "minidual.trials.learned:policy",
            "ACT policy from camera and joints",
            needs_images=True,
            senses=frozenset({"picture"}),
        ),
    },
    group="minidual.methods",
)


def method_spec(name: str) -> MethodSpec:
    """Return the row of a method, or say which exist."""
    return METHODS[name]


def parse_methods(text: str | Sequence[str]) -> tuple[str, ...]:
    """Return the methods named in `moveit,impedance,act`, each once.

    Raises:
        UsageError: An unknown or repeated name, or none at all.
    """
    names = [n.strip() for n in (text.split(",") if isinstance(text, str) else text)]
    names = [n for n in names if n]
    if not names:
        raise UsageError("no method named", remedy=f"--methods {','.join(METHODS)}")
    for name in names:
        method_spec(name)
        if names.count(name) > 1:
            raise UsageError(f"method '{name}' is named twice in {','.join(names)}")
    return tuple(names)
