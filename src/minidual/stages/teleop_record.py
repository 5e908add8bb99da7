"""`minidual teleop-record`: record demonstrations and convert them to a dataset."""

import itertools
import time
from collections import Counter
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from operator import attrgetter
from pathlib import Path
from typing import Any

from minidual.config.learning import TeleopConfig
from minidual.config.root import Config
from minidual.demos import recording, rig
from minidual.demos.leader import LEADERS
from minidual.demos.quality import JERK_FILTER
from minidual.demos.schema import MAX_SYNC_S
from minidual.durable import write_csv
from minidual.errors import NothingEvaluatedError
from minidual.gate.canonical import canonical
from minidual.gate.check import Check, Rows
from minidual.gate.code import code_of
from minidual.gate.stage import StageContext, StageResult
from minidual.show.figures.film import film_demonstration
from minidual.show.figures.teleop import draw_quality
from minidual.show.watch import watch_recording
from minidual.stages.words import worded
from minidual.tasks.catalogue import make_task
from minidual.trials.conditions import rooms

READS = ("robot", "task", "teleop", "plan.planner", "scene", "arbiter", "supervisor")
"""Configuration paths that the recording depends on."""

_TESTS_SHOWN = 100


def record_checks(numbers: Mapping[str, float], config: TeleopConfig) -> list[Check]:
    """Return the stage's checks from `RecordedAttempts.numbers` and the sizes of the dataset."""
    rows: Rows = {
        "episodes": (numbers["episodes"], ">=", config.episodes_n),
        "schema_ok": (numbers["schema_ok"], "==", True),
        "jerk_rms_max": (numbers["jerk_rms_max"], "<", config.jerk_max_rad_s3),
        "latency_p99_s": (numbers["latency_p99_s"], "<", config.latency_max_s),
        "episodes_per_min": (numbers["episodes_per_min"], ">", config.episodes_per_min),
        "sync_error_max_s": (numbers["sync_error_max_s"], "<=", MAX_SYNC_S),
        "dataset_rows": (numbers["dataset_rows"], "==", numbers["recorded_ticks"]),
        "dataset_episodes": (numbers["dataset_episodes"], "==", numbers["episodes"]),
        **{
            name: numbers[name]
            for name in ("success_rate", "attempts", "latency_p50_s", "recorded_per_min")
        },
    }
    return worded("teleop-record", rows)


def recording_inputs(config: Config) -> dict[str, Any]:
    """Return what determines the episodes (JSON types)."""
    code = code_of(["minidual.demos.recording:attempts_of", "minidual.trials.conditions:rooms"])
    values = {path: canonical(attrgetter(path)(config), path) for path in READS}
    return {"seed": config.seed, "code": code.modules, **values}


def run(context: StageContext) -> StageResult:
    """Record, convert and film; write quality.csv and quality.png."""
    from minidual.demos import (
        lerobot_adapter,
    )  # takes seconds: interrupted there, no workers are left behind

    config = context.config
    folder = context.folder
    teleop = config.teleop
    leader = LEADERS[config.teleop.leader]
    within = rooms(teleop.conditions)
    job = rig.Job(
        folder,
        make_task(config),
        teleop,
        config.arbiter,
        context.seed,
        config.supervisor,
        within,
    )
    if earlier := recording.claim(folder, recording_inputs(config), "teleop-record"):
        context.progress.note(earlier)
    if leader.usage:
        context.progress.note(leader.usage)
    watch = watch_recording(context.view)
    attempts = list[rig.Attempt]()
    began = 0.0

    def demonstrations() -> Generator[Path]:
        nonlocal began
        with context.progress.task("demonstrations", teleop.episodes_n) as task:
            for attempt in recording.attempts_of(job, context.workers, watch):
                attempts.append(attempt)
                began = began or time.perf_counter() - attempt.wall_s
                why = "" if attempt.kept else f"trial {attempt.trial.index}: {attempt.reason}"
                task.advance(int(attempt.kept), why)
                if attempt.path is not None and attempt.kept:
                    yield attempt.path
        write_csv(folder / "quality.csv", [attempt.row() for attempt in attempts])

    with closing(demonstrations()) as coming:  # an interruption ends the workers here
        paths = (
            iter(list(coming)) if leader.realtime else coming
        )  # a person does not wait between two episodes
        if (first := next(paths, None)) is None:
            recording.claim(folder, {}, "teleop-record")  # typed again, the command tries again
            none = (
                f"none of {len(attempts)} attempts became a demonstration; {_commonest(attempts)}"
            )
            remedy = "read `reason` above; try --set teleop.leader=scripted, or the defaults of teleop.operator"
            raise NothingEvaluatedError(none, remedy=remedy)
        context.progress.note(
            "demonstrations go into the dataset as they come; at the end every picture is compared",
        )
        dataset = lerobot_adapter.convert(
            itertools.chain([first], paths),
            folder / "lerobot",
            job.robot,
        )
    recorded = recording.recording_of(job, context.workers, attempts)
    numbers = recorded.numbers(time.perf_counter() - began)
    numbers |= {"dataset_rows": len(dataset), "dataset_episodes": len(dataset.starts)}
    if not leader.realtime:  # a person does not do the same thing twice
        context.progress.note("filming the first demonstration again")
        film_demonstration(job, recorded.kept[0].trial.index, folder / "demonstration.mp4")
    tests = [job.task.trial(context.seed, "deploy", k) for k in range(_TESTS_SHOWN)]
    draw_quality(recorded.attempts, tests, teleop.jerk_max_rad_s3, folder / "quality.png")
    rejected = [a for a in attempts if not a.kept]
    data = {
        "rejected": {str(a.trial.index): a.reason for a in rejected},
        "faults": {str(a.trial.index): list(a.faults) for a in recorded.attempts if a.faults},
        "jerk_filter": JERK_FILTER,
    }
    most = f"; {_commonest(rejected)}" if rejected else ""
    notes = [f"{len(rejected)} of {len(attempts)} attempts were left out{most}"]
    if adopted := sum(a.adopted for a in attempts):
        notes.append(f"{adopted} attempts were recorded before an interruption")
    return StageResult(checks=record_checks(numbers, teleop), data=data, notes=notes)


def _commonest(attempts: Sequence[rig.Attempt]) -> str:
    return "{1} x {0}".format(*Counter(a.reason for a in attempts).most_common(1)[0])
