"""`minidual carry`: two arms carry an object under object impedance from random starts."""

from collections.abc import Mapping, Sequence

import numpy as np

from minidual.config.control import CarryLimits
from minidual.config.scene import TaskConfig
from minidual.config.seeds import stream
from minidual.demos.quality import JERK_FILTER
from minidual.durable import write_csv
from minidual.errors import DataError
from minidual.gate.check import Check
from minidual.gate.criterion import Criterion
from minidual.gate.stage import StageContext, StageResult
from minidual.robot.pair import robot_from
from minidual.show.figures.film import film_trial
from minidual.show.figures.trial import draw_trial
from minidual.show.watch import watch_trials
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Trial, pose_of
from minidual.trials.measures import TrialLog
from minidual.trials.methods import MethodInputs
from minidual.trials.metrics import MethodSummary, TrialMetrics, summarise
from minidual.trials.runner import Bench, run_trials

METHOD = "impedance"
RECORDED_FAILURES_MAX = 20
"""Largest number of failed trials that are recorded; trials.csv has all."""
FILMS = {"median": "carry.mp4", "worst": "worst.mp4"}
"""Films of the trials that are shown."""

SUCCESS_RATE = Criterion(
    "success_rate",
    ">=",
    why="share of trials in which both arms carried the object to its goal and let go",
    remedy="trials.csv names what failed first; "
    "minidual carry --set carry.impedance.internal_force_n=...",
)
TILT_MAX = Criterion(
    "tilt_max_rad",
    "<",
    unit="rad",
    why="a tilted object slips or spills",
    remedy="raise carry.impedance.stiffness_n_per_m "
    "or lower carry.pace.object_acceleration_m_per_s2",
)
INTERNAL_FORCE_MIN = Criterion(
    "internal_force_min_n",
    ">",
    unit="N",
    why="squeeze between the hands while the object is off the table; below it the object may slip",
    remedy="raise carry.impedance.internal_force_n (at most 80)",
)
DURATION_MAX = Criterion(
    "duration_max_s",
    "<",
    unit="s",
    why="from the start to the object released at its goal; "
    "a failed trial counts as the time limit",
    remedy="raise the limits of carry.pace",
)
TORQUE_RATIO_MAX = Criterion(
    "torque_ratio_max",
    "<",
    why="largest motor torque over its limit; at 1 the drive saturates and control is lost",
    remedy="lower carry.impedance.internal_force_n or the limits of carry.pace",
)
SATURATED_MAX = Criterion(
    "saturated_max_s",
    "<=",
    unit="s",
    why="longest time that a motor stands at its limit, failed trials included: "
    "a fault must stop softly",
    remedy="lower the speeds of carry.pace: a slower carry stops with less torque",
)
SUCCESS_LOW = Criterion("success_low", why="lower end of the 95 % Wilson interval")
GOAL_ERROR_MAX = Criterion("goal_error_max_m", unit="m", why="largest distance from the goal")
PINCH_FORCE_MIN = Criterion("pinch_force_min_n", unit="N", why="least grip in the air")
DURATION_MEDIAN = Criterion(
    "duration_median_s",
    unit="s",
    why="median of the successful trials",
)
JERK_RMS_MEDIAN = Criterion("jerk_rms_median", unit="rad/s^3", why=JERK_FILTER)


def carry_checks(
    trials: Sequence[TrialMetrics],
    limits: CarryLimits,
    task: TaskConfig,
) -> list[Check]:
    """Return the stage's checks of at least one trial.

    Extremes include failed trials. NaN propagates, and fails its limit.
    """
    success_rate = float(np.mean([t.success for t in trials]))
    tilt_max_rad = float(np.max([t.tilt_max_rad for t in trials]))
    internal_force_min_n = float(np.min([t.internal_force_min_n for t in trials]))
    durations_s = [t.duration_s if t.success else task.time_limit_s for t in trials]
    torque_ratio_max = float(np.max([t.torque_ratio_max for t in trials]))
    saturated_max_s = float(np.max([t.saturated_max_s for t in trials]))
    return [
        SUCCESS_RATE.check(success_rate, limits.success_rate_min),
        TILT_MAX.check(tilt_max_rad, limits.tilt_max_rad),
        INTERNAL_FORCE_MIN.check(internal_force_min_n, task.internal_force_min_n),
        DURATION_MAX.check(float(np.max(durations_s)), limits.duration_max_s),
        TORQUE_RATIO_MAX.check(torque_ratio_max, 1.0),
        SATURATED_MAX.check(saturated_max_s, limits.saturation_max_s),
    ]


def reported_checks(trials: Sequence[TrialMetrics], summary: MethodSummary) -> list[Check]:
    """Return the values that have no limit."""
    return [
        SUCCESS_LOW.report(summary["success_low"]),
        GOAL_ERROR_MAX.report(float(np.max([t.goal_error_m for t in trials]))),
        PINCH_FORCE_MIN.report(float(np.min([t.pinch_force_min_n for t in trials]))),
        DURATION_MEDIAN.report(summary["duration_median_s"]),
        JERK_RMS_MEDIAN.report(summary["jerk_rms_median"]),
    ]


def run(context: StageContext) -> StageResult:
    """Run the trials; plot, film and record the median and worst, and record failures."""
    config = context.config
    task = make_task(config)
    inputs = MethodInputs(config, context.seed)
    trials = [task.trial(context.seed, "carry", i) for i in range(config.carry.trials_n)]
    results = _run_trials(context, inputs, trials)
    summary = summarise(results, stream(context.seed, "bootstrap/carry"))
    write_csv(context.folder / "trials.csv", [m.to_row() for m in results])
    shown = shown_trials(results)
    if context.pictures:
        logs = record_trials(context, Bench(METHOD, inputs), trials, results, shown)
        with context.progress.task("films", len(shown)) as bar:
            for label, i in shown.items():
                _show_trial(context, label, trials[i], results[i], logs[label])
                bar.advance()
    checks = carry_checks(results, config.carry.limits, task.scene.task)
    checks += reported_checks(results, summary)
    return StageResult(checks=checks, data={**summary.record(), "shown": shown})


def _run_trials(
    context: StageContext,
    inputs: MethodInputs,
    trials: Sequence[Trial],
) -> list[TrialMetrics]:
    watch = watch_trials(context.view)
    results: list[TrialMetrics] = []
    with context.progress.task("carries", len(trials)) as bar:
        for result in run_trials(METHOD, inputs, trials, workers=context.workers, watch=watch):
            results.append(result)
            bar.advance(note="" if result.success else f"trial {result.index}: {result.text}")
    return results


def shown_trials(results: Sequence[TrialMetrics]) -> dict[str, int]:
    """Return the positions of the median and the worst trial.

    Failed trials are the worst, then those with the largest tilt.
    """
    badness = [m.tilt_max_rad if m.success else np.inf for m in results]
    worst_first = np.argsort(-np.array(badness), kind="stable")
    return {"median": int(worst_first[len(worst_first) // 2]), "worst": int(worst_first[0])}


def _show_trial(
    context: StageContext,
    label: str,
    trial: Trial,
    result: TrialMetrics,
    log: TrialLog,
) -> None:
    """Plot and film a trial."""
    config = context.config
    task = make_task(config)
    carried = task.objects[task.carried].body
    draw_trial(
        log,
        task.scene,
        robot_from(config.robot),
        context.folder / f"{label}.svg",
        goal=pose_of(carried, trial.goal[task.carried])[:3, 3],
        title=f"{config.carry.object}, {config.carry.motion}: "
        f"{label} trial ({result.index}): {result.text}",
    )
    inputs = MethodInputs(config, context.seed)
    film_trial(METHOD, inputs, trial, context.folder / FILMS[label])


def record_trials(
    context: StageContext,
    bench: Bench,
    trials: Sequence[Trial],
    results: Sequence[TrialMetrics],
    shown: Mapping[str, int],
) -> dict[str, TrialLog]:
    """Run trials again and write their recordings: the first failures, and `shown` ({label: i}).

    Returns:
        {label: log} of the recordings.

    Raises:
        DataError: A trial ends otherwise than in its first run.
    """
    failed = [i for i, result in enumerate(results) if not result.success]
    labelled = [
        (i, f"trial{i:03d}") for i in failed[:RECORDED_FAILURES_MAX] if i not in shown.values()
    ]
    labelled += [(i, label) for label, i in shown.items()]  # one trial may have both labels
    logs: dict[str, TrialLog] = {}
    with context.progress.task("recordings", len(labelled)) as bar:
        for i, label in labelled:
            again, logs[label] = bench.record(trials[i], context.folder / f"{label}.npz")
            if again.text != results[i].text:
                raise DataError(
                    f"trial {i} ended otherwise when it was recorded: {again.text}; "
                    f"before: {results[i].text}",
                    remedy="trials must depend on their seed alone; report this",
                )
            bar.advance()
    return logs
