"""`minidual teleop-record`: a leader demonstrates, the follower is recorded, and a dataset is made of what succeeded."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from minidual.errors import NothingEvaluatedError
from minidual.gate.check import Check
from minidual.gate.stage import StageContext, StageResult

if TYPE_CHECKING:
    from minidual.config.teleop import TeleopConfig
    from minidual.demos.recording import Recording
    from minidual.demos.rig import Attempt

SYNC_LIMIT_S = 0.02


@dataclass(frozen=True)
class RecordingNumbers:
    """What the checks of the stage rest on; extremes are over the demonstrations that were kept."""

    episodes: int
    attempts: int
    successes: int
    files_at_fault: int
    jerk_rms_max: float
    sync_error_max_s: float
    latency_p50_s: float
    latency_p99_s: float
    episodes_per_min: float
    recorded_ticks: int
    dataset_rows: int
    dataset_episodes: int


def record_checks(numbers: RecordingNumbers, config: TeleopConfig) -> list[Check]:
    """Return the checks of the stage."""
    n = numbers
    return [
        Check(
            "episodes",
            n.episodes,
            ">=",
            config.episodes_n,
            "",
            "demonstrations kept, each of which achieved the task",
            "read quality.csv: `reason` names what failed; raise teleop.attempts_max_ratio",
        ),
        Check(
            "schema_ok",
            n.files_at_fault == 0 and n.episodes > 0,
            "==",
            True,
            "",
            "every file, opened again, holds all fields in the right shapes, finite, in order and inside the limits",
            "read `faults` in the verdict's data; record again with --force",
        ),
        Check(
            "jerk_rms_max",
            n.jerk_rms_max,
            "<",
            config.jerk_max_rad_s3,
            "rad/s^3",
            "roughest demonstration kept; a policy copies the shaking of its teacher",
            "lengthen the phases under teleop.operator, or look for contacts during the motion",
        ),
        Check(
            "latency_p99_s",
            n.latency_p99_s,
            "<",
            config.latency_max_s,
            "s",
            "wall-clock time from reading the leader to the follower's torque, 99th percentile of all ticks",
            "free the machine of other load, or use fewer workers",
        ),
        Check(
            "episodes_per_min",
            n.episodes_per_min,
            ">",
            config.episodes_per_min,
            "1/min",
            "demonstrations kept a minute, once the processes have started",
            "use more workers, or smaller or fewer cameras",
        ),
        Check(
            "sync_error_max_s",
            n.sync_error_max_s,
            "<=",
            SYNC_LIMIT_S,
            "s",
            "joints, pictures and action of a tick belong to one instant",
            "stamp all of them in the same tick",
        ),
        Check(
            "dataset_rows",
            n.dataset_rows,
            "==",
            n.recorded_ticks,
            "",
            "every recorded tick is a row of the dataset and a frame of its videos",
            "record again with --force; check the free space on the disk",
        ),
        Check(
            "dataset_episodes",
            n.dataset_episodes,
            "==",
            n.episodes,
            "",
            "every demonstration kept is an episode of the dataset",
            "record again with --force",
        ),
        Check(
            "success_rate",
            n.successes / n.attempts if n.attempts else float("nan"),
            unit="",
            why="share of attempts that achieved the task; the others are counted and left out",
        ),
        Check("attempts", n.attempts, unit="", why="trials that were led"),
        Check("latency_p50_s", n.latency_p50_s, unit="s", why="median of the same"),
    ]


def run(context: StageContext) -> StageResult:
    """Record, convert, film, and write quality.csv and quality.png."""
    from minidual.demos.lerobot_adapter import convert
    from minidual.demos.recording import record
    from minidual.demos.rig import Job, film
    from minidual.show.figures.teleop import draw_quality
    from minidual.show.watch import watch_recording
    from minidual.tasks.task import make_task

    config = context.config
    job = Job(context.folder, make_task(config), config.teleop, config.arbiter, context.seed, config.supervisor)
    if config.teleop.leader == "keyboard":
        from minidual.demos.keyboard import HELP

        context.progress.note(f"keys: {HELP}")
    with context.progress.task("demonstrations", config.teleop.episodes_n) as task:

        def tell(attempt: Attempt) -> None:
            task.advance(int(attempt.kept), "" if attempt.kept else f"trial {attempt.trial.index}: {attempt.reason}")

        recording = record(job, workers=context.workers, on_attempt=tell, observe=watch_recording(context.view))
    write_quality(recording.attempts, context.folder / "quality.csv")
    if not recording.kept:
        raise NothingEvaluatedError(
            f"none of {len(recording.attempts)} attempts became a demonstration; {_commonest(recording.attempts)}",
            remedy="read `reason` above; try --set teleop.leader=scripted, or the defaults of teleop.operator",
        )
    with context.progress.task("dataset", len(recording.kept)) as task:
        dataset = convert(recording.paths, context.folder / "lerobot", progress=lambda done, total: task.advance(1))
    scripted = config.teleop.leader == "scripted"
    if scripted:  # a person does not do the same thing twice
        with context.progress.task("film", 1) as task:
            film(job, recording.kept[0].trial.index, context.folder / "demonstration.mp4")
            task.advance()
    draw_quality(recording.attempts, config.scene.task, config.teleop.jerk_max_rad_s3, context.folder / "quality.png")
    numbers = count_recording(recording, dataset.frames, dataset.episodes)
    return StageResult(checks=record_checks(numbers, config.teleop), data=_data(recording), notes=_notes(recording))


def count_recording(recording: Recording, dataset_rows: int, dataset_episodes: int) -> RecordingNumbers:
    """Return the numbers that the checks rest on."""
    import numpy as np

    kept = recording.kept
    latencies = np.concatenate([a.latencies_s for a in recording.attempts if a.latencies_s is not None])
    qualities = [a.quality for a in kept if a.quality is not None]
    return RecordingNumbers(
        episodes=len(kept),
        attempts=len(recording.attempts),
        successes=sum(a.success for a in recording.attempts),
        files_at_fault=sum(bool(a.problems) for a in kept),
        # np.max hands NaN on, so that an unknown value fails its check instead of vanishing.
        jerk_rms_max=float(np.max([q.rms_jerk_rad_s3 for q in qualities])),
        sync_error_max_s=float(np.max([a.sync_error_max_s for a in kept])),
        latency_p50_s=float(np.percentile(latencies, 50)),
        latency_p99_s=float(np.percentile(latencies, 99)),
        episodes_per_min=recording.episodes_per_min,
        recorded_ticks=sum(q.ticks for q in qualities),
        dataset_rows=dataset_rows,
        dataset_episodes=dataset_episodes,
    )


def write_quality(attempts: Sequence[Attempt], path: Path) -> None:
    """Write one row an attempt, the rejected ones included."""
    from minidual.demos.recording import quality_row

    rows = [quality_row(a) for a in attempts]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def _commonest(attempts: Sequence[Attempt]) -> str:
    """Return the commonest reason with its count."""
    (reason, count) = Counter(a.reason for a in attempts).most_common(1)[0]
    return f"{count} x {reason}"


def _data(recording: Recording) -> dict[str, Any]:
    """Return the numbers for the report."""
    import numpy as np

    from minidual.demos.smoothness import JERK_FILTER

    kept = recording.kept
    qualities = [a.quality for a in kept if a.quality is not None]
    return {
        "attempts": len(recording.attempts),
        "kept": len(kept),
        "rejected": {str(a.trial.index): a.reason for a in recording.attempts if not a.kept},
        "faults": {str(a.trial.index): list(a.problems) for a in recording.attempts if a.problems},
        "trials": [a.trial.index for a in kept],
        "jerk_filter": JERK_FILTER,
        "jerk_rms_median": float(np.median([q.rms_jerk_rad_s3 for q in qualities])),
        "path_efficiency_median": float(np.median([q.path_efficiency for q in qualities])),
        "duration_median_s": float(np.median([q.duration_s for q in qualities])),
        "goal_error_max_m": float(np.max([a.goal_error_m for a in kept])),
        "tilt_max_rad": float(np.max([a.tilt_max_rad for a in kept])),
        "recording_s": recording.wall_s,
    }


def _notes(recording: Recording) -> list[str]:
    rejected = [a for a in recording.attempts if not a.kept]
    if not rejected:
        return [f"all {len(recording.attempts)} attempts were kept"]
    return [f"{len(rejected)} of {len(recording.attempts)} attempts were left out; {_commonest(rejected)}"]
