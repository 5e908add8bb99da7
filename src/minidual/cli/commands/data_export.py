"""`minidual data export`."""

from pathlib import Path
from typing import Annotated

import typer

from minidual.cli.session import Session
from minidual.errors import ExitCode, UsageError


def data_export(
    *,
    recording: Annotated[
        str,
        typer.Argument(metavar="RECORDING", help="An episode (.hdf5), or a folder of episodes."),
    ],
    mcap: Annotated[
        str,
        typer.Option(metavar="FILE", help="MCAP file; of a folder of episodes, a folder."),
    ],
    session: Session,
) -> ExitCode:
    """Write episodes as MCAP with ROS 2 messages.

    Needs the extra `ros2` of minidual.

    Examples:
        minidual data export runs/standard/teleop-record/episodes --mcap bags
        minidual data export episode_000000.hdf5 --mcap episode_000000.mcap
    """
    from minidual.demos.episode import episode_paths, read_episode
    from minidual.robot.pair import robot_from
    from minidual.ros2.bags.export import export_episode

    robot = robot_from(session.loaded.config.robot)
    source = Path(recording)
    target = Path(mcap)
    if source.is_dir():
        episodes = episode_paths(source)
        if not episodes:
            raise UsageError(f"{source} has no episodes (episode_000000.hdf5, ...)")
        target.mkdir(parents=True, exist_ok=True)
        files = {path: target / f"{path.stem}.mcap" for path in episodes}
    else:
        if target.suffix != ".mcap":
            raise UsageError(f"--mcap {target} must end in .mcap")
        files = {source: target}
    lines: list[str] = []
    written: dict[str, int] = {}
    for path, file in files.items():
        messages_n = export_episode(read_episode(path), robot, file)
        written[str(file)] = messages_n
        lines.append(f"{file}: {messages_n} messages of {path.name}")
    session.finish({"files": written, "exit_code": int(ExitCode.PASS)}, lines)
    return ExitCode.PASS
