"""A stage: a function from `StageContext` to `StageResult`. A tool: from `ToolContext` to `ToolResult`, without a gate.

A stage writes only in `context.folder`, derives randomness from `context.seed` and returns at least one check with a
limit.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from minidual.config.root import Config
from minidual.durable import remove, set_aside
from minidual.errors import ExitCode, GateClosedError
from minidual.gate.check import Check
from minidual.gate.store import ResultPlace
from minidual.gate.verdict import Verdict, Waiver

_EVERY_S = 10.0


class ProgressTask(AbstractContextManager["ProgressTask"]):
    """Counted work, a context manager. Prints a line at most every 10 s, and one at the end."""

    def __init__(self, description: str, total: float | None, say: Callable[[str], None]) -> None:
        self._description = description
        self._total = total
        self._say = say
        self._done = 0.0
        self._note = ""
        self._first: tuple[float, float] | None = (
            None  # time and count of the first call, of earlier work perhaps
        )
        self._started = self._last = time.monotonic()

    def advance(self, steps: float = 1, note: str = "") -> None:
        """Count `steps`; `note` ("loss 0.12") is shown beside the count."""
        self._done += steps
        self._note = note or self._note
        now = time.monotonic()
        self._first = self._first or (now, self._done)
        if now - self._last >= _EVERY_S:
            self._last = now
            self._say(self._line(now))

    def _line(self, now: float) -> str:
        of = "" if self._total is None else f"/{self._total:g}"
        line = f"{self._description}: {self._done:g}{of}, {now - self._started:.0f} s"
        since, before = self._first or (now, self._done)
        if self._total is not None and before < self._done < self._total:
            line += f", about {(now - since) * (self._total - self._done) / (self._done - before):.0f} s left"
        return f"{line}, {self._note}" if self._note else line

    def __exit__(self, *error: object) -> None:
        self._say(self._line(time.monotonic()) + (" (stopped)" if any(error) else ""))


class Progress:
    """Plain lines through `say`; silent by default."""

    def __init__(self, say: Callable[[str], None] = lambda line: None) -> None:
        self.note = say
        """Shows one line."""

    def task(self, description: str, total: float | None = None) -> ProgressTask:
        """Begin a task: `with progress.task("trials", 20) as task: ... task.advance()`."""
        return ProgressTask(description, total, self.note)


class Folders(dict[str, Path]):
    """{upstream stage: its folder}; GateClosedError for a stage without result, which no waiver replaces."""

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
        upstream: {upstream stage: its folder}.
        code_changes: {upstream stage: modules changed since}; closing stages only.
        waivers: Own and inherited.
    """

    folder: Path
    upstream: Mapping[str, Path] = field(default_factory=dict[str, Path])
    verdicts: Mapping[str, Verdict] = field(default_factory=dict[str, Verdict])
    summaries: Mapping[str, str] = field(default_factory=dict[str, str])
    code_changes: Mapping[str, Sequence[str]] = field(default_factory=dict[str, Sequence[str]])
    waivers: tuple[Waiver, ...] = ()


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


def closing_checks(
    waivers: Sequence[Waiver],
    code_changes: Mapping[str, Sequence[str]],
) -> list[Check]:
    """Return the checks of a closing stage; `code_changes` is {upstream stage: modules changed since}."""
    waived = ", ".join(waiver.stage for waiver in waivers)
    stages = ", ".join(code_changes)
    modules = ", ".join(sorted({module for names in code_changes.values() for module in names})[:3])
    rerun = f"run {stages} again with --force ({modules} changed)"
    rows = (
        (
            "gate.waivers",
            waivers,
            "evidence behind a waived gate",
            f"run {waived} without --waive-gate",
        ),
        ("gate.code_changed", code_changes, "results of other code", rerun),
    )
    return [
        Check(
            name,
            len(found),
            "==",
            0,
            why=f"{what} is no acceptance",
            remedy=mend if found else "",
        )
        for name, found, what, mend in rows
    ]


StageFunction = Callable[[StageContext], StageResult]


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
        """Remove output of an interrupted run; DataError if something else than a folder is in its place."""
        place = ResultPlace(self.folder)
        place.check()
        remove(place.temporary)

    def publish(self) -> None:
        """Move output to its final folder; an earlier one is set aside."""
        place = ResultPlace(self.folder)
        if place.temporary.is_dir():
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
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    return lines + ["| " + " | ".join(str(v) for v in row.values()) + " |" for row in rows]
