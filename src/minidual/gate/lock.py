"""One writer at a time in a run folder.

The kernel releases the lock when the process dies. Workers start with exec, which closes the file; a fork would keep it.
"""

from __future__ import annotations

import fcntl
import json
import os
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

from minidual.durable import read_json, require
from minidual.errors import DataError, UsageError
from minidual.gate.clock import now_text

LOCK_FILE = ".lock"


@contextmanager
def run_lock(folder: Path, command: str) -> Generator[None]:
    """Hold the lock of a run folder; UsageError if another process does."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise UsageError(f"runs cannot be kept in {folder}: {error}", remedy="give another --runs-dir") from error
    with _lock_file(folder).open("a+", encoding="utf-8") as stream:
        if not _acquired(stream):
            raise UsageError(
                f"run '{folder.name}' is being written by {lock_holder(folder) or 'another process'}",
                remedy=f"wait for it to end, or work in another run with --run NAME (this one is {folder})",
            )
        try:
            stream.truncate(0)
            json.dump({"pid": os.getpid(), "command": command, "since": now_text()}, stream)
            stream.flush()
            yield
        finally:
            stream.truncate(0)


def _acquired(stream: TextIO) -> bool:
    """Try for 0.2 s: `lock_holder` takes a shared lock for an instant."""
    for _ in range(5):
        with suppress(BlockingIOError):
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        time.sleep(0.04)
    return False


def lock_holder(folder: Path) -> str | None:
    """Return the holder, "process 12 (minidual carry, since ...)", or None."""
    path = _lock_file(folder)
    try:
        with path.open(encoding="utf-8") as stream:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except BlockingIOError:
        try:
            record = read_json(path, 10_000)
            return f"process {record['pid']} ({record['command']}, since {record['since']})"
        except (DataError, KeyError, TypeError):
            return "another process"
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror}", remedy="change its permissions") from error
    return None


def _lock_file(folder: Path) -> Path:
    """Return the path of the lock; DataError if something else than a file is there."""
    require(folder / LOCK_FILE, "file")
    return folder / LOCK_FILE
