"""`minidual train-act`."""

from typing import Annotated

import typer

from minidual.cli.execute import Aside, run_stage
from minidual.cli.options import GateOptions
from minidual.cli.session import Session
from minidual.errors import ExitCode


def train_act(
    *,
    seeds: Annotated[
        int | None,
        typer.Option(help="Trainings, each with its own seed."),
    ] = None,
    dataset: Annotated[
        str | None,
        typer.Option(
            metavar="PATH",
            help="Train on this LeRobot v3 dataset, recording or run instead, without a gate.",
        ),
    ] = None,
    cameras: Annotated[
        str | None,
        typer.Option(help="With --dataset: cameras, separated by commas (default: all)."),
    ] = None,
    height: Annotated[
        int | None,
        typer.Option(help="With --dataset: scale higher pictures down to so many rows."),
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(help="With --dataset: training steps (default: train.steps)."),
    ] = None,
    gate_options: GateOptions,
    session: Session,
) -> ExitCode:
    """Train the policy on the recorded dataset.

    Examples:
        minidual train-act
        minidual train-act --seeds 3
        minidual train-act --dataset ~/datasets/aloha_cups --height 96
    """
    foreign = Aside(
        "train-dataset",
        trigger="dataset",
        options={"dataset": dataset, "cameras": cameras, "height": height, "steps": steps},
    )
    return run_stage(session, "train-act", {"seeds": seeds}, gate_options, asides=[foreign])
