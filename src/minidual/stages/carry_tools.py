"""Tools of `minidual carry`: disturbed trials and tuning."""

from __future__ import annotations

from typing import Any

import yaml

from minidual.config.root import Config
from minidual.errors import ExitCode
from minidual.gate.tool import ToolContext, ToolResult
from minidual.show.figures.tuning import draw_tuning
from minidual.show.watch import watch_trials
from minidual.tasks.task import task_config
from minidual.trials.benchmark import count_trials
from minidual.trials.methods import MethodInputs
from minidual.trials.perturbation import DROP_MAX, run_perturbations, touching
from minidual.trials.tables import markdown, write_csv, write_rows, write_text
from minidual.trials.tuning import CARRIES_N, Tuner, TuningError

PERTURB_TRIALS_N = 20


def perturb(context: ToolContext) -> ToolResult:
    """Run the carry under every condition and compare with clean."""
    trials_n = int(context.options.get("trials", PERTURB_TRIALS_N))
    inputs = MethodInputs(task_config(context.config), context.seed)
    asked = dict.fromkeys(touching("impedance"), trials_n)
    with context.progress.task("disturbed carries", count_trials(["impedance"], asked, inputs.config)) as task:
        found, trials = run_perturbations(
            "impedance",
            inputs,
            trials_n,
            workers=context.workers,
            on_trial=lambda result: task.advance(note=result.metrics.condition),
            watch=watch_trials(context.view),
        )
    rows = [r.row() for r in found]
    write_rows(context.output / "conditions.csv", rows)
    write_csv(context.output / "trials.csv", trials)
    failed = [r for r in found if r.fails]
    notes = [
        f"{r.name}: {s.successes_n} of {s.trials_n}, {100 * r.drop:.0f} points fewer than clean (limit "
        f"{100 * DROP_MAX:.0f}): {r.example}"
        for r in failed
        if (s := r.cell.summary) is not None
    ]
    return ToolResult(
        lines=markdown(rows),
        notes=[*notes, f"written to {context.folder}"],
        data={"trials_n": trials_n, "drop_max": DROP_MAX, "conditions": rows},
        exit_code=ExitCode.ACCEPTANCE_FAILED if failed else ExitCode.PASS,
    )


def tune(context: ToolContext) -> ToolResult:
    """Tune squeeze and stiffness by carrying; write a profile."""
    config = task_config(context.config)
    with context.progress.task("tuning") as task:
        tuner = Tuner(
            config,
            context.seed,
            workers=context.workers,
            on_step=lambda s: task.advance(note=f"{s.phase}: {s.force_n:.1f} N, {s.stiffness_n_per_m:.0f} N/m"),
        )
        try:
            tuning = tuner.run()
        except TuningError:
            write_rows(context.output / "tuning.csv", [s.row() for s in tuner.steps])
            context.publish()  # what was tried is what tells why nothing was found
            raise
    profile = {"extends": _base(context.profile), **_as_typed(context.config)}
    profile["carry"] |= {"object": config.carry.object, "motion": config.carry.motion}
    impedance = {path.rsplit(".", 1)[1]: value for path, value in tuning.settings.items()}
    profile["carry"]["impedance"] = {**profile["carry"].get("impedance", {}), **impedance}
    head = (
        f"# Found by `minidual carry --tune`, seed {context.seed}: {tuning.least_force_n:.1f} N is the least squeeze that\n"
        f"# held {CARRIES_N} of {CARRIES_N} carries; see tuning.csv and tuning.png beside this file.\n"
    )
    write_text(context.output / "tuned.yaml", head + yaml.safe_dump(profile, sort_keys=False))
    write_rows(context.output / "tuning.csv", [s.row() for s in tuning.steps])
    draw_tuning(tuning, config.scene.task.internal_force_min_n, context.output / "tuning.png")
    rows = [s.row() for s in (tuning.final, *tuning.compared)]
    return ToolResult(
        lines=markdown(rows),
        notes=[
            f"least squeeze that holds: {tuning.least_force_n:.1f} N",
            f"chosen: {tuning.force_n:.1f} N and {tuning.stiffness_n_per_m:.0f} N/m",
            f"use it: {context.command('carry')} --profile {context.folder / 'tuned.yaml'}",
        ],
        data={
            "settings": tuning.settings,
            "least_force_n": tuning.least_force_n,
            "steps": [s.row() for s in tuning.steps],
        },
    )


def _as_typed(config: Config) -> dict[str, Any]:
    """Return the scene and carry settings given, for which the gains hold."""
    sections = {name: getattr(config, name).model_dump(mode="json", exclude_unset=True) for name in ("scene", "carry")}
    return {"carry": {}, **{name: values for name, values in sections.items() if values}}


def _base(profile: str) -> str:
    """Return the shipped profile that a tuned one extends."""
    return profile if profile in ("smoke", "standard", "gpu") else "standard"
