"""`minidual report`."""

from typing import Annotated

import typer

from minidual.cli.execute import run_stage
from minidual.cli.options import GateOptions
from minidual.cli.session import Session
from minidual.errors import ExitCode


def report(
    *,
    lang: Annotated[
        str | None,
        typer.Option(help="Language of the page: en or zh (default: en)."),
    ] = None,
    gate_options: GateOptions,
    session: Session,
) -> ExitCode:
    """Build the report from the verdicts: one offline HTML and report.json.

    Examples:
        minidual report
        minidual report --lang zh
        minidual report --run standard --json
    """
    return run_stage(session, "report", {"lang": lang}, gate_options)
