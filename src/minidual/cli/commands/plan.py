"""`minidual plan`."""

from typing import Annotated

import typer

from minidual.cli.execute import Aside, run_stage
from minidual.cli.options import GateOptions, ViewOptions, flag
from minidual.cli.session import Session
from minidual.errors import ExitCode


def plan(
    *,
    acm: Annotated[
        bool,
        flag("--acm", "Print the pairs that are not checked, and why, instead."),
    ] = False,
    scene: Annotated[
        str | None,
        typer.Option(help="With --to or --acm: planning scene in YAML."),
    ] = None,
    to: Annotated[
        str | None,
        typer.Option(help="Plan once to this state (home, ready, carry ...) or goal file instead."),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option("--from", help="With --to: start at this state or file (default: home)."),
    ] = None,
    group: Annotated[
        str | None,
        typer.Option(help="With --to: left_arm, right_arm or both_arms (default)."),
    ] = None,
    out: Annotated[
        str | None,
        typer.Option(help="With --to: write the trajectory here (.json)."),
    ] = None,
    csv: Annotated[
        str | None,
        typer.Option(help="With --to: write the trajectory here (.csv)."),
    ] = None,
    picture: Annotated[
        str | None,
        typer.Option(help="With --to: draw the path here (.png)."),
    ] = None,
    budget_s: Annotated[
        float | None,
        typer.Option(help="With --to: give up after this wall time."),
    ] = None,
    task: Annotated[
        str | None,
        typer.Option(
            help="Plan this task (rod_carry, handover ...) as a whole and drive it instead.",
        ),
    ] = None,
    video: Annotated[str | None, typer.Option(help="With --task: film it (.mp4).")] = None,
    queries: Annotated[int | None, typer.Option(help="Queries per planning group.")] = None,
    view_options: ViewOptions,
    gate_options: GateOptions,
    session: Session,
) -> ExitCode:
    """Plan collision-free motions for left_arm, right_arm and both_arms.

    Examples:
        minidual plan
        minidual plan --to ready --scene examples/bench-scene.yaml --view web
    """
    pairs = Aside("plan-acm", trigger="acm", options={"acm": acm, "scene": scene})
    one_plan = Aside(
        "plan-once",
        trigger="to",
        options={
            "to": to,
            "from": start,
            "group": group,
            "scene": scene,
            "out": out,
            "csv": csv,
            "picture": picture,
            "budget-s": budget_s,
        },
    )
    whole_task = Aside("plan-task", trigger="task", options={"task": task, "video": video})
    asides = [pairs, one_plan, whole_task]
    return run_stage(session, "plan", {"queries": queries}, gate_options, view_options, asides)
