"""One writer at a time in a run folder.

The kernel releases the lock when the process dies. Workers start with exec, which closes the file; a fork would keep it.
"""

import fcntl
import json
import os
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

from minidual.durable import make_folder, now_text, read_json, require
from minidual.errors import DataError, UsageError

LOCK_FILE = ".lock"


@contextmanager
def run_lock(folder: Path, command: str, name: str = LOCK_FILE) -> Generator[None]:
    """Hold the lock `name` of a run folder; UsageError if another process does."""
    if (stream := _acquired(folder, name)) is None:
        who = f"run '{folder.name}' is being written by {(held_by(folder / name) or (0, 'another process'))[1]}"
        remedy = (
            f"wait for it to end, or work in another run with --run NAME (this one is {folder})"
        )
        raise UsageError(who, remedy=remedy)
    with stream:
        try:
            stream.truncate(0)
            json.dump({"pid": os.getpid(), "command": command, "since": now_text()}, stream)
            stream.flush()
            yield
        finally:
            stream.truncate(0)
            if (
                name != LOCK_FILE or len([*folder.iterdir()]) == 1
            ):  # a tool's, or of a command that wrote nothing
                (folder / name).unlink(missing_ok=True)
                with suppress(OSError):
                    folder.rmdir()


def _acquired(folder: Path, name: str) -> TextIO | None:
    """Return the locked file, or None after 0.2 s: `held_by` takes a shared lock for an instant."""
    for _ in range(5):
        make_folder(folder)
        with suppress(
            BlockingIOError,
            FileNotFoundError,
        ):  # the last holder has just removed the file
            require(path := folder / name, "file")
            stream = path.open("a+", encoding="utf-8")
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(stream.fileno()), path.stat()):
                return stream
        time.sleep(0.04)
    return None


def lock_holders(folder: Path) -> dict[int, str]:
    """Return the holders of all locks in a run folder, "process 12 (minidual carry, since ...)", by process id.

    A process counts if it has the file of its lock open.
    """
    import psutil  # 40 ms that other commands do not need

    found: dict[int, str] = {}
    for path in sorted(folder.glob(".*lock")):
        pid, text = held_by(path) or (0, "")
        with suppress(psutil.Error, TypeError):
            if str(path.resolve()) in {opened.path for opened in psutil.Process(pid).open_files()}:
                found[pid] = text
    return found


def held_by(path: Path) -> tuple[int, str] | None:
    """Return a lock's holder as process id (0 if unreadable) and name; None if nobody holds it."""
    require(path, "file")
    try:
        with suppress(FileNotFoundError, NotADirectoryError), path.open(encoding="utf-8") as stream:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        with suppress(DataError, KeyError, TypeError):
            record = read_json(path, 10_000)
            return record[
                "pid"
            ], f"process {record['pid']} ({record['command']}, since {record['since']})"
        return 0, "another process"
    except OSError as error:
        raise DataError(
            f"{path} cannot be read: {error.strerror}",
            remedy="change its permissions",
        ) from error
    return None
