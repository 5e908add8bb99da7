"""`minidual replay`."""

from typing import Annotated

import typer

from minidual.cli.execute import run_tool
from minidual.cli.session import Session
from minidual.errors import ExitCode


def replay(
    *,
    file: Annotated[
        str,
        typer.Argument(metavar="FILE", help="A dump or a recorded trial (.npz)."),
    ],
    from_s: Annotated[
        float | None,
        typer.Option(help="Begin at this simulated time."),
    ] = None,
    to_s: Annotated[float | None, typer.Option(help="End at this simulated time.")] = None,
    video: Annotated[str | None, typer.Option(help="Write a film here (.mp4).")] = None,
    slowdown: Annotated[
        float | None,
        typer.Option(help="Film this many times slower than life."),
    ] = None,
    picture: Annotated[
        str | None,
        typer.Option(help="Write a sheet of frames here (.png)."),
    ] = None,
    frames: Annotated[int | None, typer.Option(help="Frames on the sheet.")] = None,
    camera: Annotated[
        str | None,
        typer.Option(help="overview, high, left or right."),
    ] = None,
    session: Session,
) -> ExitCode:
    """Run a dumped state or a recorded trial again.

    It says whether the run repeats, and what went out of bounds first.

    Examples:
        minidual replay runs/standard/carry/worst.npz --video worst.mp4 --slowdown 4
        minidual replay runs/standard/carry/worst.npz --picture worst.png --frames 12
    """
    options = {
        "file": file,
        "from-s": from_s,
        "to-s": to_s,
        "video": video,
        "slowdown": slowdown,
        "picture": picture,
        "frames": frames,
        "camera": camera,
    }
    return run_tool(session, session.tools["replay"], options)
