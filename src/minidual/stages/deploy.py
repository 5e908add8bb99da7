"""`minidual deploy`: the trained policy on held-out starts."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from minidual.config.learning import DeployConfig
from minidual.config.root import Config
from minidual.config.seeds import stream
from minidual.demos.episode import episode_paths, read_meta
from minidual.demos.rig import PURPOSE as TRAINING
from minidual.durable import write_csv
from minidual.gate.check import Check, Rows
from minidual.gate.stage import StageContext, StageResult
from minidual.gate.verdict import CONFIG_FILE
from minidual.plant.render import Camera, Image
from minidual.policies.occlusion import occlusion, on_object
from minidual.policies.pilot import load_runtime
from minidual.robot.pair import Array, robot_from
from minidual.show.figures.canvas import draw_occlusion
from minidual.show.figures.film import film_trial
from minidual.show.watch import watch_trials
from minidual.stages.words import worded
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Trial, placement
from minidual.trials.conditions import CLEAN, CONDITIONS
from minidual.trials.methods import MethodInputs, check_able
from minidual.trials.metrics import MethodSummary, TrialMetrics, summarise
from minidual.trials.runner import Bench, run_trials

METHOD = "act"
HELD_OUT = "deploy"
"""Random stream of the held-out trials; `TRAINING` is that of the demonstrations."""
HIDDEN = "object hidden"
_INFERENCES_N = 60


def deploy_starts(
    config: Config,
    seed: int,
    demonstrated: Sequence[int],
) -> tuple[dict[str, list[Trial]], int]:
    """Return {"held_out": trials, "training": trials}, and the number of held-out trials drawn by a demonstration too.

    `demonstrated`: trial indices of the demonstrations.
    """
    task = make_task(config)
    settings = config.deploy
    shown = demonstrated[: settings.training_trials]
    widen = config.teleop.widen
    held_out = range(settings.first_start, settings.first_start + settings.trials)
    starts = {
        "held_out": [task.trial(seed, HELD_OUT, i) for i in held_out],
        "training": [task.trial(seed, TRAINING, i, widen=widen) for i in shown],
    }
    drawn = [
        _poses(task.trial(seed, TRAINING, i)) for i in demonstrated
    ]  # as wide as the held-out ones
    return starts, sum(_poses(trial) in drawn for trial in starts["held_out"])


def _poses(trial: Trial) -> list[object]:
    return [np.asarray(pose).tolist() for pose in (*trial.start.values(), *trial.goal.values())]


def deploy_checks(
    held_out: MethodSummary,
    seen_n: int,
    inference_hz: float,
    settings: DeployConfig,
) -> list[Check]:
    """Return the checks."""
    rows: Rows = {
        "success_rate": (held_out["success_rate"], ">", settings.success_rate_min),
        **{name: held_out[name] for name in ("success_low", "success_high")},
        "trials": (held_out.trials_n, ">=", settings.trials),
        "held_out_starts_seen": (seen_n, "==", 0),
        "inference_hz": (inference_hz, ">", settings.inference_hz_min),
    }
    return worded("deploy", rows, trials_n=held_out.trials_n)


def recorded_task(recorded: Path) -> str:
    """Return the task of a recording: what policies are trained on."""
    return yaml.safe_load((recorded / CONFIG_FILE).read_text("utf-8"))["task"]


def run(context: StageContext) -> StageResult:
    """Run every trained policy on held-out and training starts; film one success and one failure."""
    config = context.config
    trained = context.upstream["train-act"]
    checkpoints = [trained / "checkpoint", *sorted(trained.glob("seed-*/checkpoint"))]
    watch = watch_trials(context.view)
    recorded = context.upstream["teleop-record"]
    check_able(METHOD, [make_task(config)], recorded_task(recorded))
    episodes = episode_paths(recorded / "episodes")
    starts, seen_n = deploy_starts(
        config,
        context.seed,
        [read_meta(path).trial for path in episodes],
    )
    sets = {name: (CLEAN, trials) for name, trials in starts.items()}
    for name in config.deploy.conditions:
        task = make_task(config)
        widen = CONDITIONS[name].widen
        sets[name] = (
            name,
            [task.trial(context.seed, HELD_OUT, t.index, widen=widen) for t in starts["held_out"]],
        )
    sets.setdefault(HIDDEN, (HIDDEN, farthest(starts["held_out"], config.deploy.hidden_trials)))
    inputs = [MethodInputs(config, context.seed, checkpoint) for checkpoint in checkpoints]
    results: dict[str, list[TrialMetrics]] = {name: [] for name in sets}
    with context.progress.task(
        "policy trials",
        len(checkpoints) * sum(len(t) for _, t in sets.values()),
    ) as bar:
        for k, given in enumerate(inputs):
            for name, (under, trials) in sets.items():
                for result in run_trials(
                    METHOD,
                    given,
                    trials,
                    workers=context.workers,
                    condition=under,
                    watch=watch,
                ):
                    # The tables list the undisturbed sets as conditions, too, and count on from policy to policy.
                    index = k * (1 + max(t.index for t in trials)) + result.index
                    results[name].append(replace(result, condition=name, index=index))
                    bar.advance(
                        note=f"{name} {sum(r.success for r in results[name])}/{len(results[name])}",
                    )
    write_csv(
        context.folder / "trials.csv",
        [r.to_row() for rows in results.values() for r in rows],
    )
    rng = stream(context.seed, "bootstrap/deploy")
    summaries = {name: summarise(rows, rng) for name, rows in results.items() if rows}
    film_outcomes(context, inputs, starts["held_out"], results["held_out"])
    inference_hz = min(measure_inference(checkpoint, context) for checkpoint in checkpoints)
    checks = deploy_checks(summaries["held_out"], seen_n, inference_hz, config.deploy)
    data: dict[str, Any] = {}
    for name, summary in summaries.items():
        record = summary.record()
        rates = seed_rates(results[name], len(checkpoints))
        if len(rates) > 1:
            record["by_seed"] = rates
        checks += set_checks(name, summary, rates, config.deploy)
        data |= record if name == "held_out" else {name: record}
    checks += _looks(context, checkpoints[0], starts["held_out"][0])
    clear_m = make_task(config).scene.task.clear_height_m
    undisturbed = [r for name in starts for r in results[name]]
    if errors := [r.goal_error_m for r in undisturbed if r.measured.get("rise_m", 0.0) > clear_m]:
        checks += worded("deploy", {"goal_error_median_m": float(np.median(errors))})
    return StageResult(checks=checks, data=data)


def farthest(trials: Sequence[Trial], n: int) -> list[Trial]:
    """Return the `n` trials whose objects start farthest from the middle of all.

    A policy that goes to the middle without looking succeeds where the object lies near it: in 13 of 100 trials.
    """
    xy = np.array([[placement(start)[:2] for start in trial.start.values()] for trial in trials])
    off_m = np.linalg.norm(xy - xy.mean(axis=0), axis=2).sum(axis=1)
    return [trials[k] for k in np.argsort(-off_m, kind="stable")[:n]]


def set_checks(
    name: str,
    summary: MethodSummary,
    rates: Sequence[float],
    settings: DeployConfig,
) -> list[Check]:
    """Return the checks of a set of trials with the rate of each training seed."""
    rows: dict[str, Any] = {}
    if name == HIDDEN:
        return worded(
            "deploy",
            {"hidden_success_rate": (summary["success_rate"], "<=", settings.hidden_rate_max)},
        )
    if name != "held_out":
        rows |= {
            "success_rate": (summary["success_rate"], ">=", settings.condition_rate_min.get(name)),
        }
    if len(rates) > 1:
        rows |= {"worst_seed": min(rates), "median_seed": float(np.median(rates))}
    return worded(
        "deploy-set",
        rows,
        f"{name.replace(' ', '_')}_",
        set=name,
        interval=summary.interval,
    )


def seed_rates(results: Sequence[TrialMetrics], seeds_n: int) -> list[float]:
    """Return the success rate of each training seed, from equally many results in order."""
    return np.reshape([result.success for result in results], (seeds_n, -1)).mean(axis=1).tolist()


def film_outcomes(
    context: StageContext,
    inputs: Sequence[MethodInputs],
    trials: Sequence[Trial],
    results: Sequence[TrialMetrics],
) -> None:
    """Film a success and a failure; `results` of each of `inputs` in turn."""
    for label, wanted in (("success", True), ("failure", False)):
        if (
            found := next((i for i, r in enumerate(results) if r.success is wanted), None)
        ) is not None:
            k, index = divmod(found, len(trials))
            filmed = film_trial(METHOD, inputs[k], trials[index], context.folder / f"{label}.mp4")
            who = f", seed {k + 1}" if k else ""
            context.progress.note(f"{label}.mp4 shows trial {index}{who}: {filmed.text}")


def _looks(context: StageContext, checkpoint: Path, trial: Trial) -> list[Check]:
    config = context.config
    bench = Bench(METHOD, MethodInputs(config, context.seed, checkpoint))
    runtime = load_runtime(checkpoint, config.deploy, bench.world.robot)
    world = bench.world
    world.reset(poses=trial.start)
    state = np.concatenate([world.q, world.gripper])
    hidden = CONDITIONS[HIDDEN]
    rng = stream(context.seed, "deploy/looks")
    maps = dict[str, tuple[Image, Array]]()
    shares = list[float]()
    with Camera.recorded(world.model, config.scene.camera) as camera:
        pictures = {name: camera.picture(world.data, name) for name in runtime.cameras}
        with hidden.applied(world.model, bench.task, trial, rng):
            without = {name: camera.picture(world.data, name) for name in runtime.cameras}
    for name, picture in pictures.items():

        def targets(image: Image, name: str = name) -> Array:
            runtime.reset()
            return runtime.predict_chunk({**pictures, name: image}, state)[:, : runtime.joints_n]

        changes = occlusion(targets, picture)
        maps[name] = picture, changes
        shares.append(on_object(changes, picture, without[name]))
    draw_occlusion(maps, context.folder / "occlusion.png")
    return worded("deploy", {"looks_at_object": max(shares)})


def measure_inference(checkpoint: Path, context: StageContext) -> float:
    """Return inferences per second of the runtime, run alone."""
    robot = robot_from(context.config.robot)
    runtime = load_runtime(checkpoint, context.config.deploy, robot)
    rng = stream(context.seed, "deploy/inference")
    state = np.concatenate([robot.home, np.ones(2)])
    for _ in range(_INFERENCES_N):
        pictures = {
            c: rng.integers(0, 255, (*size, 3), dtype=np.uint8)
            for c, size in runtime.cameras.items()
        }
        runtime.predict_chunk(pictures, state)
    return runtime.inference_hz
