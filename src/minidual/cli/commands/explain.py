"""`minidual explain`."""

from typing import Annotated, Any

import typer

from minidual.cli.commands.status import show_status
from minidual.cli.console import print_explanation, print_lowest
from minidual.cli.documents import state_document
from minidual.cli.options import flag
from minidual.cli.session import Session
from minidual.errors import ExitCode


def explain(
    *,
    stage: Annotated[
        str | None,
        typer.Argument(metavar="stage", help="A stage; none shows what to look at first."),
    ] = None,
    everything: Annotated[
        bool,
        flag("--all", "Show all checks of the stage, not only the failed ones."),
    ] = False,
    session: Session,
) -> ExitCode:
    """Explain one stage: failed checks, remedies, staleness; or what to look at first.

    Examples:
        minidual explain
        minidual explain deploy --all
    """
    if stage is None:
        return show_status(session, explained=True)
    entry = session.table[stage]
    gate = session.gate()
    state = gate.state(entry.name)
    upstream = {name: gate.state(name).state for name in gate.requires(stage)}
    lowest = gate.lowest()
    if not session.common.json:
        print_explanation(session.data, entry, state, upstream, session.in_this_run, everything)
        if state.state == "pass":
            session.say(f"to run it again: {session.common.command(f'{entry.name} --force')}")
        else:
            following = session.following(gate, explained=True)
            print_lowest(session.data, lowest, following, session.in_this_run)
    document: dict[str, Any] = {
        **state_document(state),
        "summary": entry.summary,
        "requires": upstream,
        "verdict": None if state.verdict is None else state.verdict.to_json(),
        "lowest": None if lowest is None else lowest.name,
    }
    session.finish(document, ())
    return ExitCode.PASS
