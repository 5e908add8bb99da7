"""`minidual demo`."""

from typing import Annotated

import typer

from minidual.cli.execute import run_tool
from minidual.cli.options import ViewOptions
from minidual.cli.session import Session
from minidual.errors import ExitCode


def demo(
    *,
    task: Annotated[
        str | None,
        typer.Option(help="rod_carry (default), pot_lift, handover, insertion or sort."),
    ] = None,
    start: Annotated[int | None, typer.Option(help="Number of the start (default: 0).")] = None,
    checkpoint: Annotated[
        str | None,
        typer.Option(help="Folder of a policy (default: the run's, or that of the package)."),
    ] = None,
    view_options: ViewOptions,
    session: Session,
) -> ExitCode:
    """Show planner, force control and a trained policy on the same start.

    It writes a film of them side by side; with --view web it plays them so in a browser.

    Examples:
        minidual demo
        minidual demo --task pot_lift --view web
    """
    options = {"task": task, "start": start, "checkpoint": checkpoint}
    return run_tool(session, session.tools["demo"], options, view_options)
