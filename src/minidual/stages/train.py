"""`minidual train METHOD`: train the policy of any method that has a trainer, without a gate."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from minidual.config.seeds import subseed
from minidual.durable import write_csv, write_text
from minidual.errors import UsageError
from minidual.gate.stage import ToolContext, ToolResult, aligned
from minidual.show.figures.film import film_trial
from minidual.show.figures.training import draw_curve
from minidual.stages.checkpoint_choice import DEMONSTRATED
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Task
from minidual.trials.benchmark import draw_under
from minidual.trials.conditions import CLEAN, condition
from minidual.trials.methods import METHODS, MethodInputs, TrainedPolicy
from minidual.trials.runner import run_trials
from minidual.trials.statistics import wilson_interval
from minidual.trials.trainer import Trainer, TrainingJob, TrainingSummary

PURPOSE = "train-test"
"""Random stream of the starts on which a policy is tried after its training."""
RECORD = "training.json"
CURVE = "curve.csv"
FIGURE = "curve.svg"
FILM = "trial.mp4"
_TRIALS = 20
_TRIALS_MAX = 10_000
_SEEDS_MAX = 10


class Measured(NamedTuple):
    """Success on starts that no training used."""

    condition: str
    successes: int
    trials: int

    @property
    def text(self) -> str:
        """For people."""
        low, high = wilson_interval(self.successes, self.trials)
        interval = f"{100 * low:.0f} to {100 * high:.0f} %"
        return f"{self.successes} of {self.trials} ({interval})"


def train(context: ToolContext) -> ToolResult:
    """Train a method's policy on a task, and try it on fresh starts.

    Raises:
        UsageError: The method learns nothing, or a number is wrong.
    """
    options = context.options
    method = str(options["method"])
    trainer = _trainer(method)
    task = make_task(context.config)
    trainer.check(task.config)
    seeds_n = _number("seeds", options.get("seeds", 1), 1, _SEEDS_MAX)
    trials_n = _number("trials", options.get("trials", _TRIALS), 0, _TRIALS_MAX)
    conditions = _conditions(method, options.get("conditions", CLEAN), task)
    own = replace(context, name=f"train/{method}/{task.name}")
    own.begin()
    records: list[dict[str, Any]] = []
    for k in range(seeds_n):
        folder = own.output if k == 0 else own.output / f"seed-{k + 1}"
        folder.mkdir(exist_ok=True)
        records.append(_trained(own, trainer, task, k, folder))
        measured = [_tried(own, method, task, folder, name, trials_n) for name in conditions]
        records[-1]["success"] = {
            row.condition: {"successes": row.successes, "trials": row.trials} for row in measured
        }
        write_text(folder / RECORD, json.dumps(records[-1], indent=2) + "\n")
    if options.get("video"):
        _film(own, method, task)
    own.publish()
    lines = [*aligned([_row(record) for record in records]), "", *_next_commands(own, method, task)]
    title = METHODS[method].title(task.name)
    if title:
        lines = [title, "", *lines]
    return ToolResult(lines, [f"policy: {own.folder / 'checkpoint'}"], {"trainings": records})


def _trainer(method: str) -> Trainer:
    spec = METHODS[method]
    if spec.trainer is not None:
        return spec.trainer.load()
    trained = [name for name, row in METHODS.items() if row.trainer is not None]
    raise UsageError(
        f"the method '{method}' learns nothing; "
        f"there are {', '.join([DEMONSTRATED, *trained])} to train",
    )


def _number(option: str, value: Any, low: int, high: int) -> int:
    if not low <= int(value) <= high:
        raise UsageError(f"--{option} is {value}; {low} <= value <= {high}")
    return int(value)


def _conditions(method: str, typed: str, task: Task) -> list[str]:
    names = [condition(name.strip()).name for name in typed.split(",") if name.strip()]
    for name in names:
        reason = condition(name).why_not(method, task.config)
        if reason:
            raise UsageError(f"{method} has no trials under '{name}': {reason}")
    return names


def _trained(
    context: ToolContext,
    trainer: Trainer,
    task: Task,
    k: int,
    folder: Path,
) -> dict[str, Any]:
    """Run the k-th training; write its curve; return its record."""
    seed = context.seed if k == 0 else subseed(context.seed, "train.seeds", k)
    place = context.folder.with_name(f"{task.name}.progress-{k + 1}")
    label = f"training, seed {k + 1}" if k else "training"
    with context.progress.task(label, trainer.steps(task.config)) as bar:

        def advance(steps: int, note: str) -> None:
            bar.advance(steps, note)

        summary = trainer.train(TrainingJob(task.config, seed, folder, place, advance))
    if summary.resumed_from:
        context.progress.note(f"went on from step {summary.resumed_from}")
    _write_curve(summary, folder)
    return {
        "task": task.name,
        "seed": seed,
        "resumed_from": summary.resumed_from,
        **{name: _json_number(value) for name, value in summary.numbers.items()},
    }


def _write_curve(summary: TrainingSummary, folder: Path) -> None:
    if not summary.curve:
        return
    names = list(dict.fromkeys(name for row in summary.curve for name in row))
    rows = [{name: row.get(name, math.nan) for name in names} for row in summary.curve]
    write_csv(folder / CURVE, rows, missing="")
    draw_curve(rows, summary.curve_of, folder / FIGURE)


def _json_number(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _tried(
    context: ToolContext,
    method: str,
    task: Task,
    folder: Path,
    name: str,
    trials_n: int,
) -> Measured:
    """Run the policy on fresh starts, in the loop that every method is measured in."""
    inputs = MethodInputs(task.config, context.seed, folder / "checkpoint", task.name)
    draw = draw_under(inputs, name, PURPOSE)
    trials = [draw(index) for index in range(trials_n)]
    successes_n = 0
    with context.progress.task(f"trials, {name}", trials_n) as bar:
        for result in run_trials(
            method,
            inputs,
            trials,
            workers=context.workers,
            condition=name,
        ):
            successes_n += result.success
            bar.advance(note=f"{successes_n} succeeded")
    return Measured(name, successes_n, trials_n)


def _film(context: ToolContext, method: str, task: Task) -> None:
    policies = {method: TrainedPolicy(context.output / "checkpoint", task.name)}
    inputs = MethodInputs(task.config, context.seed, policies=policies)
    trial = draw_under(inputs, CLEAN, PURPOSE)(0)
    result = film_trial(method, inputs, trial, context.output / FILM)
    context.progress.note(f"{FILM} shows start {trial.index}: {result.text}")


def _row(record: Mapping[str, Any]) -> dict[str, str]:
    row = {
        "seed": str(record["seed"]),
        "steps": str(record.get("steps", "")),
        "processor": f"{record.get('processor_s', 0.0) / 60.0:.1f} min",
    }
    for name, success in record["success"].items():
        if success["trials"]:
            row[name] = Measured(name, success["successes"], success["trials"]).text
    return row


def _next_commands(context: ToolContext, method: str, task: Task) -> Sequence[str]:
    tries = context.command(f"try {task.name} --method moveit,impedance,{method}")
    return ["Next:", f"  {tries}    compare it"]
