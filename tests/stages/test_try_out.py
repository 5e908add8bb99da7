"""`minidual try` runs trials of anything, says which method is better, and gives no verdict."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import pytest

from minidual.config.root import Config
from minidual.errors import UsageError
from minidual.gate.stage import ToolContext, aligned
from minidual.stages.try_out import try_out
from minidual.tasks.catalogue import make_task
from tests.support.tool_contexts import tool_context


def context(tmp_path: Path, task: str = "rod_carry", **options: Any) -> ToolContext:
    return tool_context(tmp_path, "try", task, **options)


def test_two_methods_get_a_table_a_file_and_a_sentence(tmp_path: Path) -> None:
    tool = context(tmp_path, method="moveit,hold", trials=1, first=3)
    result = try_out(tool)
    tool.publish()
    heads, moveit, hold, *rest = result.lines
    assert heads.split()[:3] == ["method", "success", "time"]
    assert moveit.startswith("moveit  1 of 1")
    assert hold.startswith("hold    0 of 1   -")
    assert rest[1].startswith("hold fails 1 of 1: object not lifted (0 of 40 mm), at ")
    assert rest[1].endswith(" s (start 3)")
    assert result.data["answers"][0].startswith("Cannot tell moveit and hold apart")
    assert result.data["answers"][0] in rest
    with (tmp_path / "run" / "try" / "trials.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [(row["method"], row["index"], row["success"]) for row in rows] == [
        ("moveit", "3", "True"),
        ("hold", "3", "False"),
    ]
    assert not list((tmp_path / "run").glob("*/verdict.json"))


def test_starts_are_those_of_no_stage() -> None:
    task = make_task(Config())
    starts = {
        purpose: task.trial(0, purpose, 0).start["rod"]
        for purpose in ("try", "benchmark", "perturb", "deploy", "carry")
    }
    assert len(set(starts.values())) == len(starts)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"trials": 0}, "--trials is 0; 1 <= value"),
        ({"first": -1}, "--first is -1"),
        ({"method": "moveit,x"}, "no method 'x'"),
        ({"condition": "windy"}, "no condition 'windy'"),
        ({"method": "act", "checkpoint": "nowhere"}, "there is no policy"),
    ],
)
def test_a_wrong_option_is_refused_before_the_first_trial(
    tmp_path: Path,
    options: dict[str, Any],
    message: str,
) -> None:
    with pytest.raises(UsageError, match=message):
        try_out(context(tmp_path, **options))


def test_a_method_that_needs_a_policy_says_where_one_comes_from(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="act needs a policy that is trained on 'sort'") as refused:
        try_out(context(tmp_path, "sort", method="act"))
    assert "--checkpoint" in str(refused.value.remedy)


def test_a_method_that_cannot_do_the_task_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="impedance_open"):
        try_out(context(tmp_path, "insertion", method="impedance_open"))


def test_the_first_start_of_all_methods_is_filmed_side_by_side(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    taken: list[tuple[str, int, str]] = []
    filmed: list[tuple[int, str]] = []

    def take(method: str, inputs: Any, trial: Any, *, condition: str, site: Any) -> str:
        assert site is None
        taken.append((method, trial.index, condition))
        return method

    def film(takes: list[str], path: Path) -> None:
        filmed.append((len(takes), path.name))

    monkeypatch.setattr("minidual.stages.try_out.take", take)
    monkeypatch.setattr("minidual.stages.try_out.film_takes", film)
    tool = context(tmp_path, method="hold", trials=2, condition="mass +50 %", video=True)
    result = try_out(tool)
    assert taken == [("hold", 0, "mass +50 %")]
    assert filmed == [(1, "rod_carry.mp4")]
    assert result.lines[-1] == str(tool.folder / "rod_carry.mp4")


def test_columns_of_a_terminal_are_aligned() -> None:
    rows = [{"a": "1", "long head": "x"}, {"a": "100", "long head": "y"}]
    assert aligned(rows) == ["a    long head", "1    x", "100  y"]
