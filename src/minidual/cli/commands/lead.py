"""`minidual lead`."""

from typing import Annotated

import typer

from minidual.cli.execute import run_tool
from minidual.cli.options import PlantAddress, ViewOptions
from minidual.cli.session import Session
from minidual.errors import ExitCode


def lead(
    *,
    leader: Annotated[
        str | None,
        typer.Option(help="Who leads, such as network, gamepad or scripted (teleop.leader)."),
    ] = None,
    task: Annotated[
        str | None,
        typer.Option(help="Scene of this task (default: the run's)."),
    ] = None,
    seconds: Annotated[float | None, typer.Option(help="Longest time (default: 60).")] = None,
    plant: PlantAddress = None,
    view_options: ViewOptions,
    session: Session,
) -> ExitCode:
    """Lead the arms of any plant, without a gate, a judge or a recording.

    It prints the rate, by how much the arms are later than the commands, and what was refused.

    Examples:
        minidual lead --leader network --plant franka://127.0.0.1,127.0.0.2
        minidual lead --leader keyboard --seconds 120
    """
    options = {"leader": leader, "task": task, "seconds": seconds, "plant": plant}
    return run_tool(session, session.tools["lead"], options, view_options)
