"""The block `tasks`: success of each method on each task, clean and `randomised`.

One task alone has a block of its own, such as `tasks-sort`.
"""

import re

from minidual.durable import read_json
from minidual.errors import UsageError
from minidual.tasks.catalogue import TASKS
from minidual.trials.methods import METHODS
from minidual.trials.statistics import mcnemar_p_value, wilson_interval
from scripts.results.blocks import blocks
from scripts.results.markdown import Origin, origin_line, table
from scripts.results.trials import CONDITIONS, Cell, Plan, StoredTrial, measured

NAME = "tasks"
_OWN_BLOCK = f"{NAME}-"
"""Begins the name of a block that holds one task: one that is measured with other starts or counts."""
_PAIR = ("moveit", "impedance")
"""Methods that are compared on shared starts."""
_LEAST_P = 0.0001
_STARTS = re.compile(r"Starts (?P<first>\d+) to (?P<last>\d+)")


def block_name(plan: Plan) -> str:
    """Return the block of a plan: a plan of one task has a block of its own."""
    if len(plan.tasks) == 1:
        return f"{_OWN_BLOCK}{plan.tasks[0]}"
    return NAME


def block(plan: Plan) -> str | None:
    """Return the block; None while a trial of a cell is missing."""
    cells = {cell: measured(plan, cell) for cell in plan.cells}
    if any(len(trials) < plan.trials_n for trials in cells.values()):
        return None
    methods = [name for name in plan.methods if any(cell.method == name for cell in cells)]
    compares = set(_PAIR) <= set(methods)
    header = [""]
    header += [f"{_title(name, plan)} {condition}" for name in methods for condition in CONDITIONS]
    if compares:
        header += [f"only `{_PAIR[0]}`, only `{_PAIR[1]}` {CONDITIONS[-1]}"]
    rows: list[list[str]] = []
    for task in plan.tasks:
        row = [f"`{task}`"]
        for name in methods:
            for condition in CONDITIONS:
                row.append(rate_text(cells.get(Cell(task, name, condition), [])))
        if compares:
            pair = [cells[Cell(task, name, CONDITIONS[-1])] for name in _PAIR]
            row.append(pair_text(*pair))
        rows.append(row)
    origins = [trial.made for trials in cells.values() for trial in trials]
    last = plan.first + plan.trials_n - 1
    starts = f"Starts {plan.first} to {last}, successes of {plan.trials_n}."
    return f"{starts}\n{_line(origins, plan)}\n\n{table(header, rows)}"


def check_fresh(plan: Plan, published: str) -> None:
    """Raise UsageError if the starts stand in the published pages, and none is measured here.

    Starts that a publication showed have been seen. What is measured here already may be
    continued and published again.
    """
    if any(measured(plan, cell) for cell in plan.cells):
        return
    for name, content in blocks(published).items():
        if name != NAME and not name.startswith(_OWN_BLOCK):
            continue
        match = _STARTS.search(content)
        if match is None:
            continue
        first = int(match["first"])
        last = int(match["last"])
        if plan.first <= last and first < plan.first + plan.trials_n:
            raise UsageError(
                f"starts {first} to {last} are published already",
                remedy=f"--first {last + 1}",
            )


def _title(method: str, plan: Plan) -> str:
    """Return a method's name; of one that drives a policy, with those of the networks."""
    if not METHODS[method].learned:
        return f"`{method}`"
    records = [read_json(path.parent / "train.json") for path in plan.policies.values()]
    networks = dict.fromkeys(f"`{record['architecture']}`" for record in records)
    return f"`{method}` ({', '.join(networks)})"


def _line(origins: list[Origin], plan: Plan) -> str:
    words = f"--only {NAME} --first {plan.first} --trials {plan.trials_n}"
    if plan.tasks != tuple(TASKS):
        words += f" --tasks {','.join(plan.tasks)}"
    for checkpoint in plan.policies.values():
        words += f" --policy {checkpoint.parents[1]}"
    return origin_line(origins, f'make results ARGS="{words}"')


def rate_text(trials: list[StoredTrial]) -> str:
    """Return successes and their 95 % Wilson interval; nothing without trials."""
    if not trials:
        return ""
    successes_n = sum(trial.success for trial in trials)
    low, high = wilson_interval(successes_n, len(trials))
    return f"{successes_n} ({100 * low:.0f}-{100 * high:.0f} %)"


def pair_text(first: list[StoredTrial], second: list[StoredTrial]) -> str:
    """Return on how many shared starts only one of two succeeds, and McNemar's exact p."""
    of_second = {trial.index: trial.success for trial in second}
    only_first_n = sum(trial.success and not of_second[trial.index] for trial in first)
    only_second_n = sum(of_second[trial.index] and not trial.success for trial in first)
    p = mcnemar_p_value(only_first_n, only_second_n)
    p_text = f"p < {_LEAST_P}" if p < _LEAST_P else f"p = {p:.2g}"
    return f"{only_first_n}, {only_second_n} ({p_text})"
