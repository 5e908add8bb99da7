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

import numpy as np
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
    """Return the exit code of a process, or None after killing one that hangs.

    It hangs if it uses no processor time in `idle_s`, or more than `busy_s` of it.
    """
    used_s = 0.0
    progress_at_s = time.monotonic()
    while process.poll() is None:
        cpu_s = _cpu_s(process.pid)
        if cpu_s > used_s:
            used_s = cpu_s
            progress_at_s = time.monotonic()
        if time.monotonic() - progress_at_s > idle_s or used_s > busy_s:
            process.kill()
            process.wait()
            return None
        time.sleep(0.05)
    return process.returncode


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
    out = (place.folder / ".stdout").read_bytes().decode("utf-8", errors="replace")
    err = (place.folder / ".stderr").read_bytes().decode("utf-8", errors="replace")
    return Ran(code, out, err)


def orphans(session: int, patience_s: float = 2.0) -> list[str]:
    """Return the processes of a session that live on after a while, and end them."""
    deadline_s = time.monotonic() + patience_s
    left = _members(session)
    while left and time.monotonic() < deadline_s:
        time.sleep(0.1)
        left = _members(session)
    names: list[str] = []
    for process in left:
        try:
            names.append(f"{process.pid} {' '.join(process.cmdline())[:120]}")
            process.kill()
        except psutil.NoSuchProcess:
            continue
    return names


def _members(session: int) -> list[psutil.Process]:
    """Return the living processes of a session."""
    members: list[psutil.Process] = []
    for process in psutil.process_iter():
        try:
            is_member = os.getsid(process.pid) == session
            if is_member and process.status() != psutil.STATUS_ZOMBIE:
                members.append(process)
        except (ProcessLookupError, psutil.NoSuchProcess):
            continue
    return members


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
            for repetition in range(6):
                body = partial(_signalled, name, number)
                yield Case(f"{name} {number.name} {repetition}", body, limit_s=60.0)


def _signalled(name: str, number: signal.Signals, place: Place, result: Result) -> None:
    """Send a signal to a command at a random time."""
    longest_s, words = SIGNALLED[name]
    selecting = () if words[0] in ("--help", "config") else place.options()
    process = start(place, [*words, *selecting])
    delay_s = _random_delay_s(longest_s, place.rng)
    time.sleep(delay_s)
    was_running = process.poll() is None
    process.send_signal(number)
    twice = place.rng.random() < 0.25
    if twice:
        time.sleep(float(place.rng.uniform(0.0, 0.2)))
        process.send_signal(number)
    event = f"{number.name} at {delay_s:.2f} s"
    began_s = time.monotonic()
    code = ended(process)
    if code is None:
        result.forbidden.append(f"a hang after {event}")
        return
    took_s = time.monotonic() - began_s
    if took_s > 20.0:
        result.forbidden.append(f"ends {took_s:.1f} s after {event}")
    ran = said(place, code)
    died_of_signal = ran.code in (1, -number) and "/minidual/" not in ran.err
    if delay_s < BEFORE_PYTHON_S and died_of_signal:
        result.saw("before the program began")
        return
    allowed: list[int] = [ExitCode.PASS, ExitCode.INTERRUPTED]
    if twice and "minidual: interrupted" in ran.err:
        allowed.append(-number)
    judge(result, event, ran, allowed)
    result.saw(f"exit {code}" if was_running else "ended before")
    left = orphans(process.pid)
    if left:
        result.forbidden.append(f"orphans 2 s after {event}: {left}")
    if "--force" in words:
        _check_stage(words[0], code, place, result)


def _random_delay_s(longest_s: float, rng: np.random.Generator) -> float:
    """Return a time at which a command of `longest_s` is interrupted, more often an early one."""
    anywhere = rng.random() < 0.6
    return float(rng.uniform(0.02, longest_s if anywhere else 0.8))


def _check_stage(stage: str, code: int, place: Place, result: Result) -> None:
    """Check that the stage's finished result is still there, and that its attempt is named."""
    ran = command(place, "status", "--json", *place.options())
    if not judge(result, "status", ran, [ExitCode.PASS]):
        return
    row = next(row for row in ran.document()["stages"] if row["name"] == stage)
    if row["state"] not in ("pass", "fail"):
        result.forbidden.append(
            f"a lost finished result: {stage} is {row['state']} {row['reasons']}",
        )
    warned = any("interrupted" in warning for warning in row["warnings"])
    left_attempt = (place.runs / "smoke" / f".{stage}.tmp").exists()
    if code == ExitCode.INTERRUPTED and left_attempt and not warned:
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


_CANNOT_WORK = (
    "stdout full",
    "both full",
    "few files",
    "no file may grow",
    "TMPDIR nowhere",
    "no environment",
)
"""Environments in which a command may refuse to work."""
_MAY_WORK = (
    "few files",
    "no file may grow",
    "TMPDIR nowhere",
    "no environment",
    "folder deleted",
    "stderr full",
)
"""Environments in which a command may work or refuse to."""


def _streams(name: str, environment: str, place: Place, result: Result) -> None:
    """Run a command in a poor environment."""
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
    judge(result, f"{name}, {environment}", ran, _allowed_codes(name, environment))
    if "Exception ignored" in ran.err:
        last_line = ran.err.strip().splitlines()[-1]
        result.forbidden.append(f"noise at the end: {last_line[:120]}")
    result.saw(f"exit {code}")
    left = orphans(process.pid, 2.0)
    if left:
        result.forbidden.append(f"orphans: {left}")


def _allowed_codes(name: str, environment: str) -> list[int]:
    """Return the exit codes that a command may have in an environment."""
    if environment == "both full" and name == "wrong":
        return [ExitCode.USAGE]
    codes: list[int] = [ExitCode.USAGE] if name == "wrong" else [ExitCode.PASS]
    if environment in _CANNOT_WORK:
        codes = [ExitCode.USAGE, ExitCode.ENVIRONMENT]
    if environment in _MAY_WORK:
        codes += [ExitCode.PASS, ExitCode.USAGE, ExitCode.ENVIRONMENT]
    if environment == "no environment":
        codes.append(ExitCode.ACCEPTANCE_FAILED)
    if environment == "runs in a file":
        codes.append(ExitCode.USAGE)
    return codes
