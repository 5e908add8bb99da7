"""Processes killed at every step of writing: nothing half-written passes, nothing finished is lost."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from minidual.errors import ExitCode
from minidual.gate.store import RunStore
from scripts.campaign.case import Case, Place, Result, command, judge
from scripts.campaign.processes import ended, orphans, start

_EVENTS = {
    "open",
    "os.rename",
    "os.remove",
    "os.mkdir",
    "os.rmdir",
    "os.link",
    "os.truncate",
    "shutil.rmtree",
}
_FILES = 6
_LINES = 500
STEPS = 110
"""Steps of publishing at which a process is killed; past the last one it ends by itself."""


def warm(place: Place) -> None:
    """Load the toys."""
    from tests.support import recording_toys  # noqa: F401


def publish_cases(source: Path) -> Iterator[Case]:
    """A toy stage killed before its n-th access to a file, and at random instants."""
    for again in (False, True):
        label = "replace" if again else "first"
        for step in range(1, STEPS):
            yield Case(f"{label} step {step}", partial(_publish, again, step))
        for number in range(25):
            yield Case(f"{label} random {number}", partial(_publish, again, None))
    for step in range(1, 400, 4):
        yield Case(f"recording step {step}", partial(_recording, step))


def _survives(body: Callable[[], object], step: int | None, seconds: float) -> bool:
    """Run `body` in a child that is killed before its n-th access to a file, or after a time.

    Args:
        body: What the child does.
        step: Access before which it is killed; None: `seconds` count.
        seconds: Time after which it is killed.

    Returns:
        Whether it ended before.

    Raises:
        ChildProcessError: The body failed before it was killed.
    """
    child = os.fork()
    if child == 0:
        _run_and_leave(body, step)
    if step is None:
        time.sleep(seconds)
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if code not in (0, -signal.SIGKILL):
        raise ChildProcessError(f"the program failed before it was killed: exit {code}")
    return code == 0


def _run_and_leave(body: Callable[[], object], step: int | None) -> None:
    """Run `body` in a forked child, which kills itself before its n-th access to a file."""
    if step is not None:
        left = step

        def watch(event: str, _: tuple[Any, ...]) -> None:
            nonlocal left
            if event in _EVENTS:
                left -= 1
                if left == 0:
                    os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(watch)
    code = 1  # an error of the body is no ending
    try:
        body()
        code = 0
    finally:
        os._exit(code)


def _publish(again: bool, step: int | None, place: Place, result: Result) -> None:
    """Kill a stage that publishes its first result, or replaces one."""
    from tests.support.pipeline_toys import Bench

    current_round = 0

    def write(context: Any) -> None:
        for number in range(_FILES):
            path = context.folder / "out" / f"{number}.txt"
            path.write_text(f"{current_round}\n" * _LINES)

    bench = Bench(place.folder / "runs")
    bench.first.behaviour = write
    if again:
        bench.runner().run("first")
        current_round = 1
    survived = _survives(
        lambda: bench.runner().run("first", force=True),
        step,
        float(place.rng.uniform(0.0, 0.03)),
    )
    result.saw("ended before" if survived else "killed")
    state = Bench(place.folder / "runs").gate().state("first")
    if state.state == "pass" and not _is_of_one_round(bench.store):
        result.forbidden.append("a half-written result passes")
    if again and state.state != "pass":
        result.forbidden.append(f"a lost finished result: {state.state} {state.reasons}")
    result.saw(f"then {state.state}")
    current_round = 2
    bench.runner().run("first", force=True)
    if bench.states()[0] != "pass" or not _is_of_one_round(bench.store):
        result.forbidden.append("the command typed again does not mend it")
    left_behind = [path.name for path in bench.store.folder.glob(".first.*")]
    if left_behind:
        result.forbidden.append(f"left behind: {', '.join(left_behind)}")


def _is_of_one_round(store: RunStore) -> bool:
    """Return whether all files are complete and of one round."""
    folder = store.stage_folder("first") / "out"
    texts = {(folder / f"{number}.txt").read_text() for number in range(_FILES)}
    return len(texts) == 1 and texts.pop().count("\n") == _LINES


def _recording(step: int, place: Place, result: Result) -> None:
    """Kill a recording; the same command goes on from the finished episodes."""
    from minidual.demos import recording
    from tests.support import recording_toys

    recording.Rig = recording_toys.ToyRig  # type: ignore[misc]
    job = recording_toys.job(place.folder / "rec", episodes_n=3)
    job.folder.mkdir()
    recording.claim(job.folder, {"seed": 1}, "old")
    survived = _survives(lambda: recording.record(job, workers=1), step, 0.0)
    result.saw("ended before" if survived else "killed")
    episodes_before = _identities(job.folder)
    recording.claim(job.folder, {"seed": 1}, "old")
    recorded = recording.record(job, workers=1)
    if not episodes_before.items() <= _identities(job.folder).items():
        result.forbidden.append("a lost finished episode")
    indices = [attempt.trial.index for attempt in recorded.kept]
    if indices != [0, 2, 3]:
        result.forbidden.append(f"other episodes than without the kill: {indices}")
    left_behind = [path.name for path in job.folder.rglob("*.partial")]
    if left_behind:
        result.forbidden.append(f"left behind: {', '.join(left_behind)}")


def _identities(folder: Path) -> dict[Path, tuple[int, int]]:
    """Return {episode: (inode, time of the last change)}."""
    identities: dict[Path, tuple[int, int]] = {}
    for path in folder.rglob("[!.]*.hdf5"):
        stat = path.stat()
        identities[path] = (stat.st_ino, stat.st_mtime_ns)
    return identities


STAGES_S: dict[str, tuple[float, tuple[str, ...]]] = {
    "report": (3.0, ()),
    "env-check": (11.0, ()),
    "plan": (14.0, ("--queries", "2")),
    "teleop-record": (20.0, ("--episodes", "2")),
    "train-act": (20.0, ()),
    "deploy": (20.0, ("--trials", "2")),
}
"""Stages that are killed: how long they take at most [s] and their options.

No setting (--set) is among the options. The run remembers a setting before the stage begins, so the
older result is stale from then on, whatever becomes of the new one.
"""
_KILLS_N = {
    "report": 30,
    "env-check": 14,
    "plan": 10,
    "teleop-record": 8,
    "train-act": 5,
    "deploy": 5,
}


def stage_cases(source: Path) -> Iterator[Case]:
    """A real stage replaces its result and is killed at a random instant."""
    for name, kills_n in _KILLS_N.items():
        for number in range(kills_n):
            yield Case(f"{name} {number}", partial(_stage, name), limit_s=90.0)


def _stage(name: str, place: Place, result: Result) -> None:
    longest_s, options = STAGES_S[name]
    process = start(place, [name, "--force", "--yes", *options, *place.options()])
    time.sleep(float(place.rng.uniform(0.3, longest_s)))
    result.saw("killed" if process.poll() is None else "ended before")
    process.kill()
    ended(process)
    left = orphans(process.pid, patience_s=3.0)
    if left:
        result.forbidden.append(f"orphans 3 s after the kill: {left}")
    ran = command(place, "status", "--json", *place.options())
    if not judge(result, "status", ran, [ExitCode.PASS]):
        return
    row = next(row for row in ran.document()["stages"] if row["name"] == name)
    # The options differ from those of the smoke run: a finished replacement makes the stages above
    # it stale.
    if row["state"] not in ("pass", "fail"):
        result.forbidden.append(
            f"a lost finished result: {name} is {row['state']} {row['reasons']}",
        )
    result.saw(f"then {row['state']}")
    if name == "report" and place.rng.random() < 0.5:
        _type_again(name, place, result)


def _type_again(name: str, place: Place, result: Result) -> None:
    ran = command(place, name, "--force", *place.options())
    allowed = [ExitCode.PASS, ExitCode.ACCEPTANCE_FAILED]  # results of other code fail
    judge(result, "typed again", ran, allowed)
    if (place.runs / "smoke" / f".{name}.tmp").exists():
        result.forbidden.append("the command typed again leaves a temporary folder")
