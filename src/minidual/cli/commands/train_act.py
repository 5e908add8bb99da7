"""`minidual train-act`."""

from typing import Annotated

import typer

from minidual.cli.execute import run_stage
from minidual.cli.options import GateOptions
from minidual.cli.session import Session
from minidual.errors import ExitCode


def train_act(
    *,
    seeds: Annotated[
        int | None,
        typer.Option(help="Trainings, each with its own seed."),
    ] = None,
    gate_options: GateOptions,
    session: Session,
) -> ExitCode:
    """Train the policy on the recorded dataset.

    Examples:
        minidual train-act
        minidual train-act --seeds 3
    """
    return run_stage(session, "train-act", {"seeds": seeds}, gate_options)
