"""Worker processes: results in order, and none outlives the process that started them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from minidual.workers import in_workers


def test_results_come_in_order_and_one_worker_is_this_process() -> None:
    assert list(in_workers(lambda item: (item, os.getpid()), [3, 1, 2], 1)) == [(n, os.getpid()) for n in (3, 1, 2)]
    assert list(in_workers(lambda item: 2 * item, [], 4)) == []


PROGRAM = """
import os, pathlib, sys, time
from minidual.workers import in_workers
folder = pathlib.Path(sys.argv[1])

def work(item):
    (folder / str(os.getpid())).touch()
    time.sleep(60.0)

list(in_workers(work, [0, 1], 2))
"""


def test_workers_end_when_their_starter_is_killed(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", PROGRAM, str(tmp_path)], start_new_session=True) as starter:
        _until(lambda: len(list(tmp_path.iterdir())) == 2, 30.0)
        starter.send_signal(signal.SIGKILL)
    workers = [int(path.name) for path in tmp_path.iterdir()]
    assert starter.pid not in workers
    _until(lambda: not any(_running(pid) for pid in workers), 10.0)


def _running(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def _until(condition, limit_s: float) -> None:
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end, f"not within {limit_s} s"
        time.sleep(0.05)
