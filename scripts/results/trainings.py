"""The block `trainings`: policies of several seeds on held-out starts."""

from pathlib import Path
from typing import Any

from minidual.trials.statistics import wilson_interval
from scripts.results.markdown import origin_line, table
from scripts.results.verdicts import numbers_of

NAME = "trainings"
COMMAND = "make learn"
_SETS = ("held-out starts", "room")


def block(run: Path) -> str | None:
    """Return the block; None without a passing deploy of several policies."""
    deploy = numbers_of(run, "deploy")
    training = numbers_of(run, "train-act")
    if deploy is None or training is None or "by_seed" not in deploy.verdict.data:
        return None
    records = dict(zip(_SETS, (deploy.verdict.data, deploy.data("room")), strict=True))
    rows = [_row(name, record) for name, record in records.items()]
    seeds_n = len(deploy.data("by_seed"))
    first = deploy.setting("deploy", "first_start")
    header = [f"`{training.data('architecture')}`", *(f"seed {k + 1}" for k in range(seeds_n))]
    return (
        f"Starts from {first}.\n{origin_line([deploy.made, training.made], COMMAND)}\n\n"
        f"{table([*header, 'together'], rows)}"
    )


def _row(name: str, record: dict[str, Any]) -> list[str]:
    trials_n = record["trials"]
    low, high = wilson_interval(record["successes_n"], trials_n)
    each_n = trials_n // len(record["by_seed"])
    of_seeds = [f"{round(rate * each_n)} of {each_n}" for rate in record["by_seed"]]
    interval = f"{100 * low:.0f}-{100 * high:.0f} %"
    return [name, *of_seeds, f"{record['successes_n']} of {trials_n} ({interval})"]
