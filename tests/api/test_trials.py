"""Trials and comparisons from Python."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import pytest

from minidual.api.catalogue import list_conditions, list_methods, list_tasks, load_task
from minidual.api.comparison import compare
from minidual.api.trials import Trials, run_trials
from minidual.errors import ConfigError, UsageError
from minidual.trials.benchmark import TRY
from minidual.trials.metrics import TrialMetrics
from tests.support.trial_results import missed, result, results


def series(label: str = "impedance", trials: list[TrialMetrics] | None = None) -> Trials:
    """Return results as those of a series."""
    return Trials(
        task="rod_carry",
        method="impedance",
        condition="clean",
        seed=1,
        label=label,
        results=tuple(results() if trials is None else trials),
    )


def faster(by_s: float, n: int = 10) -> list[TrialMetrics]:
    return [result(index, duration_s=7.9 - by_s - 0.01 * index) for index in range(n)]


@pytest.fixture(scope="module")
def resting() -> tuple[Trials, list[TrialMetrics]]:
    """Two trials in which the arms rest, and what was told of each as it came."""
    told: list[TrialMetrics] = []
    trials = run_trials(
        "rod_carry",
        "hold",
        trials=2,
        first=3,
        settings={"carry.impedance.stiffness_n_per_m": 300},
        on_trial=told.append,
    )
    return trials, told


def test_trials_are_judged_and_told_as_they_come(
    resting: tuple[Trials, list[TrialMetrics]],
) -> None:
    trials, told = resting
    assert [trial.index for trial in trials] == [3, 4]
    assert told == list(trials)
    assert trials.label == "hold"
    assert trials.successes_n == 0
    assert trials.success_interval[0] == pytest.approx(0.0, abs=1e-9)
    assert sum(trials.failures.values()) == len(trials) == 2
    assert math.isnan(trials.median("duration_s"))


def test_starts_are_those_of_try(resting: tuple[Trials, list[TrialMetrics]]) -> None:
    """The seed and the number of a start tell what it is."""
    trials, _ = resting
    task = load_task("rod_carry")
    assert TRY == "try"
    assert trials.seed == task.config.seed
    assert task.trial(trials.seed, TRY, 3).start != task.trial(trials.seed, TRY, 4).start


def test_results_are_written_as_a_table(
    resting: tuple[Trials, list[TrialMetrics]],
    tmp_path: Path,
) -> None:
    resting[0].write_csv(tmp_path / "trials.csv")
    with (tmp_path / "trials.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["index"] for row in rows] == ["3", "4"]
    assert {row["duration_s"] for row in rows} == {"did not succeed"}


def test_numbers_of_a_series() -> None:
    trials = series(trials=missed(3))
    assert trials.success_rate == pytest.approx(0.7)
    assert trials.failures == {"held": 3}
    assert trials.median("duration_s") == pytest.approx(7.9)
    with pytest.raises(UsageError, match=r"no number 'time'.*duration_s"):
        trials.median("time")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"trials": 0}, "trials is 0"),
        ({"trials": 10_001}, "10000"),
        ({"first": -1}, "first is -1"),
        ({"task": "rod_cary"}, "did you mean"),
        ({"method": "movit"}, "moveit"),
        ({"condition": "windy"}, "windy"),
        ({"task": "sort", "method": "act"}, "none comes with the package"),
        ({"method": "act", "policy": "nowhere"}, "no policy 'nowhere'.*rod_carry"),
        ({"method": "moveit", "policy": "rod_carry"}, "takes no policy"),
        ({"task": "sort", "method": "impedance_open"}, "cannot do"),
        ({"method": "hold", "condition": "light_dark"}, "light_dark"),
        ({"settings": {"carry.impedance.stifness": 3}}, "stifness"),
    ],
)
def test_a_wrong_word_is_refused_before_the_first_trial(
    words: dict[str, Any],
    message: str,
) -> None:
    with pytest.raises((UsageError, ConfigError), match=rf"(?s){message}"):
        run_trials(**words)


def test_the_faster_series_is_named() -> None:
    comparison = compare(series(), series("quick", faster(1.0)))
    assert comparison.sentence.startswith("On rod_carry, quick is 1.0")
    assert comparison.duration_difference_s == pytest.approx(1.045)
    low_s, high_s = comparison.duration_interval_s
    assert 1.0 <= low_s < high_s < 1.1
    assert (comparison.both_n, comparison.only_first_n, comparison.p_value) == (10, 0, 1.0)


def test_nothing_is_said_of_durations_without_a_pair() -> None:
    comparison = compare(series(trials=missed(10)), series("other", missed(10)))
    assert math.isnan(comparison.duration_difference_s)
    assert "Cannot tell" in comparison.sentence


@pytest.mark.parametrize(
    ("second", "message"),
    [
        (series(), "both series have the label"),
        (series("short", results(9)), "other starts: 0 to 9 and 0 to 8"),
        (Trials("sort", "moveit", "clean", 1, "moveit", results()), "differ in task"),
        (Trials("rod_carry", "moveit", "clean", 2, "moveit", results()), "differ in seed"),
    ],
)
def test_series_that_cannot_be_compared_are_refused(second: Trials, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        compare(series(), second)


def test_what_there_is_is_listed_with_a_line_for_each() -> None:
    assert "rod_carry" in list_tasks()
    assert {"moveit", "impedance", "act"} <= set(list_methods())
    assert "nothing disturbs" in list_conditions()["clean"]
    texts = [*list_tasks().values(), *list_methods().values(), *list_conditions().values()]
    assert all(texts)


def test_settings_reach_the_task() -> None:
    task = load_task("pot_lift", settings={"scene.task.time_limit_s": 9.0})
    assert task.time_limit_s == 9.0
