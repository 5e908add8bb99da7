"""A real process killed, interrupted or locked out in the middle of a stage."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from minidual.errors import ExitCode, UsageError
from minidual.gate.lock import LOCK_FILE, held_by, run_lock
from tests.support.pipeline_toys import Bench

ROOT = Path(__file__).parents[2]


def listen_to_ctrl_c():
    """Take signals as a terminal's child does.

    A background job ignores SIGINT, a child of nohup SIGHUP.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


@pytest.fixture
def sleeper(tmp_path):
    """A process in the middle of stage `first` of the run `toys`."""
    marker = tmp_path / "marker"
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.support.pipeline_toys", str(tmp_path / "runs"), str(marker)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=listen_to_ctrl_c,
    )
    deadline = time.monotonic() + 30
    while not marker.exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    assert marker.exists(), process.communicate()
    yield process
    if process.poll() is None:
        process.kill()
    process.communicate()


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path / "runs")


def test_running_stage_holds_the_lock_and_names_its_process(bench, sleeper):
    assert bench.states() == ["incomplete", "blocked", "blocked"]
    assert "still running" in bench.gate().state("first").why()
    assert f"process {sleeper.pid}" in str(held_by(bench.store.folder / LOCK_FILE))
    with pytest.raises(
        UsageError,
        match=rf"being written by process {sleeper.pid} \(minidual first",
    ):
        bench.runner().run("first")


def test_killed_stage_is_incomplete_and_the_rerun_mends_it(bench, sleeper):
    os.kill(sleeper.pid, signal.SIGKILL)
    sleeper.wait()
    assert bench.states() == ["incomplete", "blocked", "blocked"]
    assert "the process was killed" in bench.gate().state("first").why()
    assert (bench.store.folder / ".first.tmp").is_dir()
    assert held_by(bench.store.folder / LOCK_FILE) is None, "the lock dies with its process"
    assert bench.runner().run("first").exit_code == ExitCode.PASS
    assert bench.states() == ["pass", "missing", "blocked"]
    assert not (bench.store.folder / ".first.tmp").exists()


def test_a_killed_attempt_does_not_run_on_while_another_command_holds_the_lock(bench, sleeper):
    os.kill(sleeper.pid, signal.SIGKILL)
    sleeper.wait()
    with run_lock(bench.store.folder, "minidual second"):
        attempt = bench.store.attempt("first")
        assert (attempt.state, attempt.pid) == ("interrupted", sleeper.pid)
        assert "the process was killed" in bench.gate().state("first").why()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_exit_130_with_one_line_and_leave_a_mark(bench, sleeper, number):
    sleeper.send_signal(number)
    stdout, stderr = sleeper.communicate(timeout=60)
    assert sleeper.returncode == ExitCode.INTERRUPTED
    assert stdout == ""
    assert [line for line in stderr.splitlines() if line.startswith("minidual: interrupted")]
    assert "Traceback" not in stderr
    attempt = json.loads((bench.store.folder / ".first.tmp" / "attempt.json").read_text())
    assert attempt["state"] == "interrupted"
    assert bench.states()[0] == "incomplete"
