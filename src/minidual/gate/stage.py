"""Inputs and results of stages and tools.

A stage is a function from `StageContext` to `StageResult`: it writes only in `context.folder`,
derives randomness from `context.seed` and returns at least one check with a limit. A tool is a
function from `ToolContext` to `ToolResult`, without a gate.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from minidual.config.root import Config
from minidual.durable import remove, set_aside
from minidual.errors import ExitCode, GateClosedError
from minidual.gate.check import Check
from minidual.gate.place import ResultPlace
from minidual.gate.progress import Progress
from minidual.gate.verdict import Verdict, Waiver


class Folders(dict[str, Path]):
    """{upstream stage: its folder}.

    Raises:
        GateClosedError: A stage has no result, which no waiver replaces.
    """

    def __missing__(self, stage: str) -> Path:
        raise GateClosedError(
            f"it works on the result of {stage}, and there is none",
            remedy=f"minidual {stage}",
        )


@dataclass(frozen=True, kw_only=True)
class Context:
    """Input of a stage or tool; `workers` and `view` must not affect results."""

    config: Config
    seed: int
    profile: str
    progress: Progress = field(default_factory=Progress)
    options: Mapping[str, Any] = field(default_factory=dict[str, Any])
    workers: int = 1
    view: Any = None


@dataclass(frozen=True, kw_only=True)
class StageContext(Context):
    """Input of a stage.

    Attributes:
        folder: Temporary.
        upstream: {upstream stage: its folder}; only those that the stage's row names as inputs.
        verdicts: {upstream stage: its verdict}; none if the stage's row names inputs.
        states: {upstream stage: its state}; closing stages only.
        summaries: {upstream stage: its summary}.
        code_changes: {upstream stage: modules changed since}; closing stages only.
        waivers: Own and inherited.
        pictures: Whether to draw and record what people look at; checks do not depend on it.
    """

    folder: Path
    upstream: Mapping[str, Path] = field(default_factory=dict[str, Path])
    verdicts: Mapping[str, Verdict] = field(default_factory=dict[str, Verdict])
    states: Mapping[str, str] = field(default_factory=dict[str, str])
    summaries: Mapping[str, str] = field(default_factory=dict[str, str])
    code_changes: Mapping[str, Sequence[str]] = field(default_factory=dict[str, Sequence[str]])
    waivers: tuple[Waiver, ...] = ()
    pictures: bool = True


@dataclass(frozen=True)
class StageResult:
    """Result of a stage.

    Attributes:
        checks: Unique names; at least one limit.
        data: JSON types, under about 100 kB.
    """

    checks: Sequence[Check]
    data: Mapping[str, Any] = field(default_factory=dict[str, Any])
    notes: Sequence[str] = ()


StageFunction = Callable[[StageContext], StageResult]


def closing_checks(
    waivers: Sequence[Waiver],
    code_changes: Mapping[str, Sequence[str]],
) -> list[Check]:
    """Return the checks of a closing stage.

    Args:
        waivers: Its own and inherited.
        code_changes: {upstream stage: modules changed since}.
    """
    waived = ", ".join(waiver.stage for waiver in waivers)
    stages = ", ".join(code_changes)
    modules = {module for names in code_changes.values() for module in names}
    some_modules = ", ".join(sorted(modules)[:3])
    return [
        Check(
            "gate.waivers",
            len(waivers),
            "==",
            0,
            why="evidence behind a waived gate is no acceptance",
            remedy=f"run {waived} without --waive-gate" if waivers else "",
        ),
        Check(
            "gate.code_changed",
            len(code_changes),
            "==",
            0,
            why="results of other code is no acceptance",
            remedy=f"run {stages} again with --force ({some_modules} changed)"
            if code_changes
            else "",
        ),
    ]


@dataclass(frozen=True, kw_only=True)
class ToolContext(Context):
    """Input of a tool.

    Attributes:
        run_folder: Need not exist.
        name: Of its output folder.
        gate: Of the run, a `Gate`.
        shipped: Shipped profile that the profile is or extends.
        command: Turns "plan" into the full command.
    """

    run_folder: Path
    name: str
    gate: Any = None
    shipped: str | None = None
    command: Callable[[str], str] = "minidual {}".format

    @property
    def folder(self) -> Path:
        """Final folder of the output."""
        return self.run_folder / self.name

    @property
    def output(self) -> Path:
        """Temporary folder for output, created on first access; `publish` moves it to `folder`."""
        temporary = ResultPlace(self.folder).temporary
        temporary.mkdir(parents=True, exist_ok=True)
        return temporary

    def begin(self) -> None:
        """Remove output of an interrupted run.

        Raises:
            DataError: Something else than a folder is in its place.
        """
        place = ResultPlace(self.folder)
        place.check()
        remove(place.temporary)

    def publish(self) -> None:
        """Move output to its final folder; an earlier one is set aside."""
        place = ResultPlace(self.folder)
        if not place.temporary.is_dir():
            return
        if place.folder.exists():
            self.progress.note(f"the earlier output is in {set_aside(place.folder, self.name)}")
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


def markdown(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return rows of equal keys as a Markdown table."""
    heads = [head.replace("_", " ") for head in rows[0]]
    lines = [_markdown_row(heads), "|" + "---|" * len(heads)]
    return lines + [_markdown_row(map(str, row.values())) for row in rows]


def aligned(rows: Sequence[Mapping[str, str]]) -> list[str]:
    """Return rows of equal keys as a table for a terminal, its columns two spaces apart."""
    table = [list(rows[0]), *(list(row.values()) for row in rows)]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines: list[str] = []
    for cells in table:
        padded = [cell.ljust(width) for cell, width in zip(cells, widths, strict=True)]
        lines.append("  ".join(padded).rstrip())
    return lines


def _markdown_row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"
