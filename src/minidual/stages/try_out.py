"""`minidual try`: trials of any method on any task, without gate and verdict."""

import math
from collections import Counter
from collections.abc import Sequence

from minidual.durable import write_csv
from minidual.errors import UsageError
from minidual.gate.stage import ToolContext, ToolResult, aligned
from minidual.plant.lifecycle import Connection
from minidual.show.figures.side_by_side import Take, film_takes, take
from minidual.show.report.sentences import sentence
from minidual.show.report.words import Words
from minidual.show.watch import watch_trials
from minidual.stages.checkpoint_choice import chosen_policies, require_policies
from minidual.stages.try_plant import check_placed, drive_unscored, opened, site_of
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Trial
from minidual.trials.answers import answer, medians
from minidual.trials.benchmark import TRY, draw_under
from minidual.trials.conditions import CLEAN, condition
from minidual.trials.methods import METHODS, MethodInputs, check_able, shown_as
from minidual.trials.metrics import TrialMetrics
from minidual.trials.runner import run_trials
from minidual.trials.site import Site

_TRIALS = 5
_TRIALS_MAX = 10_000
_METHODS = "moveit,impedance"


def try_out(context: ToolContext) -> ToolResult:
    """Run trials; print a table, and for two methods which is better.

    Raises:
        UsageError: A name or number is wrong, or a method cannot do the task.
    """
    options = context.options
    methods = METHODS.names(tuple(str(options.get("method", _METHODS)).split(",")))
    name = condition(options.get("condition", CLEAN)).name
    indices = _indices(options.get("trials", _TRIALS), options.get("first", 0))
    task = make_task(context.config)
    policies = chosen_policies(context, methods, task.name)
    require_policies(policies, methods, task.name)
    inputs = MethodInputs(task.config, context.seed, policies=policies)
    for method in methods:
        check_able(method, [task], "")
        reason = condition(name).why_not(method, inputs.config)
        if reason:
            raise UsageError(f"{method} has no trials under '{name}': {reason}")
    draw = draw_under(inputs, name, TRY)
    trials = [draw(index) for index in indices]
    with opened(task.config, name) as link:
        if link is not None and link.twin() is None:
            return _unscored(context, link, methods, inputs, trials)
        site = site_of(link, methods, task.config, context.seed)
        results = _run(context, methods, inputs, name, trials, site)
        takes = _takes(context, methods, inputs, name, trials[0], site)
    rows = [trial.to_row() for trial in results]
    write_csv(context.output / "trials.csv", rows, missing="does not apply")
    lines = [*aligned([_row(method, task.name, results) for method in methods]), ""]
    lines += _failures(results)
    answers = _answers(task.name, methods, results, context.seed)
    lines += answers
    film = ""
    if takes:
        file = f"{task.name}.mp4"
        film_takes(takes, context.output / file)
        film = str(context.folder / file)
        lines += ["", film]
    data = {
        "task": task.name,
        "condition": name,
        "plant": context.config.plant.address,
        "trials": rows,
        "answers": answers,
        "film": film,
    }
    return ToolResult(lines, ["trials of `try` count for no verdict"], data)


def _indices(trials_n: int, first: int) -> range:
    if not 1 <= trials_n <= _TRIALS_MAX:
        raise UsageError(f"--trials is {trials_n}; 1 <= value <= {_TRIALS_MAX}")
    if first < 0:
        raise UsageError(f"--first is {first}; it must be 0 or more")
    return range(first, first + trials_n)


def _run(
    context: ToolContext,
    methods: Sequence[str],
    inputs: MethodInputs,
    name: str,
    trials: Sequence[Trial],
    site: Site | None,
) -> list[TrialMetrics]:
    results: list[TrialMetrics] = []
    watch = watch_trials(context.view)
    with context.progress.task("trials", len(methods) * len(trials)) as progress:
        for method in methods:
            for result in run_trials(
                method,
                inputs,
                trials,
                workers=context.workers,
                condition=name,
                watch=watch,
                site=site,
            ):
                results.append(result)
                progress.advance(note=f"{method}, start {result.index}")
    return results


def _row(method: str, task: str, results: Sequence[TrialMetrics]) -> dict[str, str]:
    """Return a method's row of the table; medians are over successful trials."""
    trials = [trial for trial in results if trial.method == method]
    successes_n = sum(trial.success for trial in trials)
    return {
        "method": shown_as(method, task),
        "success": f"{successes_n} of {len(trials)}",
        "time [s]": _number(medians(trials, "duration_s"), 2),
        "tilt [deg]": _number(math.degrees(medians(trials, "tilt_max_rad")), 2),
        "torque [%]": _number(100.0 * medians(trials, "torque_ratio_max"), 0),
        "jerk [rad/s^3]": _number(medians(trials, "jerk_rms"), 1),
    }


def _number(value: float, digits: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def _failures(results: Sequence[TrialMetrics]) -> list[str]:
    """Return a line for each way of failing, with one of its starts."""
    counts = Counter((trial.method, trial.failure) for trial in results if not trial.success)
    lines: list[str] = []
    for (method, failure), count in counts.items():
        example = next(
            trial for trial in results if (trial.method, trial.failure) == (method, failure)
        )
        trials_n = sum(trial.method == method for trial in results)
        fails = f"{method} fails {count} of {trials_n}"
        lines.append(f"{fails}: {example.text} (start {example.index})")
    return [*lines, ""] if lines else []


def _answers(
    task: str,
    methods: Sequence[str],
    results: Sequence[TrialMetrics],
    seed: int,
) -> list[str]:
    """Return a sentence for each pair of methods."""
    sentences: list[str] = []
    for place, first in enumerate(methods):
        for second in methods[place + 1 :]:
            pair = [trial for trial in results if trial.method in (first, second)]
            sentences.append(sentence(answer(task, pair, seed), Words("en")))
    return sentences


def _takes(
    context: ToolContext,
    methods: Sequence[str],
    inputs: MethodInputs,
    name: str,
    trial: Trial,
    site: Site | None,
) -> list[Take]:
    """Run the first start of all methods again for a film, if one was asked for."""
    takes: list[Take] = []
    if not context.options.get("video"):
        return takes
    for method in methods:
        context.progress.note(f"filming {method}, start {trial.index}")
        takes.append(take(method, inputs, trial, condition=name, site=site))
    return takes


def _unscored(
    context: ToolContext,
    link: Connection,
    methods: Sequence[str],
    inputs: MethodInputs,
    trials: Sequence[Trial],
) -> ToolResult:
    """Drive one trial that only a person can judge, and print what to confirm."""
    task = make_task(inputs.config)
    placed_by = str(context.options.get("placed-by", ""))
    check_placed(placed_by, link, task, trials)
    if len(methods) > 1:
        raise UsageError("--method names several; a person judges one", remedy="--method moveit")
    trial = trials[0]
    driven = drive_unscored(link, methods[0], task, inputs, trial)
    lines = [f"{methods[0]}, start {trial.index} on {link.place}: {driven.ended}", "", "confirm:"]
    lines += [f"  {name}" for name in driven.confirm]
    data = {
        "task": task.name,
        "plant": link.address,
        "place": link.place,
        "placed_by": placed_by,
        "scored": False,
        "ended": driven.ended,
        "confirm": list(driven.confirm),
    }
    note = f"not scored: {link.address} gives no true poses; a person has to look"
    return ToolResult(lines, [note], data)
