"""Commands that are no stage: they show, measure or try something, write no verdict and open no gate.

A tool is a function that takes a `ToolContext` and returns a `ToolResult`; it stands as a row in
`minidual/stages/tools.py` and is a command of its own (`minidual view`), or as an aside in the row of a stage, where
one of its options asks for it instead of the stage (`minidual carry --tune`):

    def tune(context: ToolContext) -> ToolResult:
        from minidual.trials.tuning import tune_impedance  # heavy imports here

        found = tune_impedance(context.config, context.seed, context.progress)
        found.write(context.output / "tuned.yaml")
        return ToolResult(lines=[found.text()], data=found.to_json())

`output` is a temporary folder, renamed to runs/<run>/<name> when the function returns, so that a tool that was
stopped leaves nothing that looks whole.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from minidual.errors import ExitCode
from minidual.gate.progress import Progress, SilentProgress

if TYPE_CHECKING:
    from minidual.config.root import Config


@dataclass(frozen=True)
class ToolContext:
    """All that a tool may know.

    config: the resolved configuration. seed, workers: as in it.
    run_folder: the run that the command names; it need not exist.
    options: what was typed, without what was left out.
    command: turns "plan" into the full command to type, with the profile and run flags in use.
    view: the live view (minidual.show.view.View) of somebody who watches, or None; only where the row says `watchable`.
    """

    config: Config
    seed: int
    workers: int
    profile: str
    run_folder: Path
    options: Mapping[str, Any] = field(default_factory=dict[str, Any])
    progress: Progress = field(default_factory=SilentProgress)
    command: Callable[[str], str] = "minidual {}".format
    _name: str = ""
    view: Any = None

    @property
    def folder(self) -> Path:
        """Where what the tool writes will be when it has ended."""
        return self.run_folder / self._name

    @property
    def output(self) -> Path:
        """The folder to write into, made when first asked for."""
        temporary = self.run_folder / f".{self._name}.tmp"
        temporary.mkdir(parents=True, exist_ok=True)
        return temporary

    def begin(self) -> None:
        """Drop what a tool that was stopped left behind."""
        shutil.rmtree(self.run_folder / f".{self._name}.tmp", ignore_errors=True)

    def publish(self) -> None:
        """Put the output in its place, if there is any."""
        temporary = self.run_folder / f".{self._name}.tmp"
        if temporary.is_dir():
            shutil.rmtree(self.folder, ignore_errors=True)
            temporary.rename(self.folder)


@dataclass(frozen=True)
class ToolResult:
    """What a tool has to say.

    lines: for stdout, where data goes (without --json).
    notes: for stderr, where people read.
    data: the one document that --json prints.
    exit_code: ACCEPTANCE_FAILED where a limit that the tool itself states does not hold.
    """

    lines: Sequence[str] = ()
    notes: Sequence[str] = ()
    data: Mapping[str, Any] = field(default_factory=dict[str, Any])
    exit_code: ExitCode = ExitCode.PASS


ToolFunction = Callable[[ToolContext], ToolResult]
