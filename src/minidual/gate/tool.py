"""Tools: commands without verdict or gate.

A tool is a function from `ToolContext` to `ToolResult`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from minidual.durable import remove, set_aside
from minidual.errors import ExitCode
from minidual.gate.progress import Progress
from minidual.gate.store import Place

if TYPE_CHECKING:
    from minidual.config.root import Config


@dataclass(frozen=True)
class ToolContext:
    """Input of a tool.

    Attributes:
        run_folder: Need not exist.
        command: Turns "plan" into the full command.
    """

    config: Config
    seed: int
    workers: int
    profile: str
    run_folder: Path
    options: Mapping[str, Any] = field(default_factory=dict[str, Any])
    progress: Progress = field(default_factory=Progress)
    command: Callable[[str], str] = "minidual {}".format
    _name: str = ""
    view: Any = None

    @property
    def folder(self) -> Path:
        """Final folder of the output."""
        return self.run_folder / self._name

    @property
    def output(self) -> Path:
        """Temporary folder for output, created on first access; `publish` moves it to `folder`."""
        temporary = self._place.temporary
        temporary.mkdir(parents=True, exist_ok=True)
        return temporary

    @property
    def _place(self) -> Place:
        return Place(self.folder)

    def begin(self) -> None:
        """Remove output of an interrupted run; DataError if something else than a folder is in its place."""
        self._place.check()
        remove(self._place.temporary)

    def publish(self) -> None:
        """Move output to its final folder; an earlier one is set aside."""
        place = self._place
        if place.temporary.is_dir():
            if place.folder.exists():
                self.progress.note(f"the earlier output is in {set_aside(place.folder, self._name)}")
            place.temporary.rename(place.folder)


@dataclass(frozen=True)
class ToolResult:
    """Result of a tool.

    Attributes:
        lines: Printed to stdout, or `data` with --json; `notes` to stderr.
        exit_code: ACCEPTANCE_FAILED if a limit is exceeded.
    """

    lines: Sequence[str] = ()
    notes: Sequence[str] = ()
    data: Mapping[str, Any] = field(default_factory=dict[str, Any])
    exit_code: ExitCode = ExitCode.PASS


ToolFunction = Callable[[ToolContext], ToolResult]
