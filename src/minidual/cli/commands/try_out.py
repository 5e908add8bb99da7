"""`minidual try`."""

from typing import Annotated

import typer

from minidual.cli.execute import run_tool
from minidual.cli.options import PlantAddress, ViewOptions
from minidual.cli.session import Session
from minidual.errors import ExitCode


def try_out(
    *,
    task: Annotated[
        str,
        typer.Argument(
            metavar="TASK",
            help="rod_carry, pot_lift, handover, insertion, sort or your own.",
        ),
    ],
    method: Annotated[
        str | None,
        typer.Option(help="One or more, separated by commas (default: moveit,impedance)."),
    ] = None,
    condition: Annotated[
        str | None,
        typer.Option(help="A condition of the benchmark, such as randomised (default: clean)."),
    ] = None,
    trials: Annotated[int | None, typer.Option(help="Starts of each method (default: 5).")] = None,
    first: Annotated[
        int | None,
        typer.Option(help="Number of the first start (default: 0)."),
    ] = None,
    checkpoint: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[METHOD=]PATH",
            help="Folder or ws://HOST:PORT of a policy, repeatable (default: the run's or package's).",
        ),
    ] = None,
    video: Annotated[
        bool | None,
        typer.Option("--video", help="Film the first start, all methods side by side."),
    ] = None,
    plant: PlantAddress = None,
    placed_by: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Who has put the objects at their start, on a plant that nothing can score.",
        ),
    ] = None,
    view_options: ViewOptions,
    session: Session,
) -> ExitCode:
    """Run trials of any method on any task, without a gate.

    It prints a table and, for two methods, which is better. It gives no verdict: `benchmark`
    compares for acceptance.

    Examples:
        minidual try pot_lift --trials 10
        minidual try handover --method moveit --condition randomised --video
        minidual try rod_carry --method moveit --trials 10 --plant franka://127.0.0.1,127.0.0.2
        minidual try rod_carry --method impedance --set carry.impedance.stiffness_n_per_m=300
    """
    options = {
        "task": task,
        "method": method,
        "condition": condition,
        "trials": trials,
        "first": first,
        "checkpoint": checkpoint,
        "video": video,
        "plant": plant,
        "placed-by": placed_by,
    }
    return run_tool(session, session.tools["try"], options, view_options)
