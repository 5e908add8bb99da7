"""Input and output of a stage.

A stage is a function from `StageContext` to `StageResult` and a row in `minidual/stages/registry.py`. It writes only
under `context.folder`, seeds randomness from `context.seed` and returns a limited check.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from minidual.gate.check import Check
from minidual.gate.progress import Progress

if TYPE_CHECKING:
    from minidual.config.root import Config
    from minidual.gate.verdict import Verdict, Waiver


@dataclass(frozen=True)
class StageContext:
    """Input of a stage; `workers` and `view` must not affect results.

    Attributes:
        folder: Temporary artefact folder.
        config: Resolved configuration, options applied.
        upstream: {stage: finished folder} of all required stages.
        code_changes: {stage: modules} changed since; closing stages only.
        waivers: Own and inherited waivers.
    """

    folder: Path
    config: Config
    seed: int
    profile: str
    upstream: Mapping[str, Path] = field(default_factory=dict[str, Path])
    verdicts: Mapping[str, Verdict] = field(default_factory=lambda: dict[str, "Verdict"]())
    summaries: Mapping[str, str] = field(default_factory=dict[str, str])
    code_changes: Mapping[str, Sequence[str]] = field(default_factory=dict[str, Sequence[str]])
    waivers: tuple[Waiver, ...] = ()
    progress: Progress = field(default_factory=Progress)
    options: Mapping[str, Any] = field(default_factory=dict[str, Any])
    workers: int = 1
    view: Any = None


@dataclass(frozen=True)
class StageResult:
    """Result of a stage; its status is derived.

    Attributes:
        checks: Unique names, at least one limit.
        data: JSON types, under about 100 kB.
    """

    checks: Sequence[Check]
    data: Mapping[str, Any] = field(default_factory=dict[str, Any])
    notes: Sequence[str] = ()


StageFunction = Callable[[StageContext], StageResult]
