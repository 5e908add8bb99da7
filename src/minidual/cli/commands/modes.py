"""`minidual modes`."""

from typing import Annotated

import typer

from minidual.cli.execute import run_tool
from minidual.cli.options import PlantAddress, ViewOptions
from minidual.cli.session import Session
from minidual.errors import ExitCode


def modes(
    *,
    modes: Annotated[
        str | None,
        typer.Option(
            help="Modes in turn, separated by commas (default: moveit,teleop,policy,moveit).",
        ),
    ] = None,
    checkpoint: Annotated[
        str | None,
        typer.Option(help="Folder of the policy (default: the run's train-act)."),
    ] = None,
    speed: Annotated[float | None, typer.Option(help="Share of full speed, 0.1 to 1.")] = None,
    plant: PlantAddress = None,
    view_options: ViewOptions,
    session: Session,
) -> ExitCode:
    """Planner, leader and policy hand the arms to one another in one process.

    It writes a film, a log and the bounds of every switch. On a plant without cameras it draws
    signals in place of the film.

    Examples:
        minidual modes
        minidual modes --modes moveit,teleop,moveit --view web
        minidual modes --modes moveit,teleop,moveit --plant franka://127.0.0.1,127.0.0.2
    """
    options = {"modes": modes, "checkpoint": checkpoint, "speed": speed, "plant": plant}
    return run_tool(session, session.tools["modes"], options, view_options)
