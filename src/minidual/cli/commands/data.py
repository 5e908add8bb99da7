"""`minidual data augment | check | stats | merge | split | show`."""

from typing import Annotated

import typer

from minidual.cli.execute import run_tool
from minidual.cli.session import Session
from minidual.errors import ExitCode
from minidual.gate.stage import ToolResult
from minidual.stages.registry import DATA_AUGMENT

_PLACE = "A LeRobot v3 dataset, a recording, a run, HDF5 episodes (ALOHA's, too), or one file."
Place = Annotated[str, typer.Argument(metavar="PATH", help=_PLACE)]
NewFolder = Annotated[str, typer.Option("--out", metavar="NEW", help="New folder.")]


def data_augment(
    *,
    place: Annotated[
        str,
        typer.Argument(metavar="PATH", help="A run, a recording, or a folder of HDF5 episodes."),
    ],
    episodes: Annotated[
        int | None,
        typer.Option(help="New demonstrations to keep (default: 200)."),
    ] = 200,
    demonstrations: Annotated[
        int | None,
        typer.Option(help="Move at most so many, the first (default: all)."),
    ] = None,
    task: Annotated[
        str | None,
        typer.Option(help="Task of the demonstrations (default: the run's)."),
    ] = None,
    conditions: Annotated[
        str | None,
        typer.Option(help="Conditions that the episodes take in turn (default: randomised)."),
    ] = None,
    attempts: Annotated[
        int | None,
        typer.Option(help="Most attempts (default: four for each episode)."),
    ] = None,
    session: Session,
) -> ExitCode:
    """Multiply demonstrations of a carry: move them to new starts and goals, and replay them.

    Only those that pass the task's success test in the simulator are kept; the others are kept
    apart, with the reason. The result is a recording, which train-act --dataset reads.

    Examples:
        minidual data augment runs/standard --demonstrations 10 --episodes 200
        minidual data augment by-hand --task pot_lift --conditions clean,randomised
    """
    options = {
        "path": place,
        "episodes": episodes,
        "demonstrations": demonstrations,
        "task": task,
        "conditions": conditions,
        "attempts": attempts,
    }
    return run_tool(session, DATA_AUGMENT, options)


def data_check(*, place: Place, session: Session) -> ExitCode:
    """Name every fault of demonstrations of any origin; the exit code is 1 if there is one.

    Examples:
        minidual data check runs/standard
        minidual data check ~/datasets/cups --json
    """
    from minidual.robot.pair import robot_from
    from minidual.stages.data_tools import check

    return _finished(session, check(place, robot_from(session.loaded.config.robot)))


def data_stats(
    *,
    place: Place,
    csv: Annotated[
        str | None,
        typer.Option(help="Write a row for each episode here (.csv)."),
    ] = None,
    session: Session,
) -> ExitCode:
    """Say what demonstrations hold: durations, ranges, coverage, effort peaks.

    Examples:
        minidual data stats runs/standard
        minidual data stats ~/datasets/cups --csv cups.csv
    """
    from minidual.robot.pair import robot_from
    from minidual.stages.data_tools import stats

    return _finished(session, stats(place, robot_from(session.loaded.config.robot), csv))


def data_merge(
    *,
    places: Annotated[list[str], typer.Argument(metavar="PATH...", help=_PLACE)],
    out: NewFolder,
    session: Session,
) -> ExitCode:
    """Join demonstrations of one format into a new folder.

    Examples:
        minidual data merge runs/standard runs/by-hand --out both
    """
    from minidual.robot.pair import robot_from
    from minidual.stages.data_tools import merge_data

    robot = robot_from(session.loaded.config.robot)
    return _finished(session, merge_data(places, out, robot))


def data_split(
    *,
    place: Place,
    out: NewFolder,
    parts: Annotated[
        str,
        typer.Option(metavar="NAME=SHARE,...", help="Parts and their shares of the episodes."),
    ] = "train=0.9,test=0.1",
    session: Session,
) -> ExitCode:
    """Divide demonstrations into parts, drawn by --seed.

    Examples:
        minidual data split runs/standard --out parts --parts train=0.8,test=0.2
    """
    from minidual.robot.pair import robot_from
    from minidual.stages.data_tools import split_data

    config = session.loaded.config
    robot = robot_from(config.robot)
    return _finished(session, split_data(place, parts, out, robot, config.seed))


def data_show(
    *,
    place: Place,
    out: Annotated[
        str | None,
        typer.Option(help="Page to write (.html, default: demonstrations.html)."),
    ] = None,
    rrd: Annotated[
        str | None,
        typer.Option(help="Write a recording for the viewer rerun here instead (.rrd)."),
    ] = None,
    episodes: Annotated[
        str | None,
        typer.Option(metavar="NUMBERS", help="Episodes, such as 0,3,7-9 (default: the first 5)."),
    ] = None,
    session: Session,
) -> ExitCode:
    """Write an offline page with films, signals and faults of demonstrations.

    Examples:
        minidual data show runs/standard --out demonstrations.html
        minidual data show ~/datasets/cups --episodes 0-9 --rrd cups.rrd
    """
    from minidual.robot.pair import robot_from
    from minidual.stages.data_tools import show

    robot = robot_from(session.loaded.config.robot)
    return _finished(session, show(place, robot, out, rrd, episodes))


def _finished(session: Session, result: ToolResult) -> ExitCode:
    """Print a result; return its exit code."""
    for note in result.notes:
        session.say(note)
    session.finish({**result.data, "exit_code": int(result.exit_code)}, result.lines)
    return result.exit_code
