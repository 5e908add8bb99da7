"""The terminal: printed tables and explanations, and progress on stderr: bars on a terminal, plain lines elsewhere."""

import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Self

from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as RichBars
from rich.segment import Segment
from rich.table import Column, Table
from rich.text import Text

from minidual.errors import printable
from minidual.gate.check import Check, with_unit
from minidual.gate.gate import Gate
from minidual.gate.progress import Progress, ProgressTask
from minidual.gate.runner import StageOutcome
from minidual.gate.state import StageState
from minidual.gate.table import StageEntry
from minidual.gate.verdict import Verdict

_STYLES = {
    "pass": "bold green",
    "fail": "bold red",
    "error": "bold red",
    "stale": "yellow",
    "incomplete": "yellow",
}
_SHOWN_ARTEFACTS = 8


class SafeConsole(Console):
    """Shows no control sequence of what it prints; its own colours and bars stay."""

    def render(
        self,
        renderable: RenderableType,
        options: ConsoleOptions | None = None,
    ) -> Iterable[Segment]:
        """Yield segments without control and direction characters."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=printable(segment.text))


def console(*, stderr: bool) -> Console:
    """Return a console on stderr or stdout."""
    stream = sys.stderr if stderr else sys.stdout
    # Off a terminal rich assumes 80 columns, if COLUMNS does not say so, and would fold log lines.
    known = stream.isatty() or "COLUMNS" in os.environ
    return SafeConsole(stderr=stderr, highlight=False, width=None if known else 160)


class BarTask(ProgressTask):
    """One bar; nested tasks draw theirs below."""

    def __init__(self, console: Console, description: str, total: float | None) -> None:
        columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
        texts = TextColumn("{task.description}"), TextColumn("{task.fields[note]}")
        self._bars = RichBars(texts[0], *columns, texts[1], console=console)
        self._bar = self._bars.add_task(description, total=total, note="")

    def advance(self, steps: float = 1, note: str = "") -> None:
        """See `ProgressTask`."""
        self._bars.update(self._bar, advance=steps)
        if note:
            self._bars.update(self._bar, note=note)

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bars.stop()


class ConsoleProgress(Progress):
    """Bars on a terminal, plain lines elsewhere."""

    def __init__(self, console: Console) -> None:
        super().__init__(
            lambda line: console.print(line, markup=False, highlight=False, soft_wrap=True),
        )
        self._console = console

    def task(self, description: str, total: float | None = None) -> ProgressTask:
        """Begin a bar or plain lines."""
        bars = self._console.is_terminal
        return (
            BarTask(self._console, description, total) if bars else super().task(description, total)
        )


def state_text(state: str) -> Text:
    """Return a coloured state."""
    return Text(state, style=_STYLES.get(state, "dim"))


Wording = Callable[[str], str]
"""Completes the commands of a remedy."""


def checks_table(checks: Sequence[Check], title: str, explained: Wording | None = None) -> Table:
    """Return a table; with why and remedy if `explained`."""
    table = Table(title=title, title_justify="left", show_lines=explained is not None)
    for header in ("check", "observed", "limit", "margin", "result"):
        table.add_column(
            header,
            justify="left" if header in ("check", "result") else "right",
            overflow="fold",
        )
    if explained:
        table.add_column("why, and what to do", overflow="fold", ratio=1)
    result = {
        True: Text("pass", "green"),
        False: Text("FAIL", "bold red"),
        None: Text("reported", "dim"),
    }
    for check in checks:
        limit = f"{check.op} {with_unit(check.limit, check.unit)}" if check.op else ""
        row = [
            check.name,
            with_unit(check.observed, check.unit),
            limit,
            check.margin_text(),
            result[check.passed],
        ]
        if explained:
            row.append(
                explained(
                    check.why
                    + (f"\n{check.remedy}" if check.passed is False and check.remedy else ""),
                ),
            )
        table.add_row(*row)
    return table


def label(verdict: Verdict) -> str:
    """Return why a verdict is no acceptance; empty if it is."""
    profile = verdict.fingerprint.profile
    words = (
        []
        if verdict.acceptance_profile
        else [f"profile '{profile}': wiring only, never acceptance"]
    )
    if verdict.weakened:
        words.append(
            f"NO ACCEPTANCE, it asks for less than the profile: {'; '.join(verdict.weakened)}",
        )
    words += [f"GATE WAIVED at {waiver.stage}: {waiver.reason}" for waiver in verdict.waivers]
    return "; ".join(words)


def print_outcome(console: Console, outcome: StageOutcome, following: str) -> None:
    """Print a result and the next command."""
    verdict = outcome.verdict
    took = f"{verdict.duration_s:.1f} s" if outcome.ran else "fresh"
    _print_verdict(console, outcome.state, verdict, f"{verdict.stage}: {verdict.status}, {took}")
    _lines(console, [following])


def print_explanation(
    console: Console,
    entry: StageEntry,
    state: StageState,
    upstream: Mapping[str, str],
    wording: Wording,
) -> None:
    """Print one stage; `upstream` is {required stage: state}."""
    console.print(
        Text.assemble((entry.name, "bold"), " is ", state_text(state.state), f". {entry.summary}."),
    )
    for name, its in upstream.items():
        console.print(Text.assemble("  requires ", name, ": ", state_text(its)))
    if not upstream:
        _lines(console, ["  requires no other stage"])
    _lines(console, [f"  {reason}" for reason in state.reasons], "yellow")
    if (verdict := state.verdict) is not None:
        made = verdict.fingerprint
        title = f"verdict: {verdict.status}, {verdict.finished_at}, profile '{made.profile}', seed {made.seed}"
        _print_verdict(console, state, verdict, title, wording)
        _lines(console, [f"made with {text}" for text in verdict.overrides])


def _print_verdict(
    console: Console,
    state: StageState,
    verdict: Verdict,
    title: str,
    explained: Wording | None = None,
) -> None:
    console.print(checks_table(verdict.checks, title, explained))
    _lines(console, [label(verdict)], "bold yellow")
    _lines(console, verdict.notes)
    _lines(console, [f"note: {warning}" for warning in state.warnings], "dim")
    names = list(verdict.artefacts)
    folder = state.folder
    if folder is not None:
        _lines(console, [f"  {folder / name}" for name in names[:_SHOWN_ARTEFACTS]])
        if len(names) > _SHOWN_ARTEFACTS:
            _lines(console, [f"  and {len(names) - _SHOWN_ARTEFACTS} more under {folder}"])


def print_status(console: Console, gate: Gate, title: str, following: str) -> None:
    """Print one row per stage."""
    names = [Column(header, no_wrap=True) for header in ("stage", "state")]
    numbers = [Column(header, justify="right") for header in ("checks", "took")]
    table = Table(
        *names,
        *numbers,
        Column("remarks", overflow="fold"),
        title=title,
        title_justify="left",
    )
    for state in map(gate.state, gate.table):
        verdict = state.verdict
        checks = took = ""
        remarks = [state.why()]
        if verdict is not None:
            results = [check.passed for check in verdict.checks if check.passed is not None]
            checks = f"{sum(results)}/{len(results)}"
            took = f"{verdict.duration_s:.1f} s"
            remarks += [label(verdict), *state.warnings]
        table.add_row(
            state.name,
            state_text(state.state),
            checks,
            took,
            Text("\n".join(filter(None, remarks))),
        )
    console.print(table)
    _lines(console, [following])


def print_lowest(
    console: Console,
    lowest: StageState | None,
    following: str,
    wording: Wording,
) -> None:
    """Print the first stage that does not pass, why, and the next command."""
    if lowest is not None:
        _lines(
            console,
            [f"look at {lowest.name} first: the lowest stage that does not pass"],
            "bold",
        )
        _lines(console, [f"  {wording(line)}" for line in lowest.because()])
    _lines(console, [following])


def _lines(console: Console, lines: Sequence[str], style: str = "") -> None:
    for line in filter(None, lines):
        console.print(Text(line, style=style), soft_wrap=True)
