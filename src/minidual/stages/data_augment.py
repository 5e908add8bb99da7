"""`minidual data augment`: demonstrations moved to new starts and goals, replayed and judged."""

import json
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from minidual import durable
from minidual.config.root import changed
from minidual.config.seeds import subseed
from minidual.demos import recording, rig
from minidual.demos.augment.segments import read_sources, source_paths
from minidual.durable import expanded, write_csv
from minidual.errors import NothingEvaluatedError, UsageError
from minidual.gate.canonical import file_sha256
from minidual.gate.stage import ToolContext, ToolResult
from minidual.robot.kinematics import Kinematics
from minidual.stages.teleop_record import recording_inputs
from minidual.tasks.catalogue import TASKS, make_task
from minidual.trials.conditions import rooms
from minidual.trials.statistics import wilson_interval

LEADER = "augmented"
CONDITIONS = "randomised"
RECORD = "augment.json"
_ATTEMPTS_EACH = 4
_FINISHED = "lerobot"
_REASONS_SHOWN = 8
_NUMBER = re.compile(r"-?\d+(\.\d+)?(e[-+]?\d+)?")


def data_augment(context: ToolContext) -> ToolResult:
    """Record demonstrations that moved ones lead; an interrupted recording is continued.

    Raises:
        UsageError: There is nothing to move, or the task is no carry.
        NothingEvaluatedError: No moved demonstration passed.
    """
    folder = context.folder
    job, refused, sources_n = _job(context, folder)
    if (folder / _FINISHED).exists():
        aside = durable.set_aside(folder, context.name)
        context.progress.note(f"the earlier demonstrations are in {aside}")
    durable.make_folder(folder)
    note = recording.claim(folder, _inputs(context, job), context.name)
    for text in (note, *refused):
        if text:
            context.progress.note(text)
    attempts = _recorded(context, job)
    kept = [attempt for attempt in attempts if attempt.kept]
    write_csv(folder / "quality.csv", [attempt.row() for attempt in attempts])
    record = augment_record(attempts, sources_n, refused)
    durable.write_text(folder / RECORD, json.dumps(record, indent=1, sort_keys=True) + "\n")
    if not kept:
        raise NothingEvaluatedError(
            f"none of {len(attempts)} moved demonstrations passed; {_commonest(record)}",
            remedy="try --conditions clean, or record more demonstrations to move",
        )
    from minidual.demos import lerobot_adapter  # takes seconds

    paths = [attempt.path for attempt in kept if attempt.path is not None]
    lerobot_adapter.convert(paths, folder / _FINISHED, job.robot)
    return ToolResult(
        augment_lines(record, folder),
        [f"reasons of the others: {folder / 'quality.csv'}; their episodes: {folder / 'rejected'}"],
        {"folder": str(folder), **record},
    )


def augment_record(
    attempts: Sequence[rig.Attempt],
    sources_n: int,
    refused: Sequence[str],
) -> dict[str, Any]:
    """Return the outcome of all attempts, in JSON types."""
    reasons = Counter(_short(attempt.reason) for attempt in attempts if not attempt.kept)
    return {
        "sources": sources_n,
        "sources_refused": list(refused),
        "attempts": len(attempts),
        "kept": sum(attempt.kept for attempt in attempts),
        "rejected": dict(reasons.most_common()),
    }


def augment_lines(record: dict[str, Any], folder: Path) -> list[str]:
    """Return the result for people."""
    kept = record["kept"]
    attempts = record["attempts"]
    low, high = wilson_interval(kept, attempts)
    interval = f"{100 * low:.0f} to {100 * high:.0f} %"
    lines = [
        f"{record['sources']} demonstrations became {kept}",
        f"accepted: {kept} of {attempts} attempts, {100 * kept / attempts:.0f} % ({interval})",
    ]
    shown = list(record["rejected"].items())[:_REASONS_SHOWN]
    lines += [f"  rejected {count} x {reason}" for reason, count in shown]
    lines.append(f"train on them: minidual train-act --dataset {folder}")
    return lines


def _job(context: ToolContext, folder: Path) -> tuple[rig.Job, list[str], int]:
    """Return the recording, why episodes cannot be moved, and how many can."""
    options = context.options
    path = str(expanded(str(options["path"])))
    names = [name.strip() for name in str(options.get("conditions") or CONDITIONS).split(",")]
    episodes_n = context.config.teleop.episodes_n
    attempts_n = int(options.get("attempts") or _ATTEMPTS_EACH * episodes_n)
    if attempts_n < episodes_n:
        raise UsageError(f"--attempts is {attempts_n}; {episodes_n} episodes need at least as many")
    config = changed(
        context.config,
        {
            "teleop.leader": LEADER,
            "teleop.augment.path": path,
            "teleop.augment.demonstrations_n": int(options.get("demonstrations") or 0),
            "teleop.attempts_max_ratio": min(10.0, attempts_n / episodes_n),
            "teleop.conditions": tuple(names),
        },
    )
    task = make_task(config)
    if not task.together:
        able = [name for name in TASKS if make_task(changed(config, {"task": name})).together]
        raise UsageError(
            f"in the task '{task.name}' the hands do not hold one object all the way; "
            f"demonstrations of {', '.join(able)} can be moved",
            remedy=f"--task {able[0]}",
        )
    job = rig.Job(
        folder=folder,
        task=task,
        teleop=task.config.teleop,
        arbiter=task.config.arbiter,
        seed=subseed(context.seed, "data.augment"),
        supervisor=task.config.supervisor,
        rooms=rooms(names),
    )
    augment = job.teleop.augment
    sources, refused = read_sources(
        augment.path,
        Kinematics(job.robot),
        augment.near_m,
        augment.demonstrations_n,
    )
    return job, refused, len(sources)


def _inputs(context: ToolContext, job: rig.Job) -> dict[str, Any]:
    """Return the inputs of the episodes: settings, code, and the demonstrations that are moved."""
    inputs = recording_inputs(job.task.config)
    inputs["seed"] = job.seed
    paths = source_paths(job.teleop.augment.path)
    inputs["sources"] = {path.name: file_sha256(path) for path in paths}
    return inputs


def _recorded(context: ToolContext, job: rig.Job) -> list[rig.Attempt]:
    attempts: list[rig.Attempt] = []
    with (
        context.progress.task("demonstrations", job.teleop.episodes_n) as bar,
        closing(recording.attempts_of(job, context.workers)) as coming,
    ):
        for attempt in coming:
            attempts.append(attempt)
            reason = "" if attempt.kept else f"trial {attempt.trial.index}: {attempt.reason}"
            bar.advance(int(attempt.kept), reason)
    return attempts


def _short(reason: str) -> str:
    """Return a reason without the numbers of one trial."""
    return _NUMBER.sub("#", reason.split(" (")[0])


def _commonest(record: dict[str, Any]) -> str:
    reason, count = next(iter(record["rejected"].items()))
    return f"{count} x {reason}"
