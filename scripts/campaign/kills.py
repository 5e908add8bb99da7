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
STEPS = 110
"""Steps of publishing at which a process is killed; past the last one it ends by itself."""


def warm(place: Place) -> None:
    """Load the toys."""
    from tests.support import recording_toys  # noqa: F401


def publish_cases(source: Path) -> Iterator[Case]:
    """A toy stage killed before its n-th access to a file, and at random instants."""
    for again in (False, True):
        for step in range(1, STEPS):
            yield Case(
                f"{'replace' if again else 'first'} step {step}",
                partial(_publish, again, step),
            )
        for number in range(25):
            yield Case(
                f"{'replace' if again else 'first'} random {number}",
                partial(_publish, again, None),
            )
    for step in range(1, 400, 4):
        yield Case(f"recording step {step}", partial(_recording, step))


def _dies(body: Callable[[], object], step: int | None, seconds: float) -> bool:
    """Run `body` in a child that is killed before its n-th access or after a time; return whether it ended before."""
    child = os.fork()
    if child == 0:
        if step is not None:
            left = [step]

            def watch(event: str, _: tuple[Any, ...]) -> None:
                if event in _EVENTS:
                    left[0] -= 1
                    if left[0] == 0:
                        os.kill(os.getpid(), signal.SIGKILL)

            sys.addaudithook(watch)
        code = 1  # an error of the body is no ending
        try:
            body()
            code = 0
        finally:
            os._exit(code)
    if step is None:
        time.sleep(seconds)
        os.kill(child, signal.SIGKILL)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code not in (0, -signal.SIGKILL):
        raise ChildProcessError(f"the program failed before it was killed: exit {code}")
    return code == 0


def _publish(again: bool, step: int | None, place: Place, result: Result) -> None:
    from tests.support.pipeline_toys import Bench

    round_of = [0]

    def write(context: Any) -> None:
        for number in range(_FILES):
            (context.folder / "out" / f"{number}.txt").write_text(f"{round_of[0]}\n" * 500)

    bench = Bench(place.folder / "runs")
    bench.first.behaviour = write
    if again:
        bench.runner().run("first")
        round_of[0] = 1
    finished = _dies(
        lambda: bench.runner().run("first", force=True),
        step,
        float(place.rng.uniform(0.0, 0.03)),
    )
    result.saw("ended before" if finished else "killed")
    state = Bench(place.folder / "runs").gate().state("first")
    if state.state == "pass" and not _whole(bench.store):
        result.forbidden.append("a half-written result passes")
    if again and state.state != "pass":
        result.forbidden.append(f"a lost finished result: {state.state} {state.reasons}")
    result.saw(f"then {state.state}")
    round_of[0] = 2
    bench.runner().run("first", force=True)
    if bench.states()[0] != "pass" or not _whole(bench.store):
        result.forbidden.append("the command typed again does not mend it")
    left = [path.name for path in bench.store.folder.glob(".first.*")]
    if left:
        result.forbidden.append(f"left behind: {', '.join(left)}")


def _whole(store: RunStore) -> bool:
    """Return whether all files are of one round."""
    texts = {(store.stage_folder("first") / "out" / f"{n}.txt").read_text() for n in range(_FILES)}
    return len(texts) == 1 and texts.pop().count("\n") == 500


def _recording(step: int, place: Place, result: Result) -> None:
    from minidual.demos import recording
    from tests.support import recording_toys

    recording.Rig = recording_toys.ToyRig  # type: ignore[misc]
    task = recording_toys.job(place.folder / "rec", episodes_n=3)
    task.folder.mkdir()
    recording.claim(task.folder, {"seed": 1}, "old")
    finished = _dies(lambda: recording.record(task, workers=1), step, 0.0)
    result.saw("ended before" if finished else "killed")
    kept = {p: (p.stat().st_ino, p.stat().st_mtime_ns) for p in task.folder.rglob("[!.]*.hdf5")}
    recording.claim(task.folder, {"seed": 1}, "old")
    recorded = recording.record(task, workers=1)
    now = {p: (p.stat().st_ino, p.stat().st_mtime_ns) for p in task.folder.rglob("[!.]*.hdf5")}
    if not kept.items() <= now.items():
        result.forbidden.append("a lost finished episode")
    if [attempt.trial.index for attempt in recorded.kept] != [0, 2, 3]:
        result.forbidden.append(
            f"other episodes than without the kill: {[a.trial.index for a in recorded.kept]}",
        )
    if left := [path.name for path in task.folder.rglob("*.partial")]:
        result.forbidden.append(f"left behind: {', '.join(left)}")


STAGES_S = {
    "report": (3.0, ()),
    "env-check": (11.0, ()),
    "plan": (14.0, ("--queries", "2")),
    "teleop-record": (20.0, ("--episodes", "2")),
    "train-act": (
        20.0,
        ("--set", "train.threads=1"),
    ),  # two at once on two cores: more threads wait for each other
    "deploy": (20.0, ("--trials", "2")),
}
"""Stages that are killed: how long they take at most [s] and their options."""


def stage_cases(source: Path) -> Iterator[Case]:
    """A real stage replaces its result and is killed at a random instant."""
    for name, times in (
        ("report", 30),
        ("env-check", 14),
        ("plan", 10),
        ("teleop-record", 8),
        ("train-act", 5),
    ):
        for number in range(times):
            yield Case(f"{name} {number}", partial(_stage, name), limit_s=90.0)
    for number in range(5):
        yield Case(f"deploy {number}", partial(_stage, "deploy"), limit_s=90.0)


def _stage(name: str, place: Place, result: Result) -> None:
    longest, options = STAGES_S[name]
    words = [name, "--force", "--yes", *options, *place.options()]
    process = start(place, words)
    time.sleep(float(place.rng.uniform(0.3, longest)))
    result.saw("killed" if process.poll() is None else "ended before")
    process.kill()
    ended(process)
    if left := orphans(process.pid, patience_s=3.0):
        result.forbidden.append(f"orphans 3 s after the kill: {left}")
    ran = command(place, "status", "--json", *place.options())
    if not judge(result, "status", ran, [ExitCode.PASS]):
        return
    rows = {row["name"]: row for row in ran.document()["stages"]}
    # The options differ from those of the smoke run, so a finished replacement makes the stages above it stale.
    if rows[name]["state"] not in ("pass", "fail"):
        result.forbidden.append(
            f"a lost finished result: {name} is {rows[name]['state']} {rows[name]['reasons']}",
        )
    result.saw(f"then {rows[name]['state']}")
    if name == "report" and place.rng.random() < 0.5:
        again = command(place, name, "--force", *place.options())
        judge(
            result,
            "typed again",
            again,
            [ExitCode.PASS, ExitCode.ACCEPTANCE_FAILED],
        )  # 1: results of other code
        if (place.runs / "smoke" / f".{name}.tmp").exists():
            result.forbidden.append("the command typed again leaves a temporary folder")
