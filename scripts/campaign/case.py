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


@dataclass
class Result:
    """What a case showed.

    Attributes:
        count: Cases in it; some bodies try many values in one process.
        forbidden: One line per forbidden outcome.
        outcomes: {harmless outcome: how often}.
    """

    count: int = 1
    forbidden: list[str] = field(default_factory=list)
    outcomes: dict[str, int] = field(default_factory=dict)

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
            (runs / "smoke" / ".lock").unlink(
                missing_ok=True,
            )  # a linked lock would be shared by all cases
        return runs

    def options(self) -> tuple[str, ...]:
        """Options that select the copied run."""
        return ("--profile", "smoke", "--run", "smoke", "--runs-dir", str(self.runs))


@dataclass(frozen=True)
class Case:
    """A named case; more CPU time than `limit_s`, or WAIT times as long on the clock, is a hang."""

    name: str
    body: Callable[[Place, Result], None]
    limit_s: float = 12.0


@dataclass(frozen=True)
class Ran:
    """A command that has ended: exit code (negative: a signal), stdout and stderr."""

    code: int
    out: str
    err: str

    def document(self) -> dict:
        """The document of --json."""
        return json.loads(self.out)


def command(place: Place, *words: str, table: StageTable = STAGES) -> Ran:
    """Run a command in this process, both streams in files, as a shell would redirect them."""
    streams = [(place.folder / f".stream{number}").open("w+b") for number in (1, 2)]
    kept = [os.dup(1), os.dup(2)]
    try:
        for number, stream in enumerate(streams, start=1):
            os.dup2(stream.fileno(), number)
        code = run_command_line(words, table, TOOLS)
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for number, descriptor in enumerate(kept, start=1):
            os.dup2(descriptor, number)
            os.close(descriptor)
    texts = []
    for stream in streams:
        stream.seek(0)
        texts.append(stream.read().decode("utf-8", errors="replace"))
        stream.close()
    return Ran(code, *texts)


def judge(result: Result, what: str, ran: Ran, allowed: Iterable[int]) -> bool:
    """Note forbidden outcomes of a command; return whether there were none."""
    before = len(result.forbidden)
    last = (ran.err.strip().splitlines() or [""])[-1][:160]
    if ran.code == ExitCode.INTERNAL:
        where = next(
            (line for line in ran.err.splitlines() if "error:" in line or "crashed" in line),
            last,
        )
        result.forbidden.append(f"{what}: exit 70: {where[:200]}")
    elif ran.code not in (*allowed,):
        result.forbidden.append(f"{what}: exit {ran.code} is not one of {sorted(allowed)}: {last}")
    if ran.code != ExitCode.INTERNAL and _TRACEBACK.search(ran.out + ran.err):
        result.forbidden.append(f"{what}: a traceback: {last}")
    return len(result.forbidden) == before


def run_cases(
    cases: Sequence[tuple[int, Case]],
    source: Path,
    seed: int,
    kind: str,
    workers: int,
    done: Callable,
) -> None:
    """Run each (index, case) in a child process; `done(index, case, result, seconds)` is called as they end."""
    waiting = list(reversed(cases))
    running = dict[int, _Child]()
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                index, case = waiting.pop()
                child = _Child(
                    index,
                    case,
                    Place(_folder(), source, stream(seed, f"campaign.{kind}", index)),
                )
                running[child.pipe] = child
            first = min(child.deadline for child in running.values())
            ready, _, _ = select.select(list(running), [], [], max(0.0, first - time.monotonic()))
            for pipe in ready:
                if running[pipe].read():
                    child = running.pop(pipe)
                    done(child.index, child.case, child.result(hang=False), child.seconds())
            for pipe in [
                pipe for pipe, child in running.items() if child.deadline <= time.monotonic()
            ]:
                child = running.pop(pipe)
                done(child.index, child.case, child.result(hang=True), child.seconds())
    finally:
        for child in running.values():
            child.result(hang=True)


def _folder() -> Path:
    return Path(tempfile.mkdtemp(prefix="campaign-"))


class _Child:
    """A forked process that runs one case and writes its result into a pipe."""

    def __init__(self, index: int, case: Case, place: Place) -> None:
        self.index = index
        self.case = case
        self.folder = place.folder
        self._began = time.monotonic()
        self._text = b""
        self.deadline = self._began + WAIT * case.limit_s
        self.pipe, theirs = os.pipe()
        self.pid = os.fork()
        if self.pid == 0:
            os.close(self.pipe)
            _live(case, place, theirs)
        os.close(theirs)

    def read(self) -> bool:
        """Read what is there; return whether the child has closed the pipe."""
        part = os.read(self.pipe, 1 << 16)
        self._text += part
        return not part

    def seconds(self) -> float:
        return time.monotonic() - self._began

    def result(self, *, hang: bool) -> Result:
        """End the child with all that it started and return what it showed."""
        if hang:
            os.killpg(self.pid, signal.SIGKILL)
        os.close(self.pipe)
        code = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        where = _innermost(self.folder / ".hang") if hang else ""
        shutil.rmtree(self.folder, ignore_errors=True)
        if hang:
            return Result(forbidden=[f"a hang: longer than {WAIT * self.case.limit_s:g} s{where}"])
        if code == -signal.SIGXCPU:
            return Result(forbidden=[f"a hang: more than {self.case.limit_s:g} s of CPU time"])
        if code != 0 or not self._text:
            how = signal.Signals(-code).name if code < 0 else f"exit {code}"
            return Result(forbidden=[f"the process died: {how}"])
        return Result(**json.loads(self._text))


def _innermost(path: Path) -> str:
    """Return where a process hung, of what faulthandler wrote."""
    lines = (
        [line.strip() for line in path.read_text().splitlines() if "File " in line]
        if path.is_file()
        else []
    )
    return (
        f", {lines[0]}, from {'; '.join(line for line in lines[1:] if 'minidual' in line)[:300]}"
        if lines
        else ""
    )


def _live(case: Case, place: Place, pipe: int) -> None:
    """Run the case in the forked child and leave it."""
    os.setpgid(0, 0)
    ctypes.CDLL(None).prctl(
        _PR_SET_PDEATHSIG,
        signal.SIGKILL,
    )  # a campaign that is killed leaves nothing behind
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    spent = resource.getrusage(resource.RUSAGE_SELF)
    limit = int(spent.ru_utime + spent.ru_stime + case.limit_s) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (limit, resource.RLIM_INFINITY))
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + _MEMORY_BYTES, resource.RLIM_INFINITY))
    os.chdir(place.folder)
    silence = os.open(place.folder / ".noise", os.O_RDWR | os.O_CREAT)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    result = Result()
    faulthandler.dump_traceback_later(
        0.9 * WAIT * case.limit_s,
        file=(place.folder / ".hang").open("w"),
    )
    try:
        case.body(place, result)
    except BaseException as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        text = f"{type(error).__name__} at {Path(frame.filename).name}:{frame.lineno}: {str(error)[:200]}"
        result.forbidden.append(f"uncaught: {text}")
    os.write(pipe, json.dumps(asdict(result)).encode())
    os._exit(0)
