"""Kinds of policy, named by "type" in config.json, and records of their training."""

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from minidual.config.learning import TrainConfig
from minidual.durable import read_json, reading, write_csv
from minidual.errors import DataError, EnvironmentMissingError
from minidual.policies.chunk_policy import ChunkPolicy
from minidual.policies.demonstrations import Demonstrations
from minidual.policies.instructed import InstructedPolicy
from minidual.policies.takes import read_takes
from minidual.registry import Registry

Advance = Callable[[int, float], None]
"""Arguments: steps since the last call, loss."""
REMEDY = "minidual train-act"


@dataclass(frozen=True)
class LossRow:
    """Means since the last row, and validation if it was due.

    Attributes:
        l1: Of `diffusion`, mean squared error of the denoised actions.
    """

    step: int
    loss: float
    l1: float
    keyframe: float | None
    learning_rate: float
    validation_l1: float | None = None
    validation_keyframe_rad: float | None = None


@dataclass
class TrainResult:
    """A training summary; L1 in units of the action's std."""

    steps: int
    steps_asked: int
    train_s: float
    samples_per_s: float
    parameters: int
    loss_initial: float
    loss_final: float
    loss_ratio: float
    training_episodes: list[int]
    validation_episodes: list[int]
    ticks: int
    validation_l1: float | None = None
    validation_keyframe_rad: float | None = None
    bf16: bool = False
    architecture: str = ""
    """Name of the network in tables and reports; empty: that of the kind."""
    resumed_from_step: int = 0
    set_aside: Path | None = None
    """Damaged progress or that of another training, moved here."""
    stopped_by: str = "steps"
    curve: list[LossRow] = field(default_factory=list)


class Training(NamedTuple):
    """Inputs of a training; `progress` is the file of an interrupted one."""

    demos: Demonstrations
    config: TrainConfig
    seed: int
    progress: Path | None = None
    advance: Advance = lambda steps, loss: None


class PolicyKind(ABC):
    """Trains and loads policies."""

    def require(self, device: str) -> None:  # noqa: B027 (most kinds run anywhere)
        """Raise EnvironmentMissingError if `device` is unusable."""

    @abstractmethod
    def train(self, job: Training, folder: Path) -> TrainResult:
        """Train and write a new checkpoint `folder` atomically.

        On a CPU, equal inputs give equal checkpoints.

        Raises:
            DataError, UsageError: Unusable dataset, existing `folder`, or the training diverges.
            EnvironmentMissingError: Missing device.
        """

    @abstractmethod
    def load(self, folder: Path, device: str, threads: int | None) -> ChunkPolicy:
        """Load a checkpoint offline; `threads` None leaves the libraries' default.

        Raises:
            DataError: Missing or corrupt checkpoint.
            EnvironmentMissingError: Missing device.
        """


POLICIES: Registry[PolicyKind] = Registry("policy", group="minidual.policies")
"""Policies by `train.policy`; those of other distributions are entry points of the group."""
# By name, because their modules import torch and LeRobot.
POLICIES.add("spatial_act", "minidual.policies.act:SPATIAL_ACT")
POLICIES.add("act", "minidual.policies.act:ACT_KIND")
POLICIES.add("spatial_diffusion", "minidual.policies.diffusion:SPATIAL_DIFFUSION")
POLICIES.add("diffusion", "minidual.policies.diffusion:DIFFUSION")
_OTHERS: Registry[PolicyKind] = Registry("policy")
"""Policies that are not trained here: behind a socket, and whatever LeRobot can load."""
_OTHERS.add("server", "minidual.policies.server:SERVER")
_OTHERS.add("lerobot", "minidual.policies.foreign:FOREIGN")


_LIBRARIES: dict[str, tuple[str, str]] = {
    "spatial_diffusion": ("diffusers", "diffusion"),
    "diffusion": ("diffusers", "diffusion"),
}
"""Library and extra of this package, by policy: of those that need more than LeRobot does."""


def require_library(policy: str) -> None:
    """Raise EnvironmentMissingError if a row of POLICIES needs a library that is not installed."""
    library, extra = _LIBRARIES.get(policy, ("", ""))
    if library and find_spec(library) is None:
        raise EnvironmentMissingError(
            f"the policy '{policy}' needs the library '{library}', which is not installed",
            remedy=f"pip install 'minidual[{extra}]'",
        )


def load_policy(folder: Path, device: str = "cpu", threads: int | None = None) -> ChunkPolicy:
    """Load any checkpoint: of a row of POLICIES, else of a type that LeRobot knows.

    Raises:
        DataError, EnvironmentMissingError: See `PolicyKind.load`.
    """
    if not folder.is_dir():
        raise DataError(f"there is no checkpoint folder {folder}", remedy=REMEDY)
    with reading(f"checkpoint {folder}", f"{REMEDY} --force"):
        kind = read_json(folder / "config.json")["type"]
        if not isinstance(kind, str):
            raise ValueError(f"its type is {kind!r}; it must be a name")
    if kind in POLICIES:
        row = POLICIES[kind]
    else:
        row = _OTHERS[kind if kind in _OTHERS else "lerobot"]
    policy = row.load(folder, device, threads)
    takes = read_takes(folder)
    if takes is None:
        return policy
    if takes.instructions:
        policy = InstructedPolicy(policy, takes.instructions)
    policy.inputs = takes.inputs
    return policy


def write_loss_csv(curve: Sequence[LossRow], path: Path) -> None:
    """Write the loss curve; no times, so equal seeds give equal files."""
    rows: list[dict[str, object]] = []
    for loss_row in curve:
        rows.append({name: _six_digits(value) for name, value in asdict(loss_row).items()})
    write_csv(path, rows)


def _six_digits(value: object) -> object:
    return f"{value:.6g}" if isinstance(value, float) else value


def write_train_json(result: TrainResult, extra: dict[str, Any], path: Path) -> dict[str, Any]:
    """Write and return the summary."""
    record = asdict(result)
    del record["curve"]
    del record["set_aside"]
    record |= extra
    path.write_text(json.dumps(record, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return record
