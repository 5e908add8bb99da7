"""`minidual train`."""

from typing import Annotated

import typer

from minidual.cli.execute import run_stage, run_tool
from minidual.cli.options import GateOptions
from minidual.cli.session import Session
from minidual.errors import ExitCode, UsageError

_DEMONSTRATED = "act"
"""The method that learns from the run's recordings, behind the gate of `train-act`."""


def train(
    *,
    method: Annotated[
        str,
        typer.Argument(metavar="METHOD", help="rl, act, or a learned method of your own."),
    ],
    task: Annotated[
        str | None,
        typer.Option(help="Task to learn (default: the run's)."),
    ] = None,
    seeds: Annotated[
        int | None,
        typer.Option(help="Trainings, each with its own seed (default: 1)."),
    ] = None,
    trials: Annotated[
        int | None,
        typer.Option(help="Fresh starts on which the policy is tried (default: 20)."),
    ] = None,
    conditions: Annotated[
        str | None,
        typer.Option(help="Conditions of those trials, such as clean,randomised."),
    ] = None,
    video: Annotated[
        bool | None,
        typer.Option("--video", help="Film the policy on a fresh start."),
    ] = None,
    session: Session,
) -> ExitCode:
    """Train the policy of a learned method.

    `rl` learns by trying in many simulated worlds at once, and needs no recording. `act` learns
    from the run's recordings: that is the stage train-act. An interrupted training goes on when the
    command is typed again.

    Examples:
        minidual train rl --task pot_lift
        minidual train rl --task pot_lift --seeds 3 --trials 100 --conditions clean,randomised
        minidual train act
    """
    options = {
        "task": task,
        "seeds": seeds,
        "trials": trials,
        "conditions": conditions,
        "video": video,
    }
    if method != _DEMONSTRATED:
        return run_tool(session, session.tools["train"], {"method": method, **options})
    for name, value in options.items():
        if value is not None and name != "seeds":
            raise UsageError(
                f"--{name} does not go with act, which learns what the run has recorded",
                remedy="minidual teleop-record --task TASK, then minidual train act",
            )
    return run_stage(session, "train-act", {"seeds": seeds}, GateOptions())
