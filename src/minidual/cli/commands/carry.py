"""`minidual carry`."""

from typing import Annotated

import typer

from minidual.cli.execute import Aside, run_stage
from minidual.cli.options import GateOptions, ViewOptions, flag
from minidual.cli.session import Session
from minidual.errors import ExitCode


def carry(
    *,
    perturb: Annotated[
        bool,
        flag(
            "--perturb",
            "Carry under every promised disturbance (20 trials each, or --trials) instead.",
        ),
    ] = False,
    trials: Annotated[int | None, typer.Option(help="Randomised carries to try.")] = None,
    carried: Annotated[
        str | None,
        typer.Option("--object", help="What is carried: rod, board, box, glass."),
    ] = None,
    motion: Annotated[
        str | None,
        typer.Option(help="How it travels: straight, rotate, over."),
    ] = None,
    tune: Annotated[
        bool,
        flag("--tune", "Search squeeze and stiffness by carrying, and write a profile."),
    ] = False,
    speed: Annotated[float | None, typer.Option(help="Share of full speed, 0.1 to 1.")] = None,
    view_options: ViewOptions,
    gate_options: GateOptions,
    session: Session,
) -> ExitCode:
    """Carry an object with both arms under object impedance control.

    Examples:
        minidual carry --trials 20
        minidual carry --object box --motion over
    """
    load = {"object": carried, "motion": motion}
    disturbed = Aside(
        "carry-perturb",
        trigger="perturb",
        options={"perturb": perturb, "trials": trials, **load},
    )
    tuning = Aside("carry-tune", trigger="tune", options={"tune": tune, **load})
    options = {"trials": trials, **load, "speed": speed}
    return run_stage(session, "carry", options, gate_options, view_options, [disturbed, tuning])
