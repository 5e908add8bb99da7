"""Tables and explanations for people."""

from collections.abc import Callable, Mapping, Sequence

from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from minidual.gate.check import Check, with_unit
from minidual.gate.gate import Gate
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
_RESULTS = {
    True: Text("pass", "green"),
    False: Text("FAIL", "bold red"),
    None: Text("reported", "dim"),
}
_SHOWN_ARTEFACTS = 8

Wording = Callable[[str], str]
"""Completes the commands of a remedy."""


def state_text(state: str) -> Text:
    """Return a coloured state."""
    return Text(state, style=_STYLES.get(state, "dim"))


def checks_table(checks: Sequence[Check], title: str, wording: Wording | None = None) -> Table:
    """Return a table; with why and remedy if there is a `wording`."""
    columns = [
        Column("check", overflow="fold"),
        Column("observed", justify="right", overflow="fold"),
        Column("limit", justify="right", overflow="fold"),
        Column("margin", justify="right", overflow="fold"),
        Column("result", overflow="fold"),
    ]
    if wording is not None:
        columns.append(Column("why, and what to do", overflow="fold", ratio=1))
    table = Table(*columns, title=title, title_justify="left", show_lines=wording is not None)
    for check in checks:
        cells: list[str | Text] = [
            check.name,
            with_unit(check.observed, check.unit),
            f"{check.op} {with_unit(check.limit, check.unit)}" if check.op else "",
            check.margin_text(),
            _RESULTS[check.passed],
        ]
        if wording is not None:
            cells.append(wording(_explanation(check)))
        table.add_row(*cells)
    return table


def _explanation(check: Check) -> str:
    if check.passed is False and check.remedy:
        return f"{check.why}\n{check.remedy}"
    return check.why


def label(verdict: Verdict) -> str:
    """Return why a verdict is no acceptance; empty if it is."""
    reasons: list[str] = []
    if not verdict.acceptance_profile:
        profile = verdict.fingerprint.profile
        reasons.append(f"profile '{profile}': wiring only, never acceptance")
    if verdict.weakened:
        values = "; ".join(verdict.weakened)
        reasons.append(f"NO ACCEPTANCE, it asks for less than the profile: {values}")
    reasons += [f"GATE WAIVED at {waiver.stage}: {waiver.reason}" for waiver in verdict.waivers]
    return "; ".join(reasons)


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
    for name, upstream_state in upstream.items():
        console.print(Text.assemble("  requires ", name, ": ", state_text(upstream_state)))
    if not upstream:
        _lines(console, ["  requires no other stage"])
    _lines(console, [f"  {reason}" for reason in state.reasons], "yellow")
    verdict = state.verdict
    if verdict is None:
        return
    made = verdict.fingerprint
    title = (
        f"verdict: {verdict.status}, {verdict.finished_at}, "
        f"profile '{made.profile}', seed {made.seed}"
    )
    _print_verdict(console, state, verdict, title, wording)
    _lines(console, [f"made with {text}" for text in verdict.overrides])


def _print_verdict(
    console: Console,
    state: StageState,
    verdict: Verdict,
    title: str,
    wording: Wording | None = None,
) -> None:
    console.print(checks_table(verdict.checks, title, wording))
    _lines(console, [label(verdict)], "bold yellow")
    _lines(console, verdict.notes)
    _lines(console, [f"note: {warning}" for warning in state.warnings], "dim")
    folder = state.folder
    if folder is None:
        return
    names = list(verdict.artefacts)
    _lines(console, [f"  {folder / name}" for name in names[:_SHOWN_ARTEFACTS]])
    more_n = len(names) - _SHOWN_ARTEFACTS
    if more_n > 0:
        _lines(console, [f"  and {more_n} more under {folder}"])


def print_status(console: Console, gate: Gate, title: str, following: str) -> None:
    """Print one row per stage."""
    table = Table(
        Column("stage", no_wrap=True),
        Column("state", no_wrap=True),
        Column("checks", justify="right"),
        Column("took", justify="right"),
        Column("remarks", overflow="fold"),
        title=title,
        title_justify="left",
    )
    for name in gate.table:
        state = gate.state(name)
        verdict = state.verdict
        checks = ""
        took = ""
        remarks = [state.why()]
        if verdict is not None:
            results = [check.passed for check in verdict.checks if check.passed is not None]
            checks = f"{sum(results)}/{len(results)}"
            took = f"{verdict.duration_s:.1f} s"
            remarks += [label(verdict), *state.warnings]
        remark = Text("\n".join(text for text in remarks if text))
        table.add_row(name, state_text(state.state), checks, took, remark)
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
        text = f"look at {lowest.name} first: the lowest stage that does not pass"
        _lines(console, [text], "bold")
        _lines(console, [f"  {wording(line)}" for line in lowest.because()])
    _lines(console, [following])


def _lines(console: Console, lines: Sequence[str], style: str = "") -> None:
    """Print the lines that are not empty."""
    for line in lines:
        if line:
            console.print(Text(line, style=style), soft_wrap=True)
