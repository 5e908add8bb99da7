"""Printed tables and explanations."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from minidual.gate.check import Check, format_number
from minidual.gate.gate import StageState
from minidual.gate.runner import Outcome
from minidual.gate.table import StageEntry
from minidual.gate.verdict import Verdict

_STYLES = {
    "pass": "bold green",
    "fail": "bold red",
    "error": "bold red",
    "stale": "yellow",
    "incomplete": "yellow",
    "blocked": "dim",
    "missing": "dim",
}
_SHOWN_ARTEFACTS = 8


def state_text(state: str) -> Text:
    """Return a coloured state."""
    return Text(state, style=_STYLES.get(state, ""))


def margin_text(check: Check) -> str:
    """Return the signed margin, and as a share of a nonzero limit."""
    margin = check.margin
    if margin is None or margin != margin:
        return ""
    share = f" ({margin / abs(check.limit):+.0%})" if check.limit and check.op != "==" else ""
    return f"{margin:+.3g}{share}"


def checks_table(checks: Sequence[Check], title: str, *, explained: bool = False) -> Table:
    """Return the table of checks; with why and remedy if `explained`."""
    table = Table(title=title, title_justify="left", show_lines=explained)
    for header in ("check", "observed", "limit", "margin", "result"):
        table.add_column(header, justify="left" if header in ("check", "result") else "right", overflow="fold")
    if explained:
        table.add_column("why, and what to do", overflow="fold", ratio=1)
    for check in checks:
        unit = f" {check.unit}" if check.unit else ""
        result = {True: Text("pass", "green"), False: Text("FAIL", "bold red"), None: Text("reported", "dim")}
        row: list[str | Text] = [
            check.name,
            f"{format_number(check.observed)}{unit}",
            f"{check.op} {format_number(check.limit)}{unit}" if check.op else "",
            margin_text(check),
            result[check.passed],
        ]
        if explained:
            row.append(check.why + (f"\n{check.remedy}" if check.passed is False and check.remedy else ""))
        table.add_row(*row)
    return table


def label(verdict: Verdict) -> str:
    """Return why a verdict is no acceptance, if so."""
    words = [] if verdict.acceptance_profile else [f"profile '{verdict.profile}': wiring only, never acceptance"]
    words += [f"asks for less than the profile, no acceptance: {line}" for line in verdict.weakened]
    words += [f"GATE WAIVED at {waiver.stage}: {waiver.reason}" for waiver in verdict.waivers]
    return "; ".join(words)


def print_outcome(console: Console, outcome: Outcome, following: str) -> None:
    """Print checks, notes, artefacts and next command."""
    verdict, state = outcome.verdict, outcome.state
    title = f"{state.name}: {verdict.status}, {'fresh' if not outcome.ran else f'{verdict.duration_s:.1f} s'}"
    console.print(checks_table(verdict.checks, title))
    _line(console, label(verdict), "yellow")
    for note in verdict.notes:
        _line(console, note)
    for warning in state.warnings:
        _line(console, f"note: {warning}", "dim")
    print_artefacts(console, state)
    _line(console, following)


def print_artefacts(console: Console, state: StageState) -> None:
    """Print artefact paths."""
    if state.verdict is None or state.folder is None:
        return
    names = list(state.verdict.artefacts)
    for name in names[:_SHOWN_ARTEFACTS]:
        _line(console, f"  {state.folder / name}")
    if len(names) > _SHOWN_ARTEFACTS:
        _line(console, f"  and {len(names) - _SHOWN_ARTEFACTS} more under {state.folder}")


def print_status(console: Console, states: Sequence[StageState], title: str, following: str) -> None:
    """Print one line per stage."""
    table = Table(title=title, title_justify="left")
    table.add_column("stage", no_wrap=True)
    table.add_column("state", no_wrap=True)
    table.add_column("checks", justify="right")
    table.add_column("took", justify="right")
    table.add_column("remarks", overflow="fold")
    for state in states:
        verdict = state.verdict
        checks = took = ""
        remarks = [state.why()] if state.why() else []
        if verdict is not None:
            limited = [check for check in verdict.checks if check.limited]
            checks = f"{sum(check.passed is True for check in limited)}/{len(limited)}"
            took = f"{verdict.duration_s:.1f} s"
            remarks += [text for text in (label(verdict), *state.warnings) if text]
        table.add_row(state.name, state_text(state.state), checks, took, Text("\n".join(remarks)))
    console.print(table)
    _line(console, following)


def print_explanation(
    console: Console, entry: StageEntry, state: StageState, upstream: Sequence[StageState], following: str
) -> None:
    """Print all about one stage."""
    console.print(Text.assemble((entry.name, "bold"), " is ", state_text(state.state), f". {entry.summary}."))
    for item in upstream:
        console.print(Text.assemble("  requires ", item.name, ": ", state_text(item.state)))
    if not upstream:
        _line(console, "  requires no other stage")
    for reason in state.reasons:
        _line(console, f"  {reason}", "yellow")
    for warning in state.warnings:
        _line(console, f"  note: {warning}", "dim")
    if state.verdict is not None:
        verdict = state.verdict
        made = f"verdict: {verdict.status}, {verdict.finished_at}, profile '{verdict.profile}'"
        console.print(checks_table(verdict.checks, f"{made}, seed {verdict.fingerprint.seed}", explained=True))
        _line(console, label(verdict), "yellow")
        for text in verdict.overrides:
            _line(console, f"  made with {text}")
        for note in verdict.notes:
            _line(console, f"  {note}")
        print_artefacts(console, state)
    _line(console, following)


def _line(console: Console, text: str, style: str = "") -> None:
    if text:
        console.print(Text(text, style=style), soft_wrap=True)
