"""`minidual benchmark`."""

from typing import Annotated

import typer

from minidual.cli.execute import run_stage
from minidual.cli.options import GateOptions, ViewOptions
from minidual.cli.session import Session
from minidual.errors import ExitCode


def benchmark(
    *,
    tasks: Annotated[
        str | None,
        typer.Option(help="Tasks, such as rod_carry,handover (default: the run's)."),
    ] = None,
    methods: Annotated[
        str | None,
        typer.Option(help="Methods to compare, such as moveit,impedance,act."),
    ] = None,
    conditions: Annotated[
        str | None,
        typer.Option(help="Disturbances, such as clean,push_+y; or all."),
    ] = None,
    trials: Annotated[
        int | None,
        typer.Option(help="Undisturbed trials of each method and task."),
    ] = None,
    policy: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=PATH",
            help="Policy of a learned method, or of a new one; a folder or ws://HOST:PORT; repeatable.",
        ),
    ] = None,
    view_options: ViewOptions,
    gate_options: GateOptions,
    session: Session,
) -> ExitCode:
    """Compare the methods on the same tasks, seeds and success tests, undisturbed and disturbed.

    Examples:
        minidual benchmark --tasks rod_carry,handover --methods moveit,act
        minidual benchmark --tasks pot_lift --methods moveit,impedance,rl
        minidual benchmark --conditions clean,push_+y,friction_0.3
        minidual benchmark --methods moveit,theirs --policy theirs=ws://127.0.0.1:8000
    """
    options = {
        "tasks": tasks,
        "methods": methods,
        "conditions": conditions,
        "trials": trials,
        "policy": policy or None,
    }
    return run_stage(session, "benchmark", options, gate_options, view_options)
