"""Processes beside the test: their first line says that they are ready."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager


def told(started: subprocess.Popen[str]) -> str:
    """Return the next line that a process says."""
    assert started.stdout is not None
    return started.stdout.readline().strip()


def started(*arguments: str) -> subprocess.Popen[str]:
    """Start Python; wait for the first line."""
    process = subprocess.Popen(
        [sys.executable, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert told(process)
    return process


@contextmanager
def running(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Start Python, and end it at the end of the block."""
    process = started(*arguments)
    try:
        yield process
    finally:
        process.kill()
        process.wait()
