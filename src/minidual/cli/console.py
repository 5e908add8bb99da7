"""Tables and explanations for people."""

from collections import Counter
from collections.abc import Mapping, Sequence

from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from minidual.cli.checks_view import Wording, checks_view, explained
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
_SHOWN_ARTEFACTS = 8


def state_text(state: str) -> Text:
    """Return a coloured state."""
    return Text(state, style=_STYLES.get(state, "dim"))


def label(verdict: Verdict) -> str:
    """Return why a verdict is no acceptance; empty if it is."""
    reasons = [_quick_test(verdict), _less_asked(verdict)]
    return "; ".join(reason for reason in reasons if reason)


def _quick_test(verdict: Verdict) -> str:
    if verdict.acceptance_profile:
        return ""
    profile = verdict.fingerprint.profile
    return f"profile '{profile}': a quick test, never acceptance"


def _less_asked(verdict: Verdict) -> str:
    """Return what a verdict asks less than the profile, and the gates waived for it."""
    reasons: list[str] = []
    if verdict.weakened:
        values = "; ".join(verdict.weakened)
        reasons.append(f"NO ACCEPTANCE, it asks for less than the profile: {values}")
    reasons += [f"GATE WAIVED at {waiver.stage}: {waiver.reason}" for waiver in verdict.waivers]
    return "; ".join(reasons)


def print_outcome(
    console: Console,
    entry: StageEntry,
    outcome: StageOutcome,
    following: str,
) -> None:
    """Print a result of the stage of a row, and the next command."""
    verdict = outcome.verdict
    took = f"{verdict.duration_s:.1f} s" if outcome.ran else "fresh"
    title = f"{verdict.stage}: {verdict.status}, {took}"
    compared = entry.compared(verdict.fingerprint.parameters)
    console.print(checks_view(console, verdict.checks, title, compared))
    _print_rest(console, outcome.state, verdict)
    _lines(console, [following])


def print_explanation(
    console: Console,
    entry: StageEntry,
    state: StageState,
    upstream: Mapping[str, str],
    wording: Wording,
    everything: bool = False,
) -> None:
    """Print one stage.

    Args:
        console: Where it is printed.
        entry: Row of the stage.
        state: Its state.
        upstream: {required stage: state}.
        wording: Completes the commands of a remedy.
        everything: Whether all checks are printed, not only the failed ones.
    """
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
    fingerprint = verdict.fingerprint
    title = (
        f"verdict: {verdict.status}, {verdict.finished_at}, "
        f"profile '{fingerprint.profile}', seed {fingerprint.seed}"
    )
    console.print(Text(title, "italic"))
    failed = verdict.failed_checks()
    others = [check for check in verdict.checks if check.passed is not False]
    console.print(explained([*failed, *others] if everything else failed, wording))
    if others and not everything:
        passed_n = sum(check.passed is True for check in others)
        reported_n = len(others) - passed_n
        _lines(console, [f"other checks: {passed_n} pass, {reported_n} reported; --all shows them"])
    _print_rest(console, state, verdict)
    _lines(console, [f"made with {text}" for text in verdict.overrides])


def _print_rest(console: Console, state: StageState, verdict: Verdict) -> None:
    """Print what a verdict has beside its checks: labels, notes, warnings, artefacts."""
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
    quick_tests: dict[str, None] = {}
    counts = Counter(warning for name in gate.table for warning in gate.state(name).warnings)
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
            remarks.append(_less_asked(verdict))
            remarks += [warning for warning in state.warnings if counts[warning] == 1]
            quick_tests[_quick_test(verdict)] = None
        remark = Text("\n".join(text for text in remarks if text))
        table.add_row(name, state_text(state.state), checks, took, remark)
    console.print(table)
    _lines(console, list(quick_tests), "bold yellow")
    shared = [f"note: {n} stages {warning}" for warning, n in counts.items() if n > 1]
    _lines(console, shared, "dim")
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
