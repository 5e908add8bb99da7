"""Tools of `minidual carry`: disturbed trials and tuning."""

import shlex

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
from minidual.trials.robustness import robustness
from minidual.trials.tuning import CARRIES_N, Tuner, TuningError, TuningStep, gains

PERTURB_TRIALS_N = 20
_OF_A_RUN = ("seed", "workers", "view")
"""What a tuned profile leaves to the run."""


def perturb(context: ToolContext) -> ToolResult:
    """Run the carry under every promised condition and compare with clean."""
    trials_n = int(context.options.get("trials", PERTURB_TRIALS_N))
    inputs = MethodInputs(task_config(context.config), context.seed)
    asked = (["impedance"], promised(trials_n), inputs)
    watch = watch_trials(context.view)
    with context.progress.task("disturbed carries", count_trials(*asked)) as task:

        def tell(result: TrialMetrics) -> None:
            task.advance(note=result.condition)

        cells, trials = run_benchmark(
            *asked,
            workers=context.workers,
            purpose=PERTURBED,
            on_trial=tell,
            watch=watch,
        )
    found = robustness(cells, trials, inputs.config.carry.limits.success_rate_min)
    measured = [r.row() for r in found]
    rows = [
        {**dict.fromkeys(measured[0], "-"), **row} for row in measured
    ]  # the first, undisturbed, has all columns
    write_csv(context.output / "conditions.csv", rows)
    write_csv(context.output / "trials.csv", [t.to_row() for t in trials])
    failed = [r for r in found if not r.holds]
    notes = [
        f"{r.cell.condition}: {r.row()['successes']}, limit {100 * r.rate_min:.0f} %: {r.example}"
        for r in failed
    ]
    data = {"trials_n": trials_n, "success_rate_min": DISTURBED_RATE_MIN, "conditions": rows}
    code = ExitCode.ACCEPTANCE_FAILED if failed else ExitCode.PASS
    return ToolResult(markdown(rows), [*notes, f"written to {context.folder}"], data, code)


def tune(context: ToolContext) -> ToolResult:
    """Tune squeeze and stiffness by carrying; write a profile."""
    config = task_config(context.config)
    with context.progress.task("tuning") as task:

        def tell(step: TuningStep) -> None:
            task.advance(
                note=f"{step.phase}: {step.force_n:.1f} N, {step.stiffness_n_per_m:.0f} N/m",
            )

        tuner = Tuner(config, context.seed, workers=context.workers, on_step=tell)
        try:
            tuning = tuner.run()
        except TuningError:
            write_csv(context.output / "tuning.csv", [s.row() for s in tuner.steps])
            context.publish()  # what was tried is what tells why nothing was found
            raise
    # With all settings given, for which the gains hold. What was not set stays so: an object brings its own values.
    base = load_config(context.shipped).config if context.shipped else Config()
    own, shipped = (c.model_dump(mode="json", exclude_unset=True) for c in (context.config, base))
    given = {
        name: own[name] for name in own if name not in _OF_A_RUN and own[name] != shipped.get(name)
    }
    carry = {**given.get("carry", {}), "object": config.carry.object, "motion": config.carry.motion}
    found = gains(tuning.force_n, tuning.stiffness_n_per_m)
    carry["impedance"] = {**carry.get("impedance", {}), **found}
    profile = {**({"extends": context.shipped} if context.shipped else {}), **given, "carry": carry}
    head = (
        f"# Found by `minidual carry --tune`, seed {context.seed}: {tuning.least_force_n:.1f} N is the least squeeze that\n"
        f"# held {CARRIES_N} of {CARRIES_N} carries; see tuning.csv and tuning.png beside this file.\n"
    )
    write_text(context.output / "tuned.yaml", head + yaml.safe_dump(profile, sort_keys=False))
    steps = [s.row() for s in tuning.steps]
    write_csv(context.output / "tuning.csv", steps)
    draw_tuning(tuning, config.scene.task.internal_force_min_n, context.output / "tuning.png")
    rows = [row for row in steps if row["phase"] in ("final", "compared")]
    notes = [
        f"least squeeze that holds: {tuning.least_force_n:.1f} N",
        f"chosen: {tuning.force_n:.1f} N and {tuning.stiffness_n_per_m:.0f} N/m",
        f"use it: {context.command('run --until carry')} --profile {shlex.quote(str(context.folder / 'tuned.yaml'))}",
    ]
    settings = {f"carry.impedance.{name}": value for name, value in found.items()}
    data = {"settings": settings, "least_force_n": tuning.least_force_n, "steps": steps}
    return ToolResult(lines=markdown(rows), notes=notes, data=data)
