"""`minidual stop`."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from minidual import emergency
from minidual.cli.session import Session
from minidual.errors import DataError, ExitCode, UsageError
from minidual.gate.lock import lock_holders


def stop(
    *,
    name: Annotated[
        str | None,
        typer.Argument(metavar="RUN", help="Name of a run; none stops all."),
    ] = None,
    session: Session,
) -> ExitCode:
    """Emergency stop: the arms of running commands stop, and the commands end.

    Without a name it stops every run.

    Examples:
        minidual stop
        minidual stop standard
    """
    run = _named_run(session, name)
    if run is not None:
        holders = lock_holders(session.root / run)
    else:
        holders: dict[int, str] = {}
        for folder in _runs(session.root):
            holders |= _readable_holders(folder)
    for pid in holders:
        with suppress(ProcessLookupError):  # it has just ended
            os.kill(pid, emergency.SIGNAL)
    if not holders:
        raise _nothing_to_stop(session.root, run)
    lines = [f"emergency stop sent to {text}" for text in holders.values()]
    session.finish({"stopped": sorted(holders), "exit_code": int(ExitCode.PASS)}, lines)
    return ExitCode.PASS


def _named_run(session: Session, name: str | None) -> str | None:
    """Return the run that was named, as argument, by --run or by --profile; None for every run."""
    common = session.common
    run = None
    if common.run is not None or common.profile != "standard":
        run = session.store.run
    remedy = "minidual stop RUN stops one run, minidual stop every run"
    if name == "":
        raise UsageError("the name of the run is empty", remedy=remedy)
    if name is not None and run not in (None, name):
        raise UsageError(f"two runs are named, '{name}' and '{run}'", remedy=remedy)
    return name or run


def _nothing_to_stop(root: Path, run: str | None) -> UsageError:
    place = f"the runs in {root}" if run is None else f"run '{run}' of {root}"
    if not root.is_dir():
        place += ", which is no folder"
    busy = [folder.name for folder in _runs(root) if _readable_holders(folder)]
    if busy:
        names = ", ".join(busy)
        remedy = f"a command is working in {names}; minidual stop, without a name, stops all"
    else:
        remedy = (
            "--runs-dir DIR names another folder of runs; kill -USR1 PID stops any minidual process"
        )
    return UsageError(f"nothing to stop: no command is working in {place}", remedy=remedy)


def _runs(root: Path) -> list[Path]:
    return sorted(root.glob("*/"))


def _readable_holders(folder: Path) -> dict[int, str]:
    """Return who works in a run.

    A damaged lock counts as nobody's: it keeps no other run from being stopped.
    """
    try:
        return lock_holders(folder)
    except DataError:
        return {}
