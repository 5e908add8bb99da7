"""One writer at a time in a run folder.

The kernel releases the lock when its process dies. Workers are started with exec, which closes the file: a fork would
keep the lock.
"""

from __future__ import annotations

import fcntl
import json
import os
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from minidual.errors import UsageError
from minidual.gate.clock import now_text

LOCK_FILE = ".lock"


@contextmanager
def run_lock(folder: Path, command: str) -> Generator[None]:
    """Hold the lock of a run folder; UsageError names the process that holds it."""
    folder.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(folder / LOCK_FILE, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    if not _acquired(descriptor):
        holder = lock_holder_text(folder)
        os.close(descriptor)
        raise UsageError(
            f"run '{folder.name}' is being written by {holder}",
            remedy=f"wait for it to end, or work in another run with --run NAME (this one is {folder})",
        )
    try:
        text = json.dumps({"pid": os.getpid(), "command": command, "since": now_text()})
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, text.encode(), 0)
        yield
    finally:
        os.ftruncate(descriptor, 0)
        os.close(descriptor)


def _acquired(descriptor: int) -> bool:
    """Try for 0.2 s: `lock_is_held` takes a shared lock for an instant."""
    for _ in range(5):
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(0.04)
        else:
            return True
    return False


def lock_is_held(folder: Path) -> bool:
    """Return whether a process holds the lock of a run folder."""
    try:
        descriptor = os.open(folder / LOCK_FILE, os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


def lock_holder_text(folder: Path) -> str:
    """Return "process 12 (minidual carry, since ...)" from the lock file, or "another process"."""
    try:
        record = json.loads((folder / LOCK_FILE).read_text(encoding="utf-8"))
        return f"process {record['pid']} ({record['command']}, since {record['since']})"
    except (OSError, ValueError, KeyError, TypeError):
        return "another process"
