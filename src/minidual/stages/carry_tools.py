"""Tools of `minidual carry`: disturbed trials and tuning."""

import shlex
from typing import Any

import yaml

from minidual.config.loader import load_config
from minidual.config.root import Config
from minidual.durable import write_csv, write_text
from minidual.errors import ExitCode
from minidual.gate.stage import ToolContext, ToolResult, markdown
from minidual.show.figures.tuning import draw_tuning
from minidual.show.watch import watch_trials
from minidual.tasks.catalogue import task_config
from minidual.trials.benchmark import (
    DISTURBED_RATE_MIN,
    PERTURBED,
    count_trials,
    promised,
    run_benchmark,
)
from minidual.trials.methods import MethodInputs
from minidual.trials.metrics import TrialMetrics
from minidual.trials.robustness import Robustness, robustness
from minidual.trials.tuning import CARRIES_N, Tuner, Tuning, TuningError, TuningStep, gains

PERTURB_TRIALS_N = 20
_METHODS = ["impedance"]
_OF_A_RUN = ("seed", "workers", "view")
"""Settings that a tuned profile leaves to the run."""


def perturb(context: ToolContext) -> ToolResult:
    """Run the carry under every promised condition and compare with clean."""
    trials_n = int(context.options.get("trials", PERTURB_TRIALS_N))
    conditions = promised(trials_n)
    inputs = MethodInputs(task_config(context.config), context.seed)
    watch = watch_trials(context.view)
    count = count_trials(_METHODS, conditions, inputs)
    with context.progress.task("disturbed carries", count) as task:

        def advance(result: TrialMetrics) -> None:
            task.advance(note=result.condition)

        cells, trials = run_benchmark(
            _METHODS,
            conditions,
            inputs,
            workers=context.workers,
            purpose=PERTURBED,
            on_trial=advance,
            watch=watch,
        )
    results = robustness(cells, trials, inputs.config.carry.limits.success_rate_min)
    rows = _condition_rows(results)
    write_csv(context.output / "conditions.csv", rows)
    write_csv(context.output / "trials.csv", [t.to_row() for t in trials])
    failed = [result for result in results if not result.holds]
    notes = [
        f"{r.cell.condition}: {r.row()['successes']}, limit {100 * r.rate_min:.0f} %: {r.example}"
        for r in failed
    ]
    notes.append(f"written to {context.folder}")
    data = {"trials_n": trials_n, "success_rate_min": DISTURBED_RATE_MIN, "conditions": rows}
    code = ExitCode.ACCEPTANCE_FAILED if failed else ExitCode.PASS
    return ToolResult(markdown(rows), notes, data, code)


def _condition_rows(results: list[Robustness]) -> list[dict[str, Any]]:
    """Return a row of each condition; "-" where it does not apply."""
    rows = [result.row() for result in results]
    columns = rows[0]  # of the undisturbed trials, which have all columns
    return [dict.fromkeys(columns, "-") | row for row in rows]


def tune(context: ToolContext) -> ToolResult:
    """Tune squeeze and stiffness by carrying; write a profile."""
    config = task_config(context.config)
    tuning = _run_tuner(context, config)
    settings = gains(tuning.force_n, tuning.stiffness_n_per_m)
    head = (
        f"# Found by `minidual carry --tune`, seed {context.seed}: "
        f"{tuning.least_force_n:.1f} N is the least squeeze that\n"
        f"# held {CARRIES_N} of {CARRIES_N} carries; "
        "see tuning.csv and tuning.svg beside this file.\n"
    )
    profile = _tuned_profile(context, config, settings)
    write_text(context.output / "tuned.yaml", head + yaml.safe_dump(profile, sort_keys=False))
    steps = [step.row() for step in tuning.steps]
    write_csv(context.output / "tuning.csv", steps)
    draw_tuning(tuning, config.scene.task.internal_force_min_n, context.output / "tuning.svg")
    final_rows = [row for row in steps if row["phase"] in ("final", "compared")]
    command = context.command("run --until carry")
    path = shlex.quote(str(context.folder / "tuned.yaml"))
    notes = [
        f"least squeeze that holds: {tuning.least_force_n:.1f} N",
        f"chosen: {tuning.force_n:.1f} N and {tuning.stiffness_n_per_m:.0f} N/m",
        f"use it: {command} --profile {path}",
    ]
    data = {
        "settings": {f"carry.impedance.{name}": value for name, value in settings.items()},
        "least_force_n": tuning.least_force_n,
        "steps": steps,
    }
    return ToolResult(lines=markdown(final_rows), notes=notes, data=data)


def _run_tuner(context: ToolContext, config: Config) -> Tuning:
    """Tune; if nothing holds, publish the steps that were tried, and raise TuningError."""
    with context.progress.task("tuning") as task:

        def advance(step: TuningStep) -> None:
            gains_text = f"{step.force_n:.1f} N, {step.stiffness_n_per_m:.0f} N/m"
            task.advance(note=f"{step.phase}: {gains_text}")

        tuner = Tuner(config, context.seed, workers=context.workers, on_step=advance)
        try:
            return tuner.run()
        except TuningError:
            write_csv(context.output / "tuning.csv", [step.row() for step in tuner.steps])
            context.publish()
            raise


def _tuned_profile(
    context: ToolContext,
    config: Config,
    settings: dict[str, float],
) -> dict[str, Any]:
    """Return a profile: the settings that were typed, for which the gains hold, and the gains.

    Settings that were not typed stay out, so that another object still brings its own values.
    """
    shipped = load_config(context.shipped).config if context.shipped else Config()
    shipped_values = shipped.model_dump(mode="json", exclude_unset=True)
    own_values = context.config.model_dump(mode="json", exclude_unset=True)
    typed = {
        name: value
        for name, value in own_values.items()
        if name not in _OF_A_RUN and value != shipped_values.get(name)
    }
    carry = dict(typed.get("carry", {}))
    carry["object"] = config.carry.object
    carry["motion"] = config.carry.motion
    carry["impedance"] = carry.get("impedance", {}) | settings
    profile: dict[str, Any] = {"extends": context.shipped} if context.shipped else {}
    return profile | typed | {"carry": carry}
