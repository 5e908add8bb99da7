"""`minidual export ros2`."""

from pathlib import Path
from typing import Annotated

import typer

from minidual.cli.session import Session
from minidual.config.loader import Override
from minidual.errors import ExitCode


def export_ros2(
    *,
    out: Annotated[str, typer.Option(metavar="FOLDER", help="Folder of the workspace, new.")],
    arm: Annotated[
        str | None,
        typer.Option(help="Arm model: panda, xarm7, ur5 or your own (default: the run's)."),
    ] = None,
    right_arm: Annotated[
        str | None,
        typer.Option(help="Arm model of the right arm, if it is another one."),
    ] = None,
    session: Session,
) -> ExitCode:
    """Write a ROS 2 workspace: description, MoveIt 2, ros2_control and launch files.

    ROS is not needed. The files were not run under ROS 2; each says how it was checked.

    Examples:
        minidual export ros2 --out dual_panda_ws
        minidual export ros2 --out dual_ur5_ws --arm ur5
        minidual export ros2 --out mixed_ws --arm panda --right-arm ur5
    """
    from minidual.robot.pair import robot_from
    from minidual.ros2.export.workspace import export_workspace

    overrides: list[Override] = []
    if arm is not None:
        overrides.append(Override("robot.arm", arm, f"--arm {arm}"))
    if right_arm is not None:
        overrides.append(Override("robot.right_arm", right_arm, f"--right-arm {right_arm}"))
    config = session.loaded.with_overrides(overrides).config
    export = export_workspace(robot_from(config.robot), config, Path(out))
    paths = [file.path for file in export.files]
    lines = [
        f"{export.folder}: packages {', '.join(export.packages)}",
        f"{len(paths)} files, {export.meshes_n} meshes, {export.pairs_n} allowed collisions",
        f"not run under ROS 2: {export.folder}/README.md says how each file was checked",
    ]
    document = {
        "folder": str(export.folder),
        "packages": list(export.packages),
        "files": {file.path: file.checked for file in export.files},
        "meshes": export.meshes_n,
        "allowed_collisions": export.pairs_n,
        "exit_code": int(ExitCode.PASS),
    }
    session.finish(document, lines)
    session.say(f"next: cd {export.folder} && colcon build --symlink-install")
    return ExitCode.PASS
