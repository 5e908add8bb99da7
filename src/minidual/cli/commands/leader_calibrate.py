"""`minidual leader calibrate`."""

from pathlib import Path
from typing import Annotated

import typer

from minidual.cli.session import Session
from minidual.errors import ExitCode


def leader_calibrate(
    *,
    file: Annotated[
        str | None,
        typer.Argument(metavar="FILE", help="File of the GELLO arms (default: teleop.gello.file)."),
    ] = None,
    session: Session,
) -> ExitCode:
    """Find the offsets of GELLO arms and write them into their file.

    Hold both leader arms in the home posture of the arms, with open grippers.

    Examples:
        minidual leader calibrate gello.yaml
    """
    from minidual.demos.leaders.gello_calibration import calibrate
    from minidual.robot.pair import robot_from

    config = session.loaded.config
    path = Path(file or config.teleop.gello.file)
    calibrations = calibrate(path, robot_from(config.robot))
    arms: dict[str, object] = {}
    lines = [f"offsets written to {path}"]
    for side, calibration in calibrations.items():
        offsets = [f"{offset:+.3f}" for offset in calibration.arm.offsets_rad]
        off = [f"{value:+.2f}" for value in calibration.off_rad]
        lines.append(f"{side}: offsets {' '.join(offsets)} rad; held off by {' '.join(off)} rad")
        arms[side] = {
            "offsets_rad": list(calibration.arm.offsets_rad),
            "off_rad": [float(value) for value in calibration.off_rad],
        }
    session.finish({"file": str(path), "arms": arms, "exit_code": int(ExitCode.PASS)}, lines)
    return ExitCode.PASS
