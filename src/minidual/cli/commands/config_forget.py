"""`minidual config forget`."""

from typing import Annotated

import typer

from minidual.cli.session import Session
from minidual.errors import DataError, ExitCode, UsageError, unknown_name
from minidual.gate.memory import Memory, as_typed, read_memory, without, write_memory


def config_forget(
    *,
    keys: Annotated[
        list[str] | None,
        typer.Argument(metavar="KEY", help="Values to forget, or sections; none forgets all."),
    ] = None,
    session: Session,
) -> ExitCode:
    """Forget values that were typed with --set or --seed in this run.

    The profile's values apply again. Finished stages that read a forgotten value become stale.

    Examples:
        minidual config forget carry.trials_n
        minidual config forget --run standard-box
    """
    session.require_run()
    memory = _memory(session)
    kept = {} if not keys else without(memory, keys)
    for key in keys or ():
        if without(memory, [key]) == memory:
            raise unknown_name("remembered value", key, memory)
    forgotten = {path: text for path, text in memory.items() if path not in kept}
    run = session.store.run
    passed = _passing(session)
    if session.store.folder.exists():
        with session.store.writing("minidual config forget", ()):
            write_memory(session.store.folder, kept)
    session.reload()
    passing = _passing(session)
    stale = [name for name in passed if name not in passing]
    lines = [f"run '{run}' forgot {' '.join(as_typed(forgotten)) or 'nothing'}"]
    if stale:
        lines.append(f"stale now: {', '.join(stale)}")
    document = {"run": run, "forgotten": forgotten, "remembered": kept, "stale": stale}
    session.finish(document, lines)
    return ExitCode.PASS


def _memory(session: Session) -> Memory:
    """Return what the run remembers; nothing if the file is damaged, so that it can be mended."""
    try:
        return read_memory(session.store.folder) or {}
    except DataError as error:
        session.say(error.message)
        return {}


def _passing(session: Session) -> list[str]:
    """Return the stages that pass under what is remembered; none if that is invalid."""
    try:
        gate = session.gate()
    except (UsageError, DataError):
        return []
    return [name for name in gate.table if gate.state(name).state == "pass"]
