"""`minidual view`."""

from typing import Annotated

import typer

from minidual.cli.execute import run_tool
from minidual.cli.options import ViewOptions
from minidual.cli.session import Session
from minidual.errors import ExitCode


def view(
    *,
    task: Annotated[
        str | None,
        typer.Option(help="Scene of this task, for example pot_lift."),
    ] = None,
    for_s: Annotated[
        float | None,
        typer.Option(help="End by itself after this many seconds (default: Ctrl-C ends it)."),
    ] = None,
    view_options: ViewOptions,
    session: Session,
) -> ExitCode:
    """Show the scene in real time in a browser, with a slider for each joint.

    Examples:
        minidual view --task pot_lift
        minidual view --set robot.arm=xarm7 --for-s 60
    """
    options = {"task": task, "for-s": for_s}
    return run_tool(session, session.tools["view"], options, view_options)
