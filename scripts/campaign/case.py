"""One case of the campaign: what it does in a process of its own, and what it may not do."""

from __future__ import annotations

import ctypes
import faulthandler
import json
import os
import re
import resource
import select
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from minidual.cli.app import run_command_line
from minidual.config.seeds import stream
from minidual.errors import ExitCode
from minidual.gate.table import StageTable
from minidual.stages.registry import STAGES, TOOLS

_MEMORY_BYTES = 8 << 30
_PR_SET_PDEATHSIG = 1
WAIT = 4.0
"""Other work on the machine may slow a case down by so much."""
_TRACEBACK = re.compile(
    r"Traceback \(most recent call last\)|^\s+File \".*\", line \d+",
    re.MULTILINE,
)
_RIGHT_TO_LEFT = "\u202e"
"""Shows what follows in another order than it is written."""


@dataclass
class Result:
    """What a case showed.

    Attributes:
        count: Cases in it; some bodies try many values in one process.
        forbidden: One line per forbidden outcome.
        outcomes: {harmless outcome: how often}.
    """

    count: int = 1
    forbidden: list[str] = field(default_factory=list[str])
    outcomes: dict[str, int] = field(default_factory=dict[str, int])

    def saw(self, outcome: str) -> None:
        """Count a harmless outcome."""
        self.outcomes[outcome] = self.outcomes.get(outcome, 0) + 1


@dataclass(frozen=True)
class Place:
    """Where a case works.

    Attributes:
        folder: Its own empty folder.
        source: A finished smoke run. Nothing may write into its files.
        rng: Its own random numbers.
    """

    folder: Path
    source: Path
    rng: np.random.Generator

    @property
    def runs(self) -> Path:
        """Folder of runs with a copy of the source, made at first use."""
        runs = self.folder / "runs"
        if not runs.exists():
            shutil.copytree(self.source, runs / "smoke", copy_function=os.link, symlinks=True)
            lock = runs / "smoke" / ".lock"
            lock.unlink(missing_ok=True)  # a linked lock would be shared by all cases
        return runs

    @property
    def no_runs(self) -> Path:
        """A folder of runs that does not exist."""
        return self.folder / "none"

    def options(self) -> tuple[str, ...]:
        """Options that select the copied run."""
        return ("--profile", "smoke", "--run", "smoke", "--runs-dir", str(self.runs))


@dataclass(frozen=True)
class Case:
    """A named case.

    More processor time than `limit_s`, or WAIT times as long on the clock, is a hang.
    """

    name: str
    body: Callable[[Place, Result], None]
    limit_s: float = 12.0


@dataclass(frozen=True)
class Ran:
    """A command that has ended: exit code (negative: a signal), stdout and stderr."""

    code: int
    out: str
    err: str

    def document(self) -> dict[str, Any]:
        """The document of --json."""
        return json.loads(self.out)


def command(place: Place, *words: str, table: StageTable = STAGES) -> Ran:
    """Run a command in this process, both streams in files, as a shell would redirect them."""
    streams = [(place.folder / f".stream{number}").open("w+b") for number in (1, 2)]
    originals = [os.dup(1), os.dup(2)]
    try:
        for number, file in enumerate(streams, start=1):
            os.dup2(file.fileno(), number)
        code = run_command_line(words, table, TOOLS)
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for number, descriptor in enumerate(originals, start=1):
            os.dup2(descriptor, number)
            os.close(descriptor)
    out, err = (_content(file) for file in streams)
    return Ran(code, out, err)


def _content(file: Any) -> str:
    """Return what was written into an open file, and close it."""
    file.seek(0)
    text = file.read().decode("utf-8", errors="replace")
    file.close()
    return text


def judge(result: Result, action: str, ran: Ran, allowed: Iterable[int]) -> bool:
    """Note forbidden outcomes of a command; return whether there were none."""
    forbidden_before = len(result.forbidden)
    last_line = _last_line(ran.err)[:160]
    if ran.code == ExitCode.INTERNAL:
        error_line = _error_line(ran.err) or last_line
        result.forbidden.append(f"{action}: exit 70: {error_line[:200]}")
    else:
        if ran.code not in tuple(allowed):
            codes = sorted(allowed)
            result.forbidden.append(
                f"{action}: exit {ran.code} is not one of {codes}: {last_line}",
            )
        if _TRACEBACK.search(ran.out + ran.err):
            result.forbidden.append(f"{action}: a traceback: {last_line}")
    return len(result.forbidden) == forbidden_before


def _last_line(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[-1] if lines else ""


def _error_line(text: str) -> str:
    """Return the first line that names an error, or ""."""
    for line in text.splitlines():
        if "error:" in line or "crashed" in line:
            return line
    return ""


def has_control_characters(text: str) -> bool:
    """Return whether a text has characters that a terminal obeys."""
    return any(ord(character) < 32 and character not in "\n\t" for character in text)


def has_escapes(text: str) -> bool:
    """Return whether a text has control characters, or reorders what follows."""
    return has_control_characters(text) or _RIGHT_TO_LEFT in text


Done = Callable[[int, Case, Result, float], None]
"""Called with index, case, result and time [s] of each case that has ended."""


def run_cases(
    cases: Sequence[tuple[int, Case]],
    source: Path,
    seed: int,
    kind: str,
    workers: int,
    done: Done,
) -> None:
    """Run each (index, case) in a child process.

    Args:
        cases: What is run; the index selects the random numbers.
        source: A finished smoke run.
        seed: Of the campaign.
        kind: Names the stream of random numbers.
        workers: Cases at once.
        done: Called as they end.
    """
    waiting = list(reversed(cases))
    running: dict[int, _Child] = {}
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                index, case = waiting.pop()
                folder = Path(tempfile.mkdtemp(prefix="campaign-"))
                place = Place(folder, source, stream(seed, f"campaign.{kind}", index))
                child = _Child(index, case, place)
                running[child.pipe] = child
            for child, hangs in _ended(running):
                del running[child.pipe]
                result = child.result(hang=hangs)
                done(child.index, child.case, result, child.seconds())
    finally:
        for child in running.values():
            child.result(hang=True)


def _ended(running: dict[int, _Child]) -> list[tuple[_Child, bool]]:
    """Wait for a child; return those that have ended, and those that hang."""
    first_deadline = min(child.deadline for child in running.values())
    wait_s = max(0.0, first_deadline - time.monotonic())
    readable, _, _ = select.select(list(running), [], [], wait_s)
    closed = [running[pipe] for pipe in readable if running[pipe].read()]
    ended = [(child, False) for child in closed]
    for child in running.values():
        if child not in closed and child.deadline <= time.monotonic():
            ended.append((child, True))
    return ended


class _Child:
    """A forked process that runs one case and writes its result into a pipe."""

    def __init__(self, index: int, case: Case, place: Place) -> None:
        self.index = index
        self.case = case
        self.folder = place.folder
        self._began = time.monotonic()
        self._text = b""
        self.deadline = self._began + WAIT * case.limit_s
        self.pipe, childs_pipe = os.pipe()
        self.pid = os.fork()
        if self.pid == 0:
            os.close(self.pipe)
            _live(case, place, childs_pipe)
        os.close(childs_pipe)

    def read(self) -> bool:
        """Read what is there; return whether the child has closed the pipe."""
        part = os.read(self.pipe, 1 << 16)
        self._text += part
        return not part

    def seconds(self) -> float:
        """Return the time since the start [s]."""
        return time.monotonic() - self._began

    def result(self, *, hang: bool) -> Result:
        """End the child with all that it started and return what it showed."""
        if hang:
            os.killpg(self.pid, signal.SIGKILL)
        os.close(self.pipe)
        _, status = os.waitpid(self.pid, 0)
        code = os.waitstatus_to_exitcode(status)
        hung_at = _hung_at(self.folder / ".hang") if hang else ""
        shutil.rmtree(self.folder, ignore_errors=True)
        limit_s = self.case.limit_s
        if hang:
            return Result(forbidden=[f"a hang: longer than {WAIT * limit_s:g} s{hung_at}"])
        if code == -signal.SIGXCPU:
            return Result(forbidden=[f"a hang: more than {limit_s:g} s of CPU time"])
        if code != 0 or not self._text:
            end = signal.Signals(-code).name if code < 0 else f"exit {code}"
            return Result(forbidden=[f"the process died: {end}"])
        return Result(**json.loads(self._text))


def _hung_at(path: Path) -> str:
    """Return where a process hung, of what faulthandler wrote."""
    if not path.is_file():
        return ""
    lines = [line.strip() for line in path.read_text().splitlines() if "File " in line]
    if not lines:
        return ""
    innermost, *callers = lines
    own = "; ".join(line for line in callers if "minidual" in line)
    return f", {innermost}, from {own[:300]}"


def _live(case: Case, place: Place, pipe: int) -> None:
    """Run the case in the forked child and leave it."""
    os.setpgid(0, 0)
    # A campaign that is killed leaves nothing behind.
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    _limit_resources(case.limit_s)
    os.chdir(place.folder)
    silence = os.open(place.folder / ".noise", os.O_RDWR | os.O_CREAT)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    hang_file = (place.folder / ".hang").open("w")
    faulthandler.dump_traceback_later(0.9 * WAIT * case.limit_s, file=hang_file)
    result = Result()
    try:
        case.body(place, result)
    except BaseException as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        line = f"{Path(frame.filename).name}:{frame.lineno}"
        message = str(error)[:200]
        result.forbidden.append(f"uncaught: {type(error).__name__} at {line}: {message}")
    os.write(pipe, json.dumps(asdict(result)).encode())
    os._exit(0)


def _limit_resources(cpu_s: float) -> None:
    """Limit processor time and memory of this process; write no core dumps."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    usage = resource.getrusage(resource.RUSAGE_SELF)
    cpu_limit_s = int(usage.ru_utime + usage.ru_stime + cpu_s) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_limit_s, resource.RLIM_INFINITY))
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    used_bytes = pages * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used_bytes + _MEMORY_BYTES, resource.RLIM_INFINITY))
