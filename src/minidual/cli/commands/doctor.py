"""`minidual doctor`."""

from typing import Annotated

import typer

from minidual.cli.execute import run_tool
from minidual.cli.options import flag
from minidual.cli.session import Session
from minidual.errors import ExitCode, UsageError


def doctor(
    explain: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Explain one known trouble, by name or by number, instead.",
        ),
    ] = None,
    listing: Annotated[
        bool,
        flag("--list", "Print the names of all known troubles instead."),
    ] = False,
    *,
    session: Session,
) -> ExitCode:
    """Look for every known fault of this machine and of what the run holds, each with its remedy.

    Examples:
        minidual doctor
        minidual doctor --run standard --json
        minidual doctor --list
        minidual doctor --explain joint-order
    """
    if explain is None and not listing:
        return run_tool(session, session.tools["doctor"], {})
    from minidual.stages.troubles import catalogue

    if explain is None:
        rows = [catalogue.as_document(row) for row in catalogue.TROUBLES.values()]
        session.finish({"troubles": rows}, catalogue.listing())
        return ExitCode.PASS
    if listing:
        raise UsageError("--explain and --list exclude each other; type one of them")
    row = catalogue.trouble(explain)
    session.finish({"trouble": catalogue.as_document(row)}, catalogue.explanation(row))
    return ExitCode.PASS
