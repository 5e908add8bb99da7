"""What `minidual explain` says without a stage, and adds about a stage that does not pass: the debug ladder."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.table import Table
from rich.text import Text

from minidual.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from rich.console import Console

    from minidual.cli.session import Session
    from minidual.gate.gate import Gate
    from minidual.stages.ladder import LevelFound, Walk

_STYLES = {"holds": "bold green", "fails": "bold red", "unproven": "yellow"}


def walk_of(session: Session, gate: Gate) -> Walk:
    """Return the ladder of the session's run."""
    from minidual.stages.ladder import walk

    return walk(gate, session.typed.command)


def explain_ladder(session: Session) -> ExitCode:
    """Show all levels and the lowest that does not hold."""
    found = walk_of(session, session.gate())
    if not found.levels:
        raise UsageError(f"name a stage; there are {', '.join(session.table.names)}")
    if session.typed.json:
        session.print_json({"run": session.store.run, "profile": session.loaded.profile, **found.to_json()})
        return ExitCode.PASS
    table = Table(title=f"debug ladder of run {session.store.run}, from the bottom up", title_justify="left")
    for header in ("level", "is", "proved by", "question"):
        table.add_column(header, overflow="fold", no_wrap=header == "is")
    for level in found.levels:
        name = f"{level.level.number} {level.level.name}"
        table.add_row(name, Text(level.standing, style=_STYLES[level.standing]), _proofs(level), level.level.question)
    session.data.print(table)
    print_lowest(session.data, found)
    return ExitCode.PASS


def print_lowest(console: Console, found: Walk) -> None:
    """Print which level to look at, why, and what to type."""
    lowest = found.lowest
    if lowest is None:
        if found.levels:
            _say(console, "every level holds", "green")
        return
    words = {"fails": "does not hold", "unproven": "is not proved"}[lowest.standing]
    _say(console, f"look at level {lowest.level.number}, {lowest.level.name}: the lowest that {words}", "bold")
    for line in found.lines:
        _say(console, f"  {line}")
    _say(console, f"next: {found.next_command}")


def _proofs(found: LevelFound) -> str:
    parts: list[str] = []
    for proof in found.proofs:
        words = [f"{proof.passed}/{proof.limited}" if proof.limited else ""]
        words += ["" if proof.state in ("pass", "fail") else proof.state]
        words += ["" if proof.acceptance or not proof.limited else "(wiring only)"]
        parts.append(" ".join([proof.stage, *(word for word in words if word)]))
    return "\n".join(parts)


def _say(console: Console, text: str, style: str = "") -> None:
    console.print(Text(text, style=style), soft_wrap=True)
