"""`minidual deploy`: the trained policy on held-out starts."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from minidual.config.root import Config
from minidual.config.seeds import stream
from minidual.demos.episode import episode_paths, read_meta
from minidual.demos.rig import PURPOSE as TRAINING
from minidual.durable import write_csv
from minidual.gate.check import Check
from minidual.gate.stage import StageContext, StageResult
from minidual.plant.render import Camera, Image
from minidual.policies.occlusion import occlusion, on_object
from minidual.policies.pilot import load_runtime
from minidual.policies.policy import PolicyRuntime
from minidual.robot.pair import Array, robot_from
from minidual.show.figures.canvas import draw_occlusion
from minidual.show.figures.film import film_trial
from minidual.show.watch import watch_trials
from minidual.stages.checkpoint_choice import policy_place, recorded_task
from minidual.stages.deploy_checks import (
    GOAL_ERROR_MEDIAN,
    HELD_OUT_SET,
    HIDDEN,
    LOOKS_AT_OBJECT,
    TRAINING_SET,
    InferenceRates,
    deploy_checks,
    seed_rates,
    set_checks,
    table_checks,
)
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Task, Trial, placement
from minidual.trials.conditions import CLEAN, CONDITIONS
from minidual.trials.methods import MethodInputs, check_able
from minidual.trials.metrics import TrialMetrics, summarise
from minidual.trials.runner import Bench, run_trials
from minidual.trials.trial_table import count_results

METHOD = "act"
HELD_OUT = "deploy"
"""Random stream of the held-out trials; `TRAINING` is that of the demonstrations."""
_INFERENCES_N = 60


class TrialSet(NamedTuple):
    """Trials that run under one condition."""

    condition: str
    trials: list[Trial]


class Starts(NamedTuple):
    """Trials of `deploy`.

    Attributes:
        held_out: From starts that are not in the demonstrations.
        training: From starts of demonstrations.
        seen_n: Held-out trials that a demonstration has drawn, too.
    """

    held_out: list[Trial]
    training: list[Trial]
    seen_n: int


def deploy_starts(config: Config, seed: int, demonstrated: Sequence[int]) -> Starts:
    """Return the trials; `demonstrated`: trial indices of the demonstrations."""
    task = make_task(config)
    settings = config.deploy
    held_out = [
        task.trial(seed, HELD_OUT, i)
        for i in range(settings.first_start, settings.first_start + settings.trials)
    ]
    training = [
        task.trial(seed, TRAINING, i, widen=config.teleop.widen)
        for i in demonstrated[: settings.training_trials]
    ]
    # Drawn as wide as the held-out trials, the demonstrations have the same numbers.
    drawn = [_poses(task.trial(seed, TRAINING, i)) for i in demonstrated]
    seen_n = sum(_poses(trial) in drawn for trial in held_out)
    return Starts(held_out, training, seen_n)


def _poses(trial: Trial) -> list[object]:
    return [np.asarray(pose).tolist() for pose in (*trial.start.values(), *trial.goal.values())]


def run(context: StageContext) -> StageResult:
    """Run every trained policy on every set of trials; film one success and one failure."""
    config = context.config
    checkpoints, demonstrated = _policies(context)
    starts = deploy_starts(config, context.seed, demonstrated)
    sets = _trial_sets(config, context.seed, starts)
    inputs = [MethodInputs(config, context.seed, checkpoint) for checkpoint in checkpoints]
    results = _run_sets(context, inputs, sets)
    asked_n = {name: len(inputs) * len(trials) for name, (_, trials) in sets.items()}
    asked_n[HELD_OUT_SET] = len(inputs) * config.deploy.trials
    table = write_table(context.folder / "trials.csv", results, asked_n)
    rng = stream(context.seed, "bootstrap/deploy")
    summaries = {
        name: summarise(set_results, rng) for name, set_results in results.items() if set_results
    }
    film_outcomes(context, inputs, starts.held_out, results[HELD_OUT_SET])
    slowest = min(measure_inference(checkpoint, context) for checkpoint in checkpoints)
    held_out = summaries[HELD_OUT_SET]
    checks = deploy_checks(held_out, starts.seen_n, slowest, config.deploy)
    checks += table
    data: dict[str, Any] = {}
    for name, summary in summaries.items():
        record = summary.record()
        rates = seed_rates(results[name], len(checkpoints))
        if len(rates) > 1:
            record["by_seed"] = rates
        checks += set_checks(name, summary, rates, config.deploy)
        data |= record if name == HELD_OUT_SET else {name: record}
    checks.append(_looks_check(context, checkpoints[0], starts.held_out[0]))
    undisturbed = [*results[HELD_OUT_SET], *results.get(TRAINING_SET, [])]
    checks += _goal_error_checks(make_task(config), undisturbed)
    return StageResult(checks=checks, data=data)


def _policies(context: StageContext) -> tuple[list[Path], list[int]]:
    """Return the checkpoints, and the trials of their demonstrations.

    Those of a policy that was named are not known: it has no trials from starts of its training.
    """
    config = context.config
    task = make_task(config)
    if config.deploy.policy:
        check_able(METHOD, [task])
        return [policy_place(config.deploy.policy, "deploy.policy")], []
    trained = context.upstream["train-act"]
    recorded = context.upstream["teleop-record"]
    check_able(METHOD, [task], recorded_task(recorded))
    demonstrated = [read_meta(path).trial for path in episode_paths(recorded / "episodes")]
    return [trained / "checkpoint", *sorted(trained.glob("seed-*/checkpoint"))], demonstrated


def _trial_sets(config: Config, seed: int, starts: Starts) -> dict[str, TrialSet]:
    """Return the sets of trials by name; sets under a condition repeat the held-out starts."""
    sets = {HELD_OUT_SET: TrialSet(CLEAN, starts.held_out)}
    if not config.deploy.policy:
        sets[TRAINING_SET] = TrialSet(CLEAN, starts.training)
    task = make_task(config)
    for name in config.deploy.conditions:
        widen = CONDITIONS[name].widen
        trials = [task.trial(seed, HELD_OUT, t.index, widen=widen) for t in starts.held_out]
        sets[name] = TrialSet(name, trials)
    if HIDDEN not in sets:
        hidden = farthest(starts.held_out, config.deploy.hidden_trials)
        sets[HIDDEN] = TrialSet(HIDDEN, hidden)
    return sets


def _run_sets(
    context: StageContext,
    inputs: Sequence[MethodInputs],
    sets: Mapping[str, TrialSet],
) -> dict[str, list[TrialMetrics]]:
    """Run every set with every policy; return the results of each set, policy after policy.

    The tables list the set as the condition, and count on from policy to policy.
    """
    watch = watch_trials(context.view)
    results: dict[str, list[TrialMetrics]] = {name: [] for name in sets}
    count = len(inputs) * sum(len(trials) for _, trials in sets.values())
    with context.progress.task("policy trials", count) as bar:
        for k, policy_inputs in enumerate(inputs):
            for name, (condition, trials) in sets.items():
                set_results = results[name]
                for result in run_trials(
                    METHOD,
                    policy_inputs,
                    trials,
                    workers=context.workers,
                    condition=condition,
                    watch=watch,
                ):
                    index = k * (1 + max(t.index for t in trials)) + result.index
                    set_results.append(replace(result, condition=name, index=index))
                    successes_n = sum(r.success for r in set_results)
                    bar.advance(note=f"{name} {successes_n}/{len(set_results)}")
    return results


def write_table(
    path: Path,
    results: Mapping[str, Sequence[TrialMetrics]],
    asked_n: Mapping[str, int],
) -> list[Check]:
    """Write the trials of all sets; return the checks of what the file holds then."""
    write_csv(path, [r.to_row() for set_results in results.values() for r in set_results])
    written = count_results(path)
    results_n = {series.condition: count for series, count in written.items()}
    return table_checks(results_n, asked_n)


def farthest(trials: Sequence[Trial], n: int) -> list[Trial]:
    """Return the `n` trials whose objects start farthest from the middle of all.

    A policy that goes to the middle without looking succeeds where the object lies near it: in 13
    of 100 trials.
    """
    xy = np.array([[placement(start)[:2] for start in trial.start.values()] for trial in trials])
    off_m = np.linalg.norm(xy - xy.mean(axis=0), axis=2).sum(axis=1)
    farthest_first = np.argsort(-off_m, kind="stable")
    return [trials[k] for k in farthest_first[:n]]


def film_outcomes(
    context: StageContext,
    inputs: Sequence[MethodInputs],
    trials: Sequence[Trial],
    results: Sequence[TrialMetrics],
) -> None:
    """Film a success and a failure; `results`: of all trials with each of `inputs` in turn."""
    for label, success in (("success", True), ("failure", False)):
        positions = [i for i, result in enumerate(results) if result.success is success]
        if not positions:
            continue
        k, index = divmod(positions[0], len(trials))
        filmed = film_trial(METHOD, inputs[k], trials[index], context.folder / f"{label}.mp4")
        seed_text = f", seed {k + 1}" if k else ""
        context.progress.note(f"{label}.mp4 shows trial {index}{seed_text}: {filmed.text}")


def _goal_error_checks(task: Task, results: Sequence[TrialMetrics]) -> list[Check]:
    """Return the median distance from the goal, if any trial lifted the object."""
    clear_m = task.scene.task.clear_height_m
    lifted = [r for r in results if r.measured.get("rise_m", 0.0) > clear_m]
    if not lifted:
        return []
    return [GOAL_ERROR_MEDIAN.report(float(np.median([r.goal_error_m for r in lifted])))]


def _looks_check(context: StageContext, checkpoint: Path, trial: Trial) -> Check:
    """Cover patches of each picture, and draw how far the joint targets change."""
    config = context.config
    bench = Bench(METHOD, MethodInputs(config, context.seed, checkpoint))
    runtime = load_runtime(
        checkpoint, config.deploy, bench.world.robot, instruction=bench.task.instruction
    )
    world = bench.world
    world.reset(poses=trial.start)
    state = runtime.with_usual_inputs(np.concatenate([world.q, world.gripper]))
    rng = stream(context.seed, "deploy/looks")
    with Camera.recorded(world.model, config.scene.camera) as camera:
        pictures = {name: camera.picture(world.data, name) for name in runtime.cameras}
        with CONDITIONS[HIDDEN].applied(world.model, bench.task, trial, rng):
            without = {name: camera.picture(world.data, name) for name in runtime.cameras}
    maps: dict[str, tuple[Image, Array]] = {}
    shares: list[float] = []
    for name, picture in pictures.items():
        changes = occlusion(_targets_of(runtime, pictures, name, state), picture)
        maps[name] = picture, changes
        shares.append(on_object(changes, picture, without[name]))
    draw_occlusion(maps, context.folder / "occlusion.png")
    return LOOKS_AT_OBJECT.report(max(shares))


def _targets_of(
    runtime: PolicyRuntime,
    pictures: Mapping[str, Image],
    name: str,
    state: Array,
) -> Callable[[Image], Array]:
    """Return the function from a picture of camera `name` to the joint targets of a chunk."""

    def targets(image: Image) -> Array:
        runtime.reset()
        chunk = runtime.predict_chunk({**pictures, name: image}, state)
        return chunk[:, : runtime.joints_n]

    return targets


def measure_inference(checkpoint: Path, context: StageContext) -> InferenceRates:
    """Return the rates of the runtime, run alone."""
    config = context.config
    robot = robot_from(config.robot)
    instruction = make_task(config).instruction
    runtime = load_runtime(checkpoint, config.deploy, robot, instruction=instruction)
    rng = stream(context.seed, "deploy/inference")
    state = runtime.with_usual_inputs(np.concatenate([robot.home, np.ones(2)]))
    for _ in range(_INFERENCES_N):
        pictures = {
            name: rng.integers(0, 255, (*size, 3), dtype=np.uint8)
            for name, size in runtime.cameras.items()
        }
        runtime.predict_chunk(pictures, state)
    return InferenceRates(runtime.inference_hz, runtime.inference_wall_hz)
