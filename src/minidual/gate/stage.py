"""Input and output of a stage.

A stage is a function and a row in `minidual/stages/registry.py` (see docs/howto-stage.md):

    def run(context: StageContext) -> StageResult:
        rate = measure(context.config.carry, context.seed)
        return StageResult(checks=[Check("success_rate", rate, ">=", 0.8, why="...")])

Write only under `context.folder`, read upstream artefacts through `context.upstream`, seed all randomness from
`context.seed`, raise `minidual.errors` for what a user can fix, and return a limited check.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from minidual.gate.check import Check
from minidual.gate.progress import Progress, SilentProgress

if TYPE_CHECKING:
    from minidual.config.root import Config
    from minidual.gate.verdict import Verdict, Waiver


@dataclass(frozen=True)
class StageContext:
    """Input of a stage.

    Attributes:
        folder: Temporary artefact folder; holds only `config.yaml` at first.
        config: Resolved configuration, options applied.
        profile: Name of the profile.
        upstream: {stage: finished folder} of all required stages, direct or not; passing and fresh unless waived.
        verdicts: Their verdicts.
        summaries: {stage: one line}, in table order.
        code_changes: {stage: modules} for results of other code; closing stages only.
        waivers: Own and inherited waivers.
        options: Command-line options.
        workers: Processes allowed; must not affect results.
        view: Live view or None; must not affect results.
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
    progress: Progress = field(default_factory=SilentProgress)
    options: Mapping[str, Any] = field(default_factory=dict[str, Any])
    workers: int = 1
    view: Any = None


@dataclass(frozen=True)
class StageResult:
    """Result of a stage; its status is derived from `checks`.

    Attributes:
        checks: Unique names, at least one limit.
        artefacts: Paths relative to the folder; default: all files.
        data: JSON types for the report, under about 100 kB.
        notes: Lines for people.
    """

    checks: Sequence[Check]
    artefacts: Sequence[str] | None = None
    data: Mapping[str, Any] = field(default_factory=dict[str, Any])
    notes: Sequence[str] = ()


StageFunction = Callable[[StageContext], StageResult]
