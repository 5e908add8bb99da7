"""`minidual teleop-record`."""

from typing import Annotated

import typer

from minidual.cli.execute import run_stage
from minidual.cli.options import GateOptions, ViewOptions
from minidual.cli.session import Session
from minidual.errors import ExitCode


def teleop_record(
    *,
    episodes: Annotated[int | None, typer.Option(help="Demonstrations to record.")] = None,
    task: Annotated[
        str | None,
        typer.Option(help="Task, such as handover (default: the run's)."),
    ] = None,
    correct: Annotated[
        str | None,
        typer.Option(
            help="Checkpoint of a policy that drives until who leads takes over.",
            metavar="CHECKPOINT",
        ),
    ] = None,
    network: Annotated[
        str | None,
        typer.Option(
            metavar="delay=100ms,...",
            help="Network between leader and arms, simulated in both directions: delay and jitter "
            "of a round trip, loss and reorder in percent.",
        ),
    ] = None,
    view_options: ViewOptions,
    gate_options: GateOptions,
    session: Session,
) -> ExitCode:
    """Teleoperate, record demonstrations, convert and grade the dataset.

    Examples:
        minidual teleop-record --episodes 50
        minidual teleop-record --task handover --view web
        minidual teleop-record --run fixed --correct policy --set teleop.leader=browser
        minidual teleop-record --network delay=100ms,jitter=20ms,loss=5%,reorder=1%
    """
    options = {"episodes": episodes, "task": task, "correct": correct, "network": network}
    return run_stage(session, "teleop-record", options, gate_options, view_options)
