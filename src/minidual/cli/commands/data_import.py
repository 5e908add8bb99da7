"""`minidual data import`."""

from pathlib import Path
from typing import Annotated

import typer

from minidual.cli.session import Session
from minidual.errors import ExitCode, UsageError


def data_import(
    *,
    file: Annotated[
        str,
        typer.Argument(metavar="FILE", help="MCAP of `data export`, or of the bridge's topics."),
    ],
    out: Annotated[str, typer.Option(metavar="FILE", help="The episode (.hdf5), new.")],
    instruction: Annotated[
        str,
        typer.Option(help="What was done, for a recording that does not say it."),
    ] = "",
    session: Session,
) -> ExitCode:
    """Write an MCAP file as an episode.

    Joints are found by name. A file of `data export` comes back as it was; a recording of other
    programs is sampled at teleop.rate_hz.

    Examples:
        minidual data import episode_000000.mcap --out episode_000001.hdf5
    """
    from minidual.robot.pair import robot_from
    from minidual.ros2.bags.load import import_file

    config = session.loaded.config
    target = Path(out)
    if target.suffix != ".hdf5":
        raise UsageError(f"--out {target} must end in .hdf5")
    meta = import_file(
        Path(file),
        target,
        robot_from(config.robot),
        fps=config.teleop.rate_hz,
        task=instruction,
    )
    cameras = ", ".join(meta.cameras) or "none"
    lines = [f"{target}: {meta.fps:g} Hz, cameras {cameras}"]
    document = {"file": str(target), "fps": meta.fps, "cameras": list(meta.cameras)}
    session.finish({**document, "exit_code": int(ExitCode.PASS)}, lines)
    return ExitCode.PASS
