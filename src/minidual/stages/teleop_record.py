"""`minidual teleop-record`: record demonstrations and convert them to a dataset."""

import itertools
import time
from collections import Counter
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

from minidual.config.learning import DeployConfig, TeleopConfig
from minidual.config.root import Config
from minidual.demos import recording, rig
from minidual.demos.attempt import AttemptFiles
from minidual.demos.corrections import DrivingPolicy
from minidual.demos.leader import LEADERS, Leader
from minidual.demos.lerobot_reader import LeRobotTables
from minidual.demos.quality import JERK_FILTER
from minidual.demos.recording import Observe
from minidual.demos.schema import MAX_SYNC_S
from minidual.durable import expanded, write_csv
from minidual.errors import NothingEvaluatedError
from minidual.gate.canonical import canonical
from minidual.gate.check import Check
from minidual.gate.code import code_of
from minidual.gate.criterion import Criterion
from minidual.gate.stage import StageContext, StageResult
from minidual.robot.pair import robot_from
from minidual.show.figures.film import film_demonstration
from minidual.show.figures.link import draw_link
from minidual.show.figures.teleop import draw_lags, draw_quality
from minidual.stages.leading import leading
from minidual.tasks.catalogue import make_task
from minidual.trials.conditions import rooms

READS = ("robot", "task", "teleop", "plan.planner", "scene", "arbiter", "supervisor")
"""Configuration paths that the recording depends on."""
_NAME = "teleop-record"
_TESTS_SHOWN = 100
"""Starts of `deploy` that the figure shows beside those of the demonstrations."""

EPISODES = Criterion(
    "episodes",
    ">=",
    why="demonstrations kept",
    remedy="see `reason` in quality.csv; raise teleop.attempts_max_ratio",
)
SCHEMA_OK = Criterion(
    "schema_ok",
    "==",
    why="every file, opened again, is sound and inside the limits",
    remedy="read `faults` in the verdict",
)
JERK_RMS_MAX = Criterion(
    "jerk_rms_max",
    "<",
    unit="rad/s^3",
    why="roughest demonstration kept",
    remedy="quality.csv names the roughest; set teleop.operator.speed_spread to 0, "
    "or smooth the leader's targets",
)
LATENCY_P99 = Criterion(
    "latency_p99_s",
    "<",
    unit="s",
    why="wall time from reading the leader to its torque, 99th percentile",
    remedy="use fewer workers",
    clocked=True,
)
LAG_P50 = Criterion(
    "lag_p50_s",
    "<",
    unit="s",
    why="joints behind the leader, median of the moving samples of all demonstrations",
    remedy="set teleop.following to swift, or raise teleop.rate_hz",
)
EPISODES_PER_MIN = Criterion(
    "episodes_per_min",
    ">",
    unit="1/min",
    why="demonstrations kept, conversion included",
    remedy="use more workers, or fewer cameras",
    clocked=True,
)
SYNC_ERROR_MAX = Criterion(
    "sync_error_max_s",
    "<=",
    unit="s",
    why="images against joints of a tick: a camera stamps the state that it shows",
    remedy="read both in one tick, from cameras without delay",
)
DATASET_ROWS = Criterion(
    "dataset_rows",
    "==",
    why="every recorded tick is a row and a frame of each video",
    remedy="check the disk; add --force",
)
DATASET_EPISODES = Criterion(
    "dataset_episodes",
    "==",
    why="every demonstration kept is an episode of the dataset",
    remedy="record again with --force",
)
SUCCESS_RATE = Criterion(
    "success_rate",
    why="share of attempts that achieved the task; others are left out",
)
ATTEMPTS = Criterion("attempts", why="trials that were led")
LAG_P99 = Criterion("lag_p99_s", unit="s", why="the same, 99th percentile")
LATENCY_P50 = Criterion("latency_p50_s", unit="s", why="median of the same", clocked=True)
RECORDED_PER_MIN = Criterion(
    "recorded_per_min",
    unit="1/min",
    why="the rate of recording alone",
    clocked=True,
)


def record_checks(numbers: Mapping[str, float], config: TeleopConfig) -> list[Check]:
    """Return the stage's checks from `RecordedAttempts.numbers` and the sizes of the dataset.

    A person's pauses are their own: the rate is reported.
    """
    is_person = LEADERS[config.leader].features.realtime
    rate_min = None if is_person else config.episodes_per_min
    return [
        EPISODES.check(numbers["episodes"], config.episodes_n),
        SCHEMA_OK.check(numbers["schema_ok"], True),
        JERK_RMS_MAX.check(numbers["jerk_rms_max"], config.jerk_max_rad_s3),
        LATENCY_P99.check(numbers["latency_p99_s"], config.latency_max_s),
        LAG_P50.check(numbers["lag_p50_s"], config.lag_max_s),
        EPISODES_PER_MIN.check(numbers["episodes_per_min"], rate_min),
        SYNC_ERROR_MAX.check(numbers["sync_error_max_s"], MAX_SYNC_S),
        DATASET_ROWS.check(numbers["dataset_rows"], numbers["recorded_ticks"]),
        DATASET_EPISODES.check(numbers["dataset_episodes"], numbers["episodes"]),
        SUCCESS_RATE.report(numbers["success_rate"]),
        ATTEMPTS.report(numbers["attempts"]),
        LAG_P99.report(numbers["lag_p99_s"]),
        LATENCY_P50.report(numbers["latency_p50_s"]),
        RECORDED_PER_MIN.report(numbers["recorded_per_min"]),
    ]


def recording_inputs(config: Config) -> dict[str, Any]:
    """Return the inputs of the episodes (JSON types)."""
    code = code_of(["minidual.demos.recording:attempts_of", "minidual.trials.conditions:rooms"])
    values = {path: canonical(attrgetter(path)(config), path) for path in READS}
    return {"seed": config.seed, "code": code.modules, **values}


class _Demonstrations:
    """The attempts of a recording as they come.

    Attributes:
        attempts: All so far.
        began_s: When the first attempt began, by time.perf_counter(); 0 before.
    """

    def __init__(self, context: StageContext, job: rig.Job, observe: Observe | None) -> None:
        self._context = context
        self._job = job
        self._observe = observe
        self.attempts: list[rig.Attempt] = []
        self.began_s = 0.0

    def paths(self) -> Generator[Path]:
        """Record; yield the file of each demonstration, and write quality.csv at the end."""
        context = self._context
        with context.progress.task("demonstrations", self._job.teleop.episodes_n) as task:
            for attempt in recording.attempts_of(self._job, context.workers, self._observe):
                self.attempts.append(attempt)
                if not self.began_s:
                    self.began_s = time.perf_counter() - attempt.wall_s
                reason = "" if attempt.kept else f"trial {attempt.trial.index}: {attempt.reason}"
                task.advance(int(attempt.kept), reason)
                self._talk(attempt)
                if attempt.path is not None and attempt.kept:
                    yield attempt.path
        write_csv(context.folder / "quality.csv", [attempt.row() for attempt in self.attempts])

    def _talk(self, attempt: rig.Attempt) -> None:
        """Tell a person how the attempt went, and when to rest."""
        if not recording.led_by_person(self._job):
            return
        kept_n = sum(one.kept for one in self.attempts)
        wanted_n = self._job.teleop.episodes_n
        result = attempt.reason or f"kept, {kept_n} of {wanted_n}"
        self._context.progress.note(f"trial {attempt.trial.index}: {result}")
        rest_after_n = self._job.teleop.person.rest_after_episodes
        if rest_after_n and attempt.kept and kept_n < wanted_n and kept_n % rest_after_n == 0:
            self._context.progress.note(f"{kept_n} episodes: rest your eyes and hands a while")


def run(context: StageContext) -> StageResult:
    """Record, convert and film; write quality.csv, quality.svg and lag.svg."""
    folder = context.folder
    teleop = context.config.teleop
    job = _job(context)
    with leading(context) as observe:
        demonstrations = _Demonstrations(context, job, observe)
        dataset = _record_dataset(context, job, demonstrations)
    attempts = demonstrations.attempts
    recorded = recording.recording_of(job, context.workers, attempts)
    numbers = recorded.numbers(time.perf_counter() - demonstrations.began_s)
    numbers["dataset_rows"] = len(dataset)
    numbers["dataset_episodes"] = len(dataset.starts)
    if not recording.led_by_person(job):  # a person does not do the same thing twice
        context.progress.note("filming the first demonstration again")
        film_demonstration(job, recorded.kept[0].trial.index, folder / "demonstration.mp4")
    tests = [job.task.trial(context.seed, "deploy", k) for k in range(_TESTS_SHOWN)]
    draw_quality(recorded.attempts, tests, teleop.jerk_max_rad_s3, folder / "quality.svg")
    draw_lags(recorded.lags_s, teleop.lag_max_s, folder / "lag.svg")
    _draw_link(context, recorded.kept)
    rejected = [a for a in attempts if not a.kept]
    data = {
        "rejected": {str(a.trial.index): a.reason for a in rejected},
        "faults": {str(a.trial.index): list(a.faults) for a in recorded.attempts if a.faults},
        "jerk_filter": JERK_FILTER,
    }
    if teleop.link.network:
        data["link"] = {str(a.trial.index): _of_link(a) for a in attempts}
    return StageResult(
        checks=record_checks(numbers, teleop),
        data=data,
        notes=_notes(attempts, rejected),
    )


def _draw_link(context: StageContext, kept: Sequence[rig.Attempt]) -> None:
    """Draw the log of the link in the first demonstration, if there is one."""
    if not context.config.teleop.link.network or not kept:
        return
    path = AttemptFiles(context.folder).link_path(kept[0].trial.index)
    if path.exists():
        draw_link(path, context.folder / "link.svg")


def _job(context: StageContext) -> rig.Job:
    config = context.config
    return rig.Job(
        folder=context.folder,
        task=make_task(config),
        teleop=config.teleop,
        arbiter=config.arbiter,
        seed=context.seed,
        supervisor=config.supervisor,
        rooms=rooms(config.teleop.conditions),
        policy=_policy(config),
    )


def _policy(config: Config) -> Callable[[], DrivingPolicy] | None:
    """Return the loader of the policy to be corrected, or None."""
    if not config.teleop.correct:
        return None
    from minidual.policies.pilot import load_runtime  # torch takes seconds

    robot = robot_from(config.robot)
    return partial(load_runtime, expanded(config.teleop.correct), DeployConfig(), robot)


def _record_dataset(
    context: StageContext,
    job: rig.Job,
    demonstrations: _Demonstrations,
) -> LeRobotTables:
    """Record, and convert the demonstrations as they come.

    Raises:
        NothingEvaluatedError: No attempt became a demonstration.
    """
    # Takes seconds: interrupted there, no workers are left behind.
    from minidual.demos import lerobot_adapter

    leader = LEADERS[job.teleop.leader]
    adopted_note = recording.claim(context.folder, recording_inputs(context.config), _NAME)
    for note in (adopted_note, leader.usage):
        if note:
            context.progress.note(note)
    with closing(demonstrations.paths()) as coming:  # an interruption ends the workers here
        # A person does not wait between two episodes: conversion begins after the last.
        paths = iter(list(coming)) if leader.features.realtime else coming
        first = next(paths, None)
        if first is None:
            recording.claim(context.folder, {}, _NAME)  # typed again, the command tries again
            raise _nothing_recorded(demonstrations.attempts, leader)
        context.progress.note(
            "demonstrations go into the dataset as they come; at the end every picture is compared",
        )
        every_path = itertools.chain([first], paths)
        return lerobot_adapter.convert(every_path, context.folder / "lerobot", job.robot)


def _nothing_recorded(
    attempts: Sequence[rig.Attempt],
    leader: type[Leader],
) -> NothingEvaluatedError:
    message = f"none of {len(attempts)} attempts became a demonstration; {_commonest(attempts)}"
    if leader.features.realtime:
        remedy = "read `reason` above, and type the command again"
    else:
        remedy = (
            "read `reason` above; try --set teleop.leader=scripted, "
            "or the defaults of teleop.operator"
        )
    return NothingEvaluatedError(message, remedy=remedy)


def _of_link(attempt: rig.Attempt) -> dict[str, float]:
    """Return the measures of an attempt that its link gave."""
    measures = attempt.measures
    return {name: measures[name] for name in measures if name.startswith("link_")}


def _notes(attempts: Sequence[rig.Attempt], rejected: Sequence[rig.Attempt]) -> list[str]:
    commonest = f"; {_commonest(rejected)}" if rejected else ""
    notes = [f"{len(rejected)} of {len(attempts)} attempts were left out{commonest}"]
    adopted_n = sum(a.adopted for a in attempts)
    if adopted_n:
        notes.append(f"{adopted_n} attempts were recorded before an interruption")
    return notes


def _commonest(attempts: Sequence[rig.Attempt]) -> str:
    """Return the most frequent reason and its count, such as "3 x late"."""
    reasons = Counter(attempt.reason for attempt in attempts)
    reason, count = reasons.most_common(1)[0]
    return f"{count} x {reason}"
