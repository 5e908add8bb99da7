"""The methods that are compared: one explicit table, each row a lazy target.

A method drives a world through one rod trial: `step()` until `done`. It may read joints, cameras and contact
sensors; the judge alone reads the truth.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from minidual.config.root import Config
from minidual.errors import UsageError, unknown_name
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.tasks.task import Trial
from minidual.trials.conditions import SENSES


class Method(Protocol):
    """One trial of one method."""

    world: World
    aborted: str | None

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
        target: `module:function`; called as function(inputs) it returns a factory
            (world, kinematics, trial) -> Method, loading what all trials share (a policy, a planner) once.
        summary: One line for people.
        needs_images: The world must be compiled with visual meshes.
        demands: Optional conditions of success that its trials must meet too.
        senses: Rows of `conditions.SENSES`: what it reads of the object. Disturbances of other senses do not apply.
    """

    target: str
    summary: str
    needs_images: bool = False
    demands: frozenset[str] = frozenset()
    senses: frozenset[str] = frozenset(SENSES)


METHODS: dict[str, MethodSpec] = {
    "moveit": MethodSpec(
        "minidual.trials.drivers:planned",
        "OMPL in MoveIt 2's role, joint trajectory control",
        senses=frozenset({"pose"}),
    ),
    "impedance": MethodSpec(
        "minidual.trials.drivers:impedance",
        "object impedance with internal force control",
        demands=frozenset({"squeezed"}),
        senses=frozenset({"pose", "feedback"}),
    ),
    "act": MethodSpec(
        "minidual.trials.drivers:policy",
        "ACT policy from camera and joints",
        needs_images=True,
        senses=frozenset({"picture"}),
    ),
}

Factory = Callable[[World, Kinematics, Trial], Method]


def method_spec(name: str) -> MethodSpec:
    """Return the row of a method, or say which exist."""
    if name not in METHODS:
        raise unknown_name("method", name, METHODS)
    return METHODS[name]


def load_factory(name: str, inputs: MethodInputs) -> Factory:
    """Return the trial factory of a method."""
    module, function = method_spec(name).target.split(":")
    make: Any = getattr(importlib.import_module(module), function)
    return make(inputs)


def parse_methods(text: str | Sequence[str]) -> tuple[str, ...]:
    """Return the methods named in `moveit,impedance,act`, each once.

    Raises:
        UsageError: An unknown or repeated name, or none at all.
    """
    names = [n.strip() for n in text.split(",")] if isinstance(text, str) else list(text)
    names = [n for n in names if n]
    if not names:
        raise UsageError("no method named", remedy=f"--methods {','.join(METHODS)}")
    for name in names:
        method_spec(name)
        if names.count(name) > 1:
            raise UsageError(f"method '{name}' is named twice in {','.join(names)}")
    return tuple(names)
