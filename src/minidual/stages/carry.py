"""`minidual carry`: two arms carry an object under object impedance from random starts."""

from collections.abc import Sequence

import numpy as np

from minidual.config.control import CarryLimits
from minidual.config.scene import TaskConfig
from minidual.config.seeds import stream
from minidual.demos.quality import JERK_FILTER
from minidual.durable import write_csv
from minidual.errors import DataError
from minidual.gate.check import Check, Rows
from minidual.gate.stage import StageContext, StageResult
from minidual.robot.pair import robot_from
from minidual.show.figures.film import film_trial
from minidual.show.figures.trial import draw_trial
from minidual.show.watch import watch_trials
from minidual.stages.words import worded
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Trial, pose_of
from minidual.trials.measures import TrialLog
from minidual.trials.methods import MethodInputs
from minidual.trials.metrics import TrialMetrics, summarise
from minidual.trials.runner import Bench, run_trials

METHOD = "impedance"
RECORDED_FAILURES_MAX = 20
"""Failures recorded at most; trials.csv has all."""


def carry_checks(
    trials: Sequence[TrialMetrics],
    limits: CarryLimits,
    task: TaskConfig,
) -> list[Check]:
    """Return the stage's checks of at least one trial; extremes include failed trials, NaN propagates."""
    least_n = float(np.min([t.internal_force_min_n for t in trials]))
    durations = [t.duration_s if t.success else task.time_limit_s for t in trials]
    rows: Rows = {
        "success_rate": (
            float(np.mean([t.success for t in trials])),
            ">=",
            limits.success_rate_min,
        ),
        "tilt_max_rad": (float(np.max([t.tilt_max_rad for t in trials])), "<", limits.tilt_max_rad),
        "internal_force_min_n": (least_n, ">", task.internal_force_min_n),
        "duration_max_s": (float(np.max(durations)), "<", limits.duration_max_s),
        "torque_ratio_max": (float(np.max([t.torque_ratio_max for t in trials])), "<", 1.0),
        "saturated_max_s": (
            float(np.max([t.saturated_max_s for t in trials])),
            "<=",
            limits.saturation_max_s,
        ),
    }
    return worded("carry", rows)


def run(context: StageContext) -> StageResult:
    """Run the trials; plot, film and record the median and worst, and record failures."""
    config = context.config
    task = make_task(context.config)
    inputs = MethodInputs(config, context.seed)
    watch = watch_trials(context.view)
    trials = [task.trial(context.seed, "carry", i) for i in range(config.carry.trials_n)]
    results: list[TrialMetrics] = []
    with context.progress.task("carries", len(trials)) as bar:
        for result in run_trials(METHOD, inputs, trials, workers=context.workers, watch=watch):
            results.append(result)
            bar.advance(note="" if result.success else f"trial {result.index}: {result.text}")
    summary = summarise(results, stream(context.seed, "bootstrap/carry"))
    write_csv(context.folder / "trials.csv", [m.to_row() for m in results])

    order = np.argsort([-m.tilt_max_rad if m.success else -np.inf for m in results], kind="stable")
    shown = {"median": int(order[len(order) // 2]), "worst": int(order[0])}
    logs = _record(context, Bench(METHOD, inputs), trials, results, shown)
    with context.progress.task("films", len(shown)) as bar:
        for (label, i), film in zip(shown.items(), ("carry.mp4", "worst.mp4"), strict=True):
            title = f"{config.carry.object}, {config.carry.motion}: {label} trial ({i}): {results[i].text}"
            goal = pose_of(task.objects[task.carried].body, trials[i].goal[task.carried])[:3, 3]
            picture = context.folder / f"{label}.png"
            robot = robot_from(config.robot)
            draw_trial(logs[label], task.scene, robot, picture, goal=goal, title=title)
            film_trial(METHOD, inputs, trials[i], context.folder / film)
            bar.advance()

    reported: Rows = {
        "success_low": summary["success_low"],
        "goal_error_max_m": float(np.max([m.goal_error_m for m in results])),
        "pinch_force_min_n": float(np.min([m.pinch_force_min_n for m in results])),
        **{name: summary[name] for name in ("duration_median_s", "jerk_rms_median")},
    }
    checks = carry_checks(results, config.carry.limits, task.scene.task)
    checks += worded("carry", reported, jerk_filter=JERK_FILTER)
    return StageResult(checks=checks, data={**summary.record(), "shown": shown})


def _record(
    context: StageContext,
    bench: Bench,
    trials: list[Trial],
    results: list[TrialMetrics],
    shown: dict[str, int],
) -> dict[str, TrialLog]:
    logs: dict[str, TrialLog] = {}
    failed = [i for i, result in enumerate(results) if not result.success]
    named = [
        (i, f"trial{i:03d}") for i in failed[:RECORDED_FAILURES_MAX] if i not in shown.values()
    ]
    named += [(i, label) for label, i in shown.items()]  # one trial may be both
    with context.progress.task("recordings", len(named)) as bar:
        for i, label in named:
            again, logs[label] = bench.record(trials[i], context.folder / f"{label}.npz")
            if again.text != results[i].text:
                otherwise = f"trial {i} ended otherwise when it was recorded: {again.text}; before: {results[i].text}"
                raise DataError(
                    otherwise,
                    remedy="trials must depend on their seed alone; report this",
                )
            bar.advance()
    return logs
