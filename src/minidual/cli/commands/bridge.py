"""`minidual bridge`."""

from typing import Annotated

import typer

from minidual.cli.execute import run_tool
from minidual.cli.options import flag
from minidual.cli.session import Session
from minidual.errors import ExitCode


def bridge(
    *,
    task: Annotated[
        str | None,
        typer.Option(help="Scene of this task, for example pot_lift."),
    ] = None,
    domain: Annotated[
        int | None,
        typer.Option(help="DDS domain (default: $ROS_DOMAIN_ID, or 0)."),
    ] = None,
    for_s: Annotated[
        float | None,
        typer.Option(help="End by itself after this many seconds (default: Ctrl-C ends it)."),
    ] = None,
    no_cameras: Annotated[
        bool,
        flag("--no-cameras", "Publish no pictures; drawing them takes most of the time."),
    ] = False,
    session: Session,
) -> ExitCode:
    """Put the simulated arms on ROS 2 topics, with requests to the arbiter. Needs no ROS.

    Needs the extra `ros2` of minidual.

    Examples:
        minidual bridge --task pot_lift
        minidual bridge --no-cameras --for-s 60
    """
    options = {
        "task": task,
        "domain": domain,
        "for-s": for_s,
        "no-cameras": no_cameras or None,
    }
    return run_tool(session, session.tools["bridge"], options)
