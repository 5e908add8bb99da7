"""`minidual teleop-record`: record demonstrations and convert them to a dataset."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from minidual.errors import NothingEvaluatedError
from minidual.gate.check import Check, Number, Op
from minidual.gate.stage import StageContext, StageResult

if TYPE_CHECKING:
    from minidual.config.teleop import TeleopConfig
    from minidual.demos.recording import Recording, RecordingNumbers
    from minidual.demos.rig import Attempt

SYNC_LIMIT_S = 0.02


_WORDS = {
    "episodes": (
        "",
        "demonstrations kept, each of which achieved the task",
        "read quality.csv: `reason` names what failed; raise teleop.attempts_max_ratio",
    ),
    "schema_ok": (
        "",
        "every file, opened again, holds all fields in the right shapes, finite, in order and inside the limits",
        "read `faults` in the verdict's data; record again with --force",
    ),
    "jerk_rms_max": (
        "rad/s^3",
        "roughest demonstration kept; a policy copies the shaking of its teacher",
        "lengthen the phases under teleop.operator, or look for contacts during the motion",
    ),
    "latency_p99_s": (
        "s",
        "wall-clock time from reading the leader to the follower's torque, 99th percentile of all ticks",
        "free the machine of other load, or use fewer workers",
    ),
    "episodes_per_min": (
        "1/min",
        "demonstrations kept a minute, once the processes have started",
        "use more workers, or smaller or fewer cameras",
    ),
    "sync_error_max_s": (
        "s",
        "joints, images and action of a tick belong to one instant",
        "stamp all of them in the same tick",
    ),
    "dataset_rows": (
        "",
        "every recorded tick is a row of the dataset and a frame of its videos",
        "record again with --force; check the free space on the disk",
    ),
    "dataset_episodes": ("", "every demonstration kept is an episode of the dataset", "record again with --force"),
}
"""Unit, reason and remedy of each limited check."""


def record_checks(numbers: RecordingNumbers, config: TeleopConfig) -> list[Check]:
    """Return the stage's checks."""
    n = numbers
    limits: tuple[tuple[str, Number, Op, Number], ...] = (
        ("episodes", n.episodes, ">=", config.episodes_n),
        ("schema_ok", n.files_at_fault == 0 and n.episodes > 0, "==", True),
        ("jerk_rms_max", n.jerk_rms_max, "<", config.jerk_max_rad_s3),
        ("latency_p99_s", n.latency_p99_s, "<", config.latency_max_s),
        ("episodes_per_min", n.episodes_per_min, ">", config.episodes_per_min),
        ("sync_error_max_s", n.sync_error_max_s, "<=", SYNC_LIMIT_S),
        ("dataset_rows", n.dataset_rows, "==", n.recorded_ticks),
        ("dataset_episodes", n.dataset_episodes, "==", n.episodes),
    )
    rate = n.successes / n.attempts if n.attempts else float("nan")
    return [
        *(Check(name, observed, op, limit, *_WORDS[name]) for name, observed, op, limit in limits),
        Check("success_rate", rate, why="share of attempts that achieved the task; the others are left out"),
        Check("attempts", n.attempts, why="trials that were led"),
        Check("latency_p50_s", n.latency_p50_s, unit="s", why="median of the same"),
    ]


def run(context: StageContext) -> StageResult:
    """Record, convert and film; write quality.csv and quality.png."""
    from minidual.demos import lerobot_adapter, recording, rig
    from minidual.demos.leader import LEADERS
    from minidual.show.figures.teleop import draw_quality
    from minidual.show.watch import watch_recording
    from minidual.tasks.task import make_task

    config, folder = context.config, context.folder
    teleop, leader = config.teleop, LEADERS[config.teleop.leader]
    job = rig.Job(folder, make_task(config), teleop, config.arbiter, context.seed, config.supervisor)
    if leader.usage:
        context.progress.note(leader.usage)
    with context.progress.task("demonstrations", teleop.episodes_n) as task:

        def tell(attempt: Attempt) -> None:
            task.advance(int(attempt.kept), "" if attempt.kept else f"trial {attempt.trial.index}: {attempt.reason}")

        watch = watch_recording(context.view)
        recorded = recording.record(job, workers=context.workers, on_attempt=tell, observe=watch)
    write_quality(recorded.attempts, folder / "quality.csv")
    if not recorded.kept:
        raise NothingEvaluatedError(
            f"none of {len(recorded.attempts)} attempts became a demonstration; {_commonest(recorded.attempts)}",
            remedy="read `reason` above; try --set teleop.leader=scripted, or the defaults of teleop.operator",
        )
    with context.progress.task("dataset", len(recorded.kept)) as task:
        dataset = lerobot_adapter.convert(recorded.paths, folder / "lerobot", job.robot, progress=task.advance)
    if not leader.realtime:  # a person does not do the same thing twice
        with context.progress.task("film", 1) as task:
            rig.film(job, recorded.kept[0].trial.index, folder / "demonstration.mp4")
            task.advance()
    draw_quality(recorded.attempts, config.scene.task, teleop.jerk_max_rad_s3, folder / "quality.png")
    numbers = recorded.numbers(dataset.frames, dataset.episodes)
    return StageResult(checks=record_checks(numbers, teleop), data=recorded.facts(), notes=_notes(recorded))


def write_quality(attempts: Sequence[Attempt], path: Path) -> None:
    """Write one row per attempt, rejected ones included."""
    rows = [attempt.row() for attempt in attempts]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def _commonest(attempts: Sequence[Attempt]) -> str:
    """Return the most common reason with its count."""
    (reason, count) = Counter(a.reason for a in attempts).most_common(1)[0]
    return f"{count} x {reason}"


def _notes(recording: Recording) -> list[str]:
    rejected = [a for a in recording.attempts if not a.kept]
    if not rejected:
        return [f"all {len(recording.attempts)} attempts were kept"]
    return [f"{len(rejected)} of {len(recording.attempts)} attempts were left out; {_commonest(rejected)}"]
