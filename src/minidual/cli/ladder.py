"""The debug ladder: stages from the bottom up.

A fault propagates upwards (a policy may miss because of a camera), so `minidual explain` points at the lowest stage
that does not pass.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.table import Table
from rich.text import Text

from minidual.cli.tables import state_text

if TYPE_CHECKING:
    from minidual.cli.session import Session
    from minidual.errors import ExitCode
    from minidual.gate.gate import Gate, StageState


def lowest(session: Session, gate: Gate) -> StageState | None:
    """Return the first stage that does not pass, or None."""
    return next((state for name in session.table.names if (state := gate.state(name)).state != "pass"), None)


def reasons(state: StageState) -> list[str]:
    """Return failed checks with why and remedy, or why the stage is not fresh."""
    if state.state != "fail" or state.verdict is None:
        return [f"{state.name} is {state.state}", *(f"  {reason}" for reason in state.reasons)]
    lines: list[str] = []
    for check in state.verdict.failed_checks():
        lines.append(f"{state.name}: {check.sentence()}")
        lines += [f"  {label}: {text}" for label, text in (("why", check.why), ("remedy", check.remedy)) if text]
    return lines


def ladder_json(session: Session, gate: Gate) -> dict[str, Any]:
    """Return the ladder as JSON types."""
    found = lowest(session, gate)
    levels = [
        {
            "stage": entry.name,
            "question": entry.question,
            "state": gate.state(entry.name).state,
            **_counts(gate, entry.name),
        }
        for entry in session.table
    ]
    return {
        "levels": levels,
        "lowest": None if found is None else found.name,
        "because": [] if found is None else reasons(found),
        "next": None if found is None else session.typed.command(found.name),
    }


def explain_ladder(session: Session) -> ExitCode:
    """Print all stages and the lowest that does not pass."""
    from minidual.errors import ExitCode

    gate = session.gate()
    if session.typed.json:
        session.print_json({"run": session.store.run, "profile": session.loaded.profile, **ladder_json(session, gate)})
        return ExitCode.PASS
    table = Table(title=f"debug ladder of run {session.store.run}, from the bottom up", title_justify="left")
    for header in ("stage", "is", "checks", "question"):
        table.add_column(header, overflow="fold", no_wrap=header == "stage")
    for entry in session.table:
        counts = _counts(gate, entry.name)
        checks = f"{counts['passed']}/{counts['limited']}" if counts["limited"] else ""
        wiring = " (wiring only)" if counts["limited"] and not counts["acceptance"] else ""
        table.add_row(entry.name, state_text(gate.state(entry.name).state), checks + wiring, entry.question)
    session.data.print(table)
    print_lowest(session, gate)
    return ExitCode.PASS


def print_lowest(session: Session, gate: Gate) -> None:
    """Print the stage to look at, why, and the command."""
    found = lowest(session, gate)
    if found is None:
        session.data.print(Text("every stage holds", style="green"))
        return
    lines = [Text(f"look at {found.name} first: the lowest stage that does not pass", style="bold")]
    lines += [Text(f"  {line}") for line in reasons(found)]
    for line in (*lines, Text(f"next: {session.typed.command(found.name)}")):
        session.data.print(line, soft_wrap=True)


def _counts(gate: Gate, name: str) -> dict[str, Any]:
    verdict = gate.state(name).verdict
    checks = [] if verdict is None else [check for check in verdict.checks if check.limited]
    return {
        "passed": sum(check.passed is True for check in checks),
        "limited": len(checks),
        "acceptance": verdict is not None and verdict.acceptance,
    }
