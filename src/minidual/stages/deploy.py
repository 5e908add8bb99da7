"""`minidual deploy`: the trained policy on held-out starts."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from minidual.config.seeds import stream
from minidual.demos.episode import episode_paths, read_meta
from minidual.gate.check import Check
from minidual.gate.stage import StageContext, StageResult
from minidual.policies.pilot import load_runtime
from minidual.robot.arms import robot_from
from minidual.show.figures.film import film_trial
from minidual.show.watch import watch_trials
from minidual.tasks.task import Trial, make_task
from minidual.trials.methods import MethodInputs
from minidual.trials.metrics import MethodSummary, summarise
from minidual.trials.runner import TrialResult, run_trials
from minidual.trials.statistics import wilson_interval
from minidual.trials.tables import write_csv, write_json

METHOD = "act"
HELD_OUT, TRAINING = "deploy", "demonstrations"
"""Random streams: held-out trials, and the demonstrations' starts."""


def deploy_checks(
    successes: int, trials: int, inference_hz: float, *, success_rate_min: float | None, inference_hz_min: float
) -> list[Check]:
    """Return the checks; without `success_rate_min` the rate is only reported (smoke)."""
    low, high = wilson_interval(successes, trials)
    op = None if success_rate_min is None else ">"
    return [
        Check(
            "success_rate",
            successes / trials,
            op,
            success_rate_min,
            "",
            f"closed-loop success on {trials} starts held out from training",
            "record more demonstrations (teleop-record --episodes 200) or train longer (--set train.steps=...)",
        ),
        Check("success_low", low, unit="", why="lower end of its 95 % Wilson interval"),
        Check("success_high", high, unit="", why="upper end of its 95 % Wilson interval"),
        Check("trials", trials, ">=", 1, "", "a rate over no trials says nothing"),
        Check(
            "inference_hz",
            inference_hz,
            ">",
            inference_hz_min,
            "hz",
            "whole inference with pre- and post-processing must keep up with the arms",
            "use the policy spatial_act, or a smaller image",
        ),
    ]


def run(context: StageContext) -> StageResult:
    """Run held-out and training starts; film one success and one failure."""
    config, task = context.config, make_task(context.config)
    settings = config.deploy
    checkpoint = context.upstream["train-act"] / "checkpoint"
    inputs = MethodInputs(config, context.seed, checkpoint)
    shown = _demonstrated(context.upstream["teleop-record"], settings.training_trials)
    starts = {
        "held_out": [task.trial(context.seed, HELD_OUT, i) for i in range(settings.trials)],
        "training": [task.trial(context.seed, TRAINING, i, widen=config.teleop.widen) for i in shown],
    }
    results: dict[str, list[TrialResult]] = {name: [] for name in starts}
    with context.progress.task("policy trials", sum(map(len, starts.values()))) as bar:
        for name, trials in starts.items():
            for result, _ in run_trials(
                METHOD, inputs, trials, workers=context.workers, watch=watch_trials(context.view)
            ):
                # Neither set is disturbed; the tables list them as conditions.
                results[name].append(replace(result, metrics=replace(result.metrics, condition=name)))
                done = sum(r.success for r in results[name])
                bar.advance(note=f"{name} {done}/{len(results[name])}")
    everything = [r for rows in results.values() for r in rows]
    metrics = [r.metrics for r in everything]
    rng = stream(context.seed, "bootstrap/deploy")
    summaries = {name: summarise([r.metrics for r in rows], rng) for name, rows in results.items() if rows}
    write_csv(context.folder / "trials.csv", metrics)
    write_json(context.folder / "trials.json", list(summaries.values()), metrics)
    _film(context, inputs, starts["held_out"], results["held_out"])

    summary = summaries["held_out"]
    checks = deploy_checks(
        summary.successes_n,
        summary.trials_n,
        measure_inference(checkpoint, context),
        success_rate_min=settings.success_rate_min if settings.judge_success else None,
        inference_hz_min=settings.inference_hz_min,
    )
    data: dict[str, Any] = {**_interval(summary), "failures": dict(summary.failures)}
    if "training" in summaries:
        training = summaries["training"]
        checks.append(Check("training_success_rate", training.success_rate, why="the same on starts it was trained on"))
        data["training"] = {**_interval(training), "success_rate": training.success_rate}
    errors = [r.metrics.goal_error_m for r in everything if r.lifted]
    if errors:
        why = "of trials that lifted the object"
        checks.append(Check("goal_error_median_m", statistics.median(errors), unit="m", why=why))
    return StageResult(checks=checks, data=data)


def _interval(summary: MethodSummary) -> dict[str, float]:
    return {"trials": summary.trials_n, "success_low": summary.success_low, "success_high": summary.success_high}


def _film(context: StageContext, inputs: MethodInputs, trials: Sequence[Trial], results: Sequence[TrialResult]) -> None:
    for label, wanted in (("success", True), ("failure", False)):
        index = next((i for i, r in enumerate(results) if r.success is wanted), None)
        if index is not None:
            filmed = film_trial(METHOD, inputs, trials[index], context.folder / f"{label}.mp4")
            context.progress.note(f"{label}.mp4 shows trial {index}: {filmed.text}")


def _demonstrated(teleop_folder: Path, count: int) -> list[int]:
    """Return the trial indices of the first kept demonstrations."""
    return [read_meta(path).trial for path in episode_paths(teleop_folder / "episodes")[:count]]


def measure_inference(checkpoint: Path, context: StageContext, inferences: int = 60) -> float:
    """Return inferences per second of the closed-loop runtime, run alone."""
    robot = robot_from(context.config.robot)
    runtime = load_runtime(checkpoint, context.config.deploy, robot)
    rng = np.random.default_rng(0)
    state = np.concatenate([robot.home, np.ones(2)])
    for _ in range(inferences):
        runtime.reset()
        runtime.act({c: rng.integers(0, 255, (*size, 3), dtype=np.uint8) for c, size in runtime.cameras.items()}, state)
    return runtime.inference_hz
