"""The contract between a stage and the gate.

A stage lives in `minidual/stages/<name_with_underscores>.py` as the module attribute `STAGE`, and stands in
the table of `minidual/stages/registry.py`. It calls the domain and turns numbers into checks; everything
else (gate, fingerprint, temporary folder, verdict, exit code, tables) is done around it:

    class PlanStage:
        name = "plan"
        requires = ("env-check",)
        summary = "Plan collision-free motions for three groups"

        def parameters(self, config: Config) -> dict[str, Any]:
            return {"plan": config.plan, "scene": config.scene}

        def run(self, context: StageContext) -> StageResult:
            from minidual.trials.planning import evaluate  # heavy imports here, never at the top of the module

            with context.progress.task("queries", 60) as task:
                results = evaluate(context.config.plan, context.seed, on_query=task.advance)
            (context.folder / "queries.json").write_text(results.to_json())
            return StageResult(checks=[Check("both_arms.success_rate", results.rate, ">=", 1.0, ...)])

    STAGE = PlanStage()

Rules: write only under `context.folder` (a temporary folder, renamed when the stage is done, so artefacts
hold paths relative to it, never absolute ones); read upstream artefacts through `context.upstream`; draw
randomness from `context.seed` alone; raise errors of `minidual.errors` for what a user can mend; return at
least one check with a limit. Status asks `parameters` of every stage, so the module must import in
milliseconds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from minidual.gate.check import Check
from minidual.gate.progress import Progress, SilentProgress

if TYPE_CHECKING:
    from minidual.config.root import Config
    from minidual.gate.verdict import Verdict, Waiver


@dataclass(frozen=True)
class StageContext:
    """All that a stage may know about the run.

    folder: temporary folder for artefacts; it exists and is empty but for `config.yaml`.
    config: the resolved configuration, command-line options already applied.
    seed: the one seed of the run (the same as config.seed).
    profile: name of the profile ("smoke", "standard", "gpu", or the stem of a file).
    upstream: finished folder of every transitively required stage that has one. All of them are there,
        passing and fresh, unless the gate was waived.
    verdicts: the verdicts in those folders.
    waivers: waivers that taint this stage, its own and inherited; empty in an honest run.
    options: command-line extras of this stage as typed, for example {"episodes": 50}.
    workers: how many processes the stage may use; results must not depend on it.
    view: the live view (minidual.show.view.View) of somebody who watches, or None. Opaque here; it is no parameter and
        enters no fingerprint, and what a stage finds must not depend on it.
    """

    folder: Path
    config: Config
    seed: int
    profile: str
    upstream: Mapping[str, Path] = field(default_factory=dict[str, Path])
    verdicts: Mapping[str, Verdict] = field(default_factory=lambda: dict[str, "Verdict"]())
    waivers: tuple[Waiver, ...] = ()
    progress: Progress = field(default_factory=SilentProgress)
    options: Mapping[str, Any] = field(default_factory=dict[str, Any])
    workers: int = 1
    view: Any = None


@dataclass(frozen=True)
class StageResult:
    """What a stage found. The status is derived from `checks`; a stage cannot assign it.

    checks: at least one with a limit, names unique.
    artefacts: files or folders relative to the context's folder to list in the manifest; default: every
        file in it. Listed files are hashed, so that tampering is seen.
    data: numbers for the report, as JSON can hold them, small (say under 100 kB).
    notes: lines for people.
    """

    checks: Sequence[Check]
    artefacts: Sequence[str] | None = None
    data: Mapping[str, Any] = field(default_factory=dict[str, Any])
    notes: Sequence[str] = ()


class Stage(Protocol):
    """One command of the pipeline. See the module's text for an example and the rules."""

    @property
    def name(self) -> str:
        """Name as typed: "env-check"."""
        ...

    @property
    def requires(self) -> tuple[str, ...]:
        """Stages whose passing, fresh verdicts open the gate of this one."""
        ...

    @property
    def summary(self) -> str:
        """One line for the help text."""
        ...

    def parameters(self, config: Config) -> dict[str, Any]:
        """Return the part of the configuration that the result depends on.

        Values may be pydantic models, paths, enums and tuples; they become JSON. A change here makes the
        verdict stale, so leave out what does not change the result (`workers`, cosmetic switches). The
        seed and the profile are always part of the fingerprint.
        """
        ...

    def run(self, context: StageContext) -> StageResult:
        """Do the work and return checks; see the rules above."""
        ...


@runtime_checkable
class HasInputs(Protocol):
    """A stage that also reads files from outside the run: their hashes enter its fingerprint."""

    def inputs(self, config: Config) -> Sequence[Path]:
        """Return the files that the result depends on and that no stage wrote."""
        ...


@runtime_checkable
class Validates(Protocol):
    """A stage that can tell from the configuration alone that it could not run."""

    def validate(self, config: Config) -> None:
        """Raise an error of `minidual.errors` for a name or value that the models cannot know to be wrong.

        Called before the gate is looked at, and for every stage before the first of a whole run begins: an
        unknown method must not come to light after half an hour of training.
        """
        ...
