"""Real processes: signals at random times, closed and full streams, poor environments."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import psutil

from minidual.errors import ExitCode
from scripts.campaign.case import Case, Place, Ran, Result, command, judge


def _default_signals() -> None:
    """A background job would ignore Ctrl-C, as it should; here it is what is tried."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def start(place: Place, words: Sequence[str], **options: Any) -> subprocess.Popen[Any]:
    """Start `minidual` in a session of its own, both streams in files."""
    streams = {name: (place.folder / f".{name}").open("wb") for name in ("stdout", "stderr")}
    return subprocess.Popen(
        [sys.executable, "-m", "minidual.cli", *words],
        stdin=subprocess.DEVNULL,
        start_new_session=True,
        preexec_fn=_default_signals,
        cwd=place.folder,
        **streams,
        **options,
    )


def ended(
    process: subprocess.Popen[bytes],
    idle_s: float = 30.0,
    busy_s: float = 90.0,
) -> int | None:
    """Return the exit code, or None after killing what hangs: no CPU time in `idle_s`, or more than `busy_s` of it."""
    used_s = 0.0
    moved = time.monotonic()
    while (code := process.poll()) is None:
        now_s = _cpu_s(process.pid)
        if now_s > used_s:
            used_s = now_s
            moved = time.monotonic()
        if time.monotonic() - moved > idle_s or used_s > busy_s:
            process.kill()
            process.wait()
            return None
        time.sleep(0.05)
    return code


def _cpu_s(session: int) -> float:
    """Return the CPU time of a session's processes [s]."""
    total = 0.0
    for process in _members(session):
        with contextlib.suppress(psutil.NoSuchProcess):
            times = process.cpu_times()
            total += times.user + times.system
    return total


def said(place: Place, code: int) -> Ran:
    """Return what a process from `start` wrote."""
    texts = [
        (place.folder / f".{name}").read_bytes().decode("utf-8", errors="replace")
        for name in ("stdout", "stderr")
    ]
    return Ran(code, *texts)


def orphans(session: int, patience_s: float = 2.0) -> list[str]:
    """Return the processes of a session that live on after a while, and end them."""
    deadline = time.monotonic() + patience_s
    while (left := _members(session)) and time.monotonic() < deadline:
        time.sleep(0.1)
    named = []
    for process in left:
        try:
            named.append(f"{process.pid} {' '.join(process.cmdline())[:120]}")
            process.kill()
        except psutil.NoSuchProcess:
            continue
    return named


def _members(session: int) -> list[psutil.Process]:
    found = []
    for process in psutil.process_iter():
        try:
            if os.getsid(process.pid) == session and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
        except (ProcessLookupError, psutil.NoSuchProcess):
            continue
    return found


SIGNALLED = {
    "--help": (1.0, ("--help",)),
    "status": (2.5, ("status",)),
    "config show": (1.5, ("config", "show")),
    "explain": (2.5, ("explain", "carry")),
    "plan --acm": (4.0, ("plan", "--acm")),
    "plan --to": (6.0, ("plan", "--to", "ready")),
    "report": (3.0, ("report", "--force")),
    "env-check": (9.0, ("env-check", "--force")),
    "plan": (12.0, ("plan", "--queries", "2", "--yes", "--force")),
}
"""Commands that are interrupted, and how long they take at most [s]."""
BEFORE_PYTHON_S = 0.4
"""Until then the interpreter may not have reached the program, and the signal's own end is right."""


def signal_cases(source: Path) -> Iterator[Case]:
    """Each command, each signal, at random times; sometimes twice."""
    for name in SIGNALLED:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            for time_ in range(6):
                yield Case(
                    f"{name} {number.name} {time_}",
                    partial(_signalled, name, number),
                    limit_s=60.0,
                )


def _signalled(name: str, number: signal.Signals, place: Place, result: Result) -> None:
    longest, words = SIGNALLED[name]
    selecting = () if words[0] in ("--help", "config") else place.options()
    process = start(place, [*words, *selecting])
    delay = float(
        place.rng.uniform(0.02, longest)
        if place.rng.random() < 0.6
        else place.rng.uniform(0.02, 0.8),
    )
    time.sleep(delay)
    was_running = process.poll() is None
    process.send_signal(number)
    twice = place.rng.random() < 0.25
    if twice:
        time.sleep(float(place.rng.uniform(0.0, 0.2)))
        process.send_signal(number)
    began = time.monotonic()
    code = ended(process)
    if code is None:
        result.forbidden.append(f"a hang after {number.name} at {delay:.2f} s")
        return
    if time.monotonic() - began > 20.0:
        result.forbidden.append(
            f"ends {time.monotonic() - began:.1f} s after {number.name} at {delay:.2f} s",
        )
    ran = said(place, code)
    allowed: list[int] = [ExitCode.PASS, ExitCode.INTERRUPTED]
    if twice and "minidual: interrupted" in ran.err:
        allowed.append(-number)
    if delay < BEFORE_PYTHON_S and ran.code in (1, -number) and "/minidual/" not in ran.err:
        result.saw("before the program began")
        return
    judge(result, f"{number.name} at {delay:.2f} s", ran, allowed)
    result.saw(f"exit {code}" if was_running else "ended before")
    if left := orphans(process.pid):
        result.forbidden.append(f"orphans 2 s after {number.name} at {delay:.2f} s: {left}")
    if "--force" in words:
        ran = command(place, "status", "--json", *place.options())
        if judge(result, "status", ran, [ExitCode.PASS]):
            row = next(row for row in ran.document()["stages"] if row["name"] == words[0])
            if row["state"] not in ("pass", "fail"):
                result.forbidden.append(
                    f"a lost finished result: {words[0]} is {row['state']} {row['reasons']}",
                )
            warned = any("interrupted" in text for text in row["warnings"])
            if (
                code == ExitCode.INTERRUPTED
                and (place.runs / "smoke" / f".{words[0]}.tmp").exists()
                and not warned
            ):
                result.forbidden.append("an attempt was interrupted and status does not say so")


ENVIRONMENTS = {
    "pipe closed early": "{} | head -1",
    "pipe closed at once": "{} | true",
    "stdout closed": "{} >&-",
    "stderr closed": "{} 2>&-",
    "both closed": "{} >&- 2>&-",
    "stdin closed": "{} <&-",
    "all closed": "{} <&- >&- 2>&-",
    "stdout full": "{} > /dev/full",
    "stderr full": "{} 2> /dev/full",
    "both full": "{} > /dev/full 2>&1",
    "folder deleted": "mkdir gone && cd gone && rmdir ../gone && {}",
    "no HOME": "env -u HOME {}",
    "HOME nowhere": "env HOME=/no/such/home {}",
    "no TERM": "env -u TERM {}",
    "TERM unknown": "env TERM=nonsense {}",
    "one column": "env COLUMNS=1 {}",
    "columns wrong": "env COLUMNS=abc LINES=-3 {}",
    "plain C": "env LANG=C LC_ALL=C PYTHONUTF8=0 PYTHONCOERCECLOCALE=0 {}",
    "ASCII": "env LC_ALL=POSIX PYTHONIOENCODING=ascii {}",
    "no environment": "env -i PATH=$PATH PYTHONPATH=$PYTHONPATH {}",
    "TMPDIR nowhere": "env TMPDIR=/no/such/folder {}",
    "cache nowhere": "env MINIDUAL_CACHE=/dev/null/x XDG_CACHE_HOME=/dev/null/x {}",
    "cache full": "env MINIDUAL_CACHE=/dev/full {}",
    "few files": "ulimit -n 40; {}",
    "no file may grow": "ulimit -f 0; {}",
    "runs in a file": "touch f && env MINIDUAL_RUNS=f {}",
}
COMMANDS = {
    "--help": "--help",
    "--version": "--version",
    "status": "status {}",
    "status --json": "status --json {}",
    "config show": "config show",
    "explain": "explain carry {}",
    "wrong": "status --set nonsense=1",
    "plan --acm": "plan --acm",
    "plan --to": "plan --to ready --group left_arm",
}


def stream_cases(source: Path) -> Iterator[Case]:
    """Each command with each kind of broken streams and environment."""
    for environment in ENVIRONMENTS:
        for name in COMMANDS:
            yield Case(f"{name}, {environment}", partial(_streams, name, environment), limit_s=60.0)


def _streams(name: str, environment: str, place: Place, result: Result) -> None:
    options = " ".join(place.options())
    line = f"{sys.executable} -m minidual.cli {COMMANDS[name].format(options)}"
    script = f"set -o pipefail; {ENVIRONMENTS[environment].format(line)}"
    with (place.folder / ".stdout").open("wb") as out, (place.folder / ".stderr").open("wb") as err:
        process = subprocess.Popen(
            ["bash", "-c", script],
            stdout=out,
            stderr=err,
            start_new_session=True,
            cwd=place.folder,
        )
    code = ended(process)
    if code is None:
        orphans(process.pid, 0.0)
        result.forbidden.append("a hang")
        return
    ran = said(place, code)
    allowed = [ExitCode.USAGE] if name == "wrong" else [ExitCode.PASS]
    if environment in (
        "stdout full",
        "both full",
        "few files",
        "no file may grow",
        "TMPDIR nowhere",
        "no environment",
    ):
        allowed = [ExitCode.USAGE, ExitCode.ENVIRONMENT]
    if environment in (
        "few files",
        "no file may grow",
        "TMPDIR nowhere",
        "no environment",
        "folder deleted",
        "stderr full",
    ):
        allowed += [ExitCode.PASS, ExitCode.USAGE, ExitCode.ENVIRONMENT]
    if environment == "no environment":
        allowed.append(ExitCode.ACCEPTANCE_FAILED)
    if environment == "runs in a file":
        allowed.append(ExitCode.USAGE)
    if environment == "both full" and name == "wrong":
        allowed = [ExitCode.USAGE]
    judge(result, f"{name}, {environment}", ran, allowed)
    if "Exception ignored" in ran.err:
        result.forbidden.append(f"noise at the end: {ran.err.strip().splitlines()[-1][:120]}")
    result.saw(f"exit {code}")
    if left := orphans(process.pid, 2.0):
        result.forbidden.append(f"orphans: {left}")
