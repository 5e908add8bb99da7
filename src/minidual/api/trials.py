"""Trials of a method on a task, and their results."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from minidual.api.policies import checkpoint_of
from minidual.api.settings import Settings, configured
from minidual.config.root import Config
from minidual.durable import expanded, write_csv
from minidual.errors import UsageError
from minidual.policies.shipped import shipped_policy
from minidual.tasks.catalogue import make_task
from minidual.trials.benchmark import TRY, draw_under
from minidual.trials.conditions import CLEAN, condition
from minidual.trials.methods import METHODS, MethodInputs, check_able
from minidual.trials.metrics import TrialMetrics
from minidual.trials.runner import run_trials as run_all
from minidual.trials.statistics import wilson_interval

_TRIALS_MAX = 10_000


@dataclass(frozen=True, eq=False)
class Trials:
    """Trials of one method on one task under one condition; iterate over them for each result.

    A result has `index` (number of the start), `success`, `failure` and `reason` (the first
    condition of success that was violated), `duration_s`, `tilt_max_rad`, `torque_ratio_max`
    (largest |torque| / limit), `jerk_rms` [rad/s^3], `path_length_m`, `goal_error_m`,
    `internal_force_min_n` and more. A number that does not apply is NaN.

    Attributes:
        task, method, condition: Names.
        seed: With the number of a start, it tells what the start is.
        label: Name in comparisons.
        results: One for each trial, in order of the starts.
    """

    task: str
    method: str
    condition: str
    seed: int
    label: str
    results: Sequence[TrialMetrics] = field(repr=False)

    def __len__(self) -> int:
        return len(self.results)

    def __iter__(self) -> Iterator[TrialMetrics]:
        return iter(self.results)

    @property
    def successes_n(self) -> int:
        """Number of successful trials."""
        return sum(result.success for result in self.results)

    @property
    def success_rate(self) -> float:
        """Share of successful trials, 0 to 1."""
        return self.successes_n / len(self.results)

    @property
    def success_interval(self) -> tuple[float, float]:
        """95 % Wilson interval (low, high) of the success rate."""
        return wilson_interval(self.successes_n, len(self.results))

    @property
    def failures(self) -> dict[str, int]:
        """{violated condition: number of failed trials}."""
        counts: dict[str, int] = {}
        for result in self.results:
            if not result.success:
                counts[result.failure] = counts.get(result.failure, 0) + 1
        return counts

    def median(self, name: str) -> float:
        """Return the median of a number of the successful trials; NaN without one.

        Args:
            name: A number of the results ("duration_s").

        Raises:
            UsageError: The results have no such number.
        """
        numbers = [
            key for key, value in vars(self.results[0]).items() if type(value) in (int, float)
        ]
        if name not in numbers:
            raise UsageError(f"results have no number '{name}'; there are {', '.join(numbers)}")
        values = [getattr(result, name) for result in self.results if result.success]
        return float(np.median(values)) if values else math.nan

    def rows(self) -> list[dict[str, Any]]:
        """Return one flat dictionary for each trial, with words for numbers that do not apply."""
        return [{**result.to_row(), "label": self.label} for result in self.results]

    def write_csv(self, path: str | Path) -> None:
        """Write `rows()` to a file."""
        write_csv(expanded(str(path)), self.rows(), missing="does not apply")


def run_trials(
    task: str = "rod_carry",
    method: str = "moveit",
    *,
    condition: str = "clean",
    trials: int = 5,
    first: int = 0,
    policy: str | Path | None = None,
    settings: Settings | None = None,
    workers: int = 1,
    label: str | None = None,
    on_trial: Callable[[TrialMetrics], None] | None = None,
) -> Trials:
    """Run trials of a method, judge them, and return the results.

    Start k is the same for every method, and the same as in `minidual try`.

    Args:
        task: One of `list_tasks()`.
        method: One of `list_methods()`.
        condition: One of `list_conditions()`: what disturbs the trials.
        trials: Number of trials.
        first: Number of the first start.
        policy: For learned methods, see `load_policy`; by default the one for the task that
            comes with the package.
        settings: {dotted path: value} of the configuration, like `--set`.
        workers: Processes; results do not depend on it.
        label: Name in comparisons; by default the method, and the condition unless clean.
        on_trial: Called with each result as it comes, for example `print`.

    Raises:
        UsageError: An unknown name, a number out of bounds, a method that cannot do the task, or
            no policy for it.
    """
    _check_numbers(trials, first)
    config = configured(task, settings)
    inputs = _inputs(config, METHODS.names([method])[0], condition, policy)
    draw = draw_under(inputs, condition, TRY)
    starts = [draw(index) for index in range(first, first + trials)]
    results: list[TrialMetrics] = []
    for result in run_all(method, inputs, starts, workers=workers, condition=condition):
        results.append(result)
        if on_trial is not None:
            on_trial(result)
    by_default = method if condition == CLEAN else f"{method}, {condition}"
    return Trials(
        task=task,
        method=method,
        condition=condition,
        seed=config.seed,
        label=label or by_default,
        results=tuple(results),
    )


def _check_numbers(trials: int, first: int) -> None:
    if not 1 <= trials <= _TRIALS_MAX:
        raise UsageError(f"trials is {trials}; 1 <= value <= {_TRIALS_MAX}")
    if first < 0:
        raise UsageError(f"first is {first}; it must be 0 or more")


def _inputs(
    config: Config,
    method: str,
    name: str,
    policy: str | Path | None,
) -> MethodInputs:
    """Return what the method is built from.

    Raises:
        UsageError: The method cannot do the task, lacks a policy, or the condition does not
            apply to it.
    """
    task = make_task(config)
    checkpoint = None
    if METHODS[method].learned:
        checkpoint = _checkpoint(method, task.name, policy)
    elif policy is not None:
        raise UsageError(f"the method '{method}' takes no policy")
    check_able(method, [task], "")
    reason = condition(name).why_not(method, task.config)
    if reason:
        raise UsageError(f"{method} has no trials under '{name}': {reason}")
    return MethodInputs(task.config, config.seed, checkpoint)


def _checkpoint(method: str, task: str, policy: str | Path | None) -> Path:
    """Return the policy of a learned method.

    Raises:
        UsageError: There is none.
    """
    if policy is not None:
        return checkpoint_of(policy, method)
    shipped = shipped_policy(task, method)
    if shipped is None:
        raise UsageError(
            f"{method} needs a policy that is trained on '{task}', and none comes with the package",
            remedy="give policy=FOLDER of a checkpoint that you have trained",
        )
    return shipped
