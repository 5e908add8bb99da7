"""`minidual demo` shows the methods that can do a task on one start."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from minidual.errors import UsageError
from minidual.gate.stage import ToolContext
from minidual.stages import demo as demo_module
from minidual.stages.checkpoint_choice import chosen_policies
from minidual.stages.demo import demo
from minidual.trials.metrics import TrialMetrics
from tests.support import trial_results
from tests.support.tool_contexts import tool_context


class FakeTake(NamedTuple):
    """A take that was not run."""

    result: TrialMetrics


def context(tmp_path: Path, task: str, **options: Any) -> ToolContext:
    return tool_context(tmp_path, "demo", task, **options)


@pytest.fixture
def films(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the films that were asked for; no trial runs."""
    names: list[str] = []

    def film(takes: list[FakeTake], path: Path) -> None:
        names.append(path.name)

    def fake_take(method: str, inputs: Any, trial: Any) -> FakeTake:
        return FakeTake(trial_results.result(trial.index, method=method))

    monkeypatch.setattr(demo_module, "take", fake_take)
    monkeypatch.setattr(demo_module, "film_takes", film)
    monkeypatch.setattr(
        "minidual.stages.checkpoint_choice.shipped_policy",
        lambda task, method: tmp_policy if (task, method) == ("rod_carry", "act") else None,
    )
    return names


tmp_policy = Path("policy")


def test_all_methods_are_shown_where_there_is_a_policy(tmp_path: Path, films: list[str]) -> None:
    result = demo(context(tmp_path, "rod_carry", start=7))
    assert [row["method"] for row in result.data["results"]] == ["moveit", "impedance", "act"]
    assert {row["index"] for row in result.data["results"]} == {7}
    assert films == ["rod_carry.mp4"]
    assert str(tmp_path / "run" / "demo" / "rod_carry.mp4") in result.lines
    assert any("minidual try rod_carry" in line for line in result.lines)


def test_where_no_policy_comes_with_the_package_it_says_so(
    tmp_path: Path,
    films: list[str],
) -> None:
    result = demo(context(tmp_path, "sort"))
    assert [row["method"] for row in result.data["results"]] == ["moveit", "impedance"]
    assert any("no policy comes with the package for sort" in note for note in result.notes)


def test_a_named_policy_comes_first_then_that_of_the_run_if_it_is_of_the_task(
    tmp_path: Path,
    films: list[str],
) -> None:
    named = tmp_path / "named"
    own = tmp_path / "run" / "train-act" / "checkpoint"
    recorded = tmp_path / "run" / "teleop-record"
    for folder in (named, own, recorded):
        folder.mkdir(parents=True)
    for folder in (named, own):
        (folder / "config.json").write_text("{}")
    (recorded / "config.yaml").write_text("task: pot_lift\n")

    def chosen(task: str, **options: Any) -> Path | None:
        policy = chosen_policies(context(tmp_path, task, **options), ["moveit", "act"], task)
        return policy["act"].checkpoint if policy else None

    assert chosen("pot_lift", checkpoint=str(named)) == named
    assert chosen("pot_lift", checkpoint=[f"act={named}"]) == named
    assert chosen("pot_lift") == own
    assert chosen("rod_carry") == tmp_policy
    assert chosen("sort") is None
    with pytest.raises(UsageError, match="there is no policy"):
        chosen("sort", checkpoint=str(recorded))
    with pytest.raises(UsageError, match="the methods that drive a policy here are act"):
        chosen("sort", checkpoint=f"moveit={named}")


def test_whose_policy_it_is_must_be_said_where_several_methods_drive_one(tmp_path: Path) -> None:
    named = context(tmp_path, "pot_lift", checkpoint="somewhere")
    with pytest.raises(UsageError, match="say whose policy it is"):
        chosen_policies(named, ["act", "rl"], "pot_lift")


def test_a_start_below_zero_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--start is -3; it must be 0 or more"):
        demo(context(tmp_path, "rod_carry", start=-3))


def test_with_a_view_the_takes_are_played_side_by_side_and_no_film_is_made(
    tmp_path: Path,
    films: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    played: list[tuple[int, int | None]] = []

    def play(view: Any, takes: Any, scene: Any, robot: Any, *, rounds_n: int | None) -> None:
        played.append((len(takes), rounds_n))

    monkeypatch.setattr(demo_module, "play_takes", play)
    monkeypatch.setattr("sys.stdin", None)
    result = demo(replace(context(tmp_path, "rod_carry"), view=object()))
    assert played == [(3, 1)]
    assert films == []
    assert result.data["film"] == ""
