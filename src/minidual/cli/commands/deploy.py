"""`minidual deploy`."""

from typing import Annotated

import typer

from minidual.cli.execute import run_stage
from minidual.cli.options import GateOptions, ViewOptions
from minidual.cli.session import Session
from minidual.errors import ExitCode


def deploy(
    *,
    trials: Annotated[int | None, typer.Option(help="Held-out trials.")] = None,
    task: Annotated[
        str | None,
        typer.Option(help="Task, such as handover (default: the run's)."),
    ] = None,
    policy: Annotated[
        str | None,
        typer.Option(
            metavar="PATH",
            help="Any LeRobot checkpoint, or ws://HOST:PORT (default: the run's policy).",
        ),
    ] = None,
    view_options: ViewOptions,
    gate_options: GateOptions,
    session: Session,
) -> ExitCode:
    """Let the policy drive the arms on seeds it never saw.

    Examples:
        minidual deploy
        minidual deploy --trials 20 --view web
        minidual deploy --policy outputs/train/checkpoints/last/pretrained_model
    """
    options = {"trials": trials, "task": task, "policy": policy}
    return run_stage(session, "deploy", options, gate_options, view_options)
