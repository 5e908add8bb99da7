"""One writer at a time in a run folder.

The kernel releases the lock when the process dies. Workers start with exec, which closes the file;
a fork would keep it.
"""

import fcntl
import json
import os
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple, TextIO

from minidual.durable import make_folder, now_text, read_json, require
from minidual.errors import DataError, UsageError

LOCK_FILE = ".lock"
_TRIES_N = 5
_TRY_EVERY_S = 0.04
_RECORD_BYTES_MAX = 10_000


class LockHolder(NamedTuple):
    """The process that holds a lock.

    Attributes:
        pid: 0 if it cannot be read: the holder is just writing it down.
        name: "process 12 (minidual carry, since ...)".
    """

    pid: int
    name: str


_UNREADABLE = LockHolder(0, "another process")


@contextmanager
def run_lock(folder: Path, command: str, name: str = LOCK_FILE) -> Generator[None]:
    """Hold the lock `name` of a run folder; UsageError if another process does."""
    stream = _acquired(folder, name)
    if stream is None:
        holder = held_by(folder / name) or _UNREADABLE
        raise UsageError(
            f"run '{folder.name}' is being written by {holder.name}",
            remedy="wait for it to end, or work in another run with --run NAME "
            f"(this one is {folder})",
        )
    with stream:
        try:
            stream.truncate(0)
            json.dump({"pid": os.getpid(), "command": command, "since": now_text()}, stream)
            stream.flush()
            yield
        finally:
            stream.truncate(0)
            if name != LOCK_FILE or _wrote_nothing(folder):
                (folder / name).unlink(missing_ok=True)
                with suppress(OSError):
                    folder.rmdir()


def _wrote_nothing(folder: Path) -> bool:
    """Return whether a run folder holds its lock alone."""
    return len([*folder.iterdir()]) == 1


def _acquired(folder: Path, name: str) -> TextIO | None:
    """Return the locked file, or None after 0.2 s: `held_by` takes a shared lock for an instant."""
    for _ in range(_TRIES_N):
        make_folder(folder)
        # FileNotFoundError: the last holder has just removed the file.
        with suppress(BlockingIOError, FileNotFoundError):
            path = folder / name
            require(path, "file")
            stream = path.open("a+", encoding="utf-8")
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(stream.fileno()), path.stat()):
                return stream
        time.sleep(_TRY_EVERY_S)
    return None


def lock_holders(folder: Path) -> dict[int, str]:
    """Return {process id: name} of the holders of all locks in a run folder.

    A process counts if it has the file of its lock open.
    """
    import psutil  # takes 40 ms

    holders: dict[int, str] = {}
    for path in sorted(folder.glob(".*lock")):
        holder = held_by(path)
        if holder is None:
            continue
        with suppress(psutil.Error, TypeError):
            open_files = {file.path for file in psutil.Process(holder.pid).open_files()}
            if str(path.resolve()) in open_files:
                holders[holder.pid] = holder.name
    return holders


def held_by(path: Path) -> LockHolder | None:
    """Return a lock's holder; None if it is free."""
    require(path, "file")
    try:
        with suppress(FileNotFoundError, NotADirectoryError), path.open(encoding="utf-8") as stream:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return _recorded_holder(path)
    except OSError as error:
        raise DataError(
            f"{path} cannot be read: {error.strerror}",
            remedy="change its permissions",
        ) from error
    return None


def _recorded_holder(path: Path) -> LockHolder:
    try:
        record: Any = read_json(path, _RECORD_BYTES_MAX)
        pid = record["pid"]
        return LockHolder(pid, f"process {pid} ({record['command']}, since {record['since']})")
    except (DataError, KeyError, TypeError):
        return _UNREADABLE
