"""What a stage is given and what it returns.

A stage is a function and a row in `minidual/stages/registry.py` (see docs/howto-stage.md):

    def run(context: StageContext) -> StageResult:
        rate = measure(context.config.carry, context.seed)
        (context.folder / "trials.csv").write_text(...)
        return StageResult(checks=[Check("success_rate", rate, ">=", 0.8, why="the carry must be repeatable")])

Rules: write only under `context.folder`, a temporary folder that is renamed when the stage is done. Read upstream
artefacts through `context.upstream`. Draw randomness from `context.seed` alone. Raise errors of `minidual.errors` for
what a user can mend. Return at least one check with a limit.
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
    """All that a stage may know about the run.

    Attributes:
        folder: Temporary folder for artefacts; empty but for `config.yaml`.
        config: The resolved configuration, command-line options applied.
        seed: The one seed of the run.
        profile: Name of the profile, or the stem of its file.
        upstream: {stage: finished folder} of every stage required, directly or not. All are passing and fresh unless
            the gate was waived.
        verdicts: The verdicts in those folders.
        summaries: {stage: one line} of those stages, in the order of the table.
        code_changes: {stage: modules} of those stages whose results other code made.
        waivers: Waivers that taint this stage, its own and inherited.
        options: Options of the command that stand for no configuration value, as typed.
        workers: Processes that the stage may use; results must not depend on it.
        view: The live view of somebody who watches, or None. Results must not depend on it.
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
    """What a stage found. The status is derived from `checks`; a stage cannot assign it.

    Attributes:
        checks: At least one with a limit; names unique.
        artefacts: Files or folders relative to the context's folder for the manifest; default: every file in it.
        data: Numbers for the report, as JSON types, under about 100 kB.
        notes: Lines for people.
    """

    checks: Sequence[Check]
    artefacts: Sequence[str] | None = None
    data: Mapping[str, Any] = field(default_factory=dict[str, Any])
    notes: Sequence[str] = ()


StageFunction = Callable[[StageContext], StageResult]
