"""Worker processes: results in order, and none outlives the process that started them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from minidual.workers import in_workers


def test_results_come_in_order_and_one_worker_is_this_process() -> None:
    assert list(in_workers(lambda item: (item, os.getpid()), [3, 1, 2], 1)) == [
        (n, os.getpid()) for n in (3, 1, 2)
    ]
    assert list(in_workers(lambda item: 2 * item, [], 4)) == []


def test_signals_to_the_group_are_left_to_the_starter() -> None:
    signals = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    for blocked in in_workers(lambda _: signal.pthread_sigmask(signal.SIG_BLOCK, ()), [0, 1], 2):
        assert signals <= blocked
        assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before


KEPT: list[bytes] = []


def _grown(item: int) -> int:
    time.sleep(0.6)  # loky looks once a second
    KEPT.append(b"x" * 150_000_000)
    return os.getpid()


def test_a_worker_that_imports_much_is_not_replaced(recwarn: pytest.WarningsRecorder) -> None:
    """joblib replaces a worker that grows by 300 MB, as the first policy does, and warns."""
    pids = set(in_workers(_grown, range(8), 2))
    assert len(pids) == 2
    assert not [w for w in recwarn if "A worker stopped" in str(w.message)]


INTERRUPTED = """
import pathlib, sys, time
from minidual.cli import process as cli
folder = pathlib.Path(sys.argv[1])

def work(item):
    (folder / str(item)).touch()
    time.sleep(0.1)

def _run():
    from minidual.workers import in_workers
    (folder / "begun").touch()
    list(in_workers(work, range(10_000), 2))

cli._run = _run
cli.main()
"""


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_group_that_is_interrupted_at_any_time_ends_in_130_without_traceback(
    number: int,
    tmp_path: Path,
) -> None:
    for delay_s in (0.0, 0.1, 0.3, 0.6, 1.0, 1.5, 3.0):
        folder = tmp_path / str(delay_s)
        folder.mkdir()
        command = [sys.executable, "-c", INTERRUPTED, str(folder)]
        with subprocess.Popen(
            command,
            start_new_session=True,
            stderr=subprocess.PIPE,
            text=True,
        ) as starter:
            _until((folder / "begun").exists, 30.0)
            time.sleep(delay_s)
            children = psutil.Process(starter.pid).children(recursive=True)
            os.killpg(starter.pid, number)
            _, err = starter.communicate(timeout=30.0)
        assert (starter.returncode, err) == (130, "minidual: interrupted\n")
        _until(lambda pids=[child.pid for child in children]: not any(map(_running, pids)), 10.0)


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
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(tmp_path)],
        start_new_session=True,
    ) as starter:
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


SLOW_TO_BEGIN = """
import pathlib, sys, time
from minidual.workers import in_workers
folder = pathlib.Path(sys.argv[1])

class Heavy:
    def __reduce__(self):  # a worker imports for half a minute before its first item
        return time.sleep, (30.0,)

(folder / "begun").touch()
list(in_workers(print, [Heavy(), Heavy()], 2))
"""


def test_workers_that_still_import_end_with_their_starter_too(tmp_path: Path) -> None:
    """They look for their starter from their begin on, not from their first item on."""
    with subprocess.Popen([sys.executable, "-c", SLOW_TO_BEGIN, str(tmp_path)]) as starter:
        _until((tmp_path / "begun").exists, 30.0)
        _until(lambda: len(psutil.Process(starter.pid).children(recursive=True)) >= 3, 30.0)
        time.sleep(3.0)
        children = [child.pid for child in psutil.Process(starter.pid).children(recursive=True)]
        starter.kill()
    _until(lambda: not any(map(_running, children)), 10.0)
