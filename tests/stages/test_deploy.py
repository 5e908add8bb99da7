"""`deploy`: which starts it draws, what each check refuses, and what it films."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from minidual.config.learning import DeployConfig
from minidual.config.loader import load_config
from minidual.config.root import Config
from minidual.demos.rig import PURPOSE
from minidual.durable import write_csv
from minidual.errors import ConfigError, UsageError
from minidual.gate.check import Check
from minidual.gate.stage import StageContext
from minidual.stages import deploy as deploy_stage
from minidual.stages.config_checks import check_deploy
from minidual.stages.deploy import deploy_starts, farthest
from minidual.stages.deploy_checks import (
    LOOKS_AT_OBJECT,
    InferenceRates,
    deploy_checks,
    seed_rates,
    set_checks,
)
from minidual.tasks.catalogue import TASKS, make_task
from minidual.tasks.task import placement
from minidual.trials.metrics import TrialMetrics, summarise
from tests.support.trial_results import BAD, failing, missed, result

FAST = InferenceRates(processor_hz=200.0, wall_hz=200.0)


def deploy(
    rows: list[TrialMetrics],
    hz: float = 200.0,
    *,
    seen_n: int = 0,
    judged: bool = True,
) -> list[Check]:
    settings = DeployConfig(trials=10, **({} if judged else {"success_rate_min": None}))
    rates = InferenceRates(processor_hz=hz, wall_hz=10.0)
    return deploy_checks(summarise(rows, np.random.default_rng(0)), seen_n, rates, settings)


@pytest.mark.parametrize(
    ("checks", "names"),
    [
        (deploy(missed(4)), set()),
        (deploy(missed(5)), {"success_rate"}),
        (deploy(missed(0), 29.0), {"inference_hz"}),
        (deploy(missed(0), math.nan), {"inference_hz"}),
        (deploy(missed(0), seen_n=1), {"held_out_starts_seen"}),
    ],
)
def test_deploy_fails_below_half_when_slow_and_on_demonstrated_starts(
    checks: list[Check],
    names: set[str],
) -> None:
    assert failing(checks) == names


def drop_last(rows: list[Any]) -> list[Any]:
    return rows[:-1]


def duplicate_last(rows: list[Any]) -> list[Any]:
    return [*rows, rows[-1]]


def duplicate_in_place(rows: list[Any]) -> list[Any]:
    return [*rows[:-1], rows[-2]]


def blank_duration(rows: list[Any]) -> list[Any]:
    return [*rows[:-1], {**rows[-1], "duration_s": "nan"}]


@pytest.mark.parametrize("fault", [drop_last, duplicate_last, duplicate_in_place, blank_duration])
@pytest.mark.parametrize(
    ("damaged_set", "names"),
    [("held_out", {"trials", "sets_complete"}), ("room", {"sets_complete"})],
)
def test_deploy_fails_if_its_table_loses_or_repeats_a_trial(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    fault: Callable[[list[Any]], list[Any]],
    damaged_set: str,
    names: set[str],
) -> None:
    """The fault is in the file; the results in memory are complete."""
    results = {
        name: [replace(row, condition=name) for row in missed(4)] for name in ("held_out", "room")
    }
    asked_n = {"held_out": 10, "room": 10}
    path = tmp_path / "trials.csv"
    assert failing(deploy_stage.write_table(path, results, asked_n)) == set()

    def write(path: Path, rows: list[Any]) -> Path:
        damaged = [row for row in rows if row["condition"] == damaged_set]
        others = [row for row in rows if row["condition"] != damaged_set]
        return write_csv(path, [*others, *fault(damaged)])

    monkeypatch.setattr(deploy_stage, "write_csv", write)
    assert failing(deploy_stage.write_table(path, results, asked_n)) == names


@pytest.mark.parametrize(
    ("fault", "names"),
    [(list, set()), (drop_last, {"sets_complete"}), (duplicate_in_place, {"sets_complete"})],
)
def test_the_stage_counts_the_rows_of_its_file(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    fault: Callable[[list[Any]], list[Any]],
    names: set[str],
) -> None:
    """Two training seeds with made-up trials; the last set in the file is that of hidden objects."""

    def run_trials(method: str, _: Any, trials: list[Any], **given: Any) -> Iterator[TrialMetrics]:
        for trial in trials:
            yield result(trial.index, method=method, condition=given["condition"])

    def write(path: Path, rows: list[Any]) -> Path:
        return write_csv(path, fault(rows))

    monkeypatch.setattr(deploy_stage, "run_trials", run_trials)
    monkeypatch.setattr(deploy_stage, "write_csv", write)
    monkeypatch.setattr(deploy_stage, "film_outcomes", lambda *_: None)
    monkeypatch.setattr(deploy_stage, "measure_inference", lambda *_: FAST)
    looks = LOOKS_AT_OBJECT.report(2.0)
    monkeypatch.setattr(deploy_stage, "_looks_check", lambda *_: looks)
    (tmp_path / "config.yaml").write_text("task: rod_carry\n", encoding="utf-8")
    (tmp_path / "checkpoint").mkdir()
    (tmp_path / "seed-2" / "checkpoint").mkdir(parents=True)
    settings = {"trials": 6, "hidden_trials": 2, "hidden_rate_max": None}
    context = StageContext(
        config=Config.model_validate({"deploy": {**settings, "conditions": ["room"]}}),
        seed=1,
        profile="standard",
        folder=tmp_path / "deploy",
        upstream={"train-act": tmp_path, "teleop-record": tmp_path},
    )
    checks = {check.name: check for check in deploy_stage.run(context).checks}
    assert failing(list(checks.values())) == names
    assert (checks["trials"].observed, checks["trials"].limit) == (12, 12)


def test_a_policy_from_elsewhere_runs_without_a_training(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its demonstrations are not known, so it has no trials from their starts."""
    driven: set[Path] = set()

    def run_trials(method: str, given: Any, trials: list[Any], **more: Any) -> Iterator[Any]:
        driven.add(given.checkpoint)
        for trial in trials:
            yield result(trial.index, method=method, condition=more["condition"])

    monkeypatch.setattr(deploy_stage, "run_trials", run_trials)
    monkeypatch.setattr(deploy_stage, "film_outcomes", lambda *_: None)
    monkeypatch.setattr(deploy_stage, "measure_inference", lambda *_: FAST)
    monkeypatch.setattr(deploy_stage, "_looks_check", lambda *_: LOOKS_AT_OBJECT.report(2.0))
    theirs = tmp_path / "pretrained_model"
    theirs.mkdir()
    (theirs / "config.json").write_text('{"type": "diffusion"}')
    settings = {"policy": str(theirs), "trials": 6, "hidden_trials": 2, "hidden_rate_max": None}
    context = StageContext(
        config=Config.model_validate({"deploy": settings}),
        seed=1,
        profile="standard",
        folder=tmp_path / "deploy",
        upstream={},
    )
    checks = deploy_stage.run(context).checks
    assert failing(checks) == set()
    assert driven == {theirs}
    assert "training_success_rate" not in {check.name for check in checks}


def test_deploy_asks_for_the_trials_of_every_training_seed(tmp_path: Path) -> None:
    results = {"held_out": [replace(row, condition="held_out") for row in missed(0)]}
    checks = deploy_stage.write_table(tmp_path / "trials.csv", results, {"held_out": 30})
    assert failing(checks) == {"trials", "sets_complete"}
    (complete,) = [check for check in checks if check.name == "sets_complete"]
    assert complete.why.endswith("trials.csv: held_out 10 of 30")


@pytest.mark.parametrize(
    ("missed_n", "names"),
    [(1, set()), (2, {"room_success_rate"}), (10, {"room_success_rate"})],
)
def test_deploy_fails_below_the_limit_of_a_condition(missed_n: int, names: set[str]) -> None:
    settings = DeployConfig(trials=10, condition_rate_min={"room": 0.85})
    summary = summarise(missed(missed_n), np.random.default_rng(0))
    assert failing(set_checks("room", summary, [0.9], settings)) == names
    (rate,) = set_checks("table colour", summary, [0.9], settings)
    assert (rate.name, rate.op) == ("table_colour_success_rate", None)
    unjudged = settings.model_copy(update={"condition_rate_min": {}})
    (rate,) = set_checks("room", summary, [0.9], unjudged)
    assert rate.op is None


@pytest.mark.parametrize(
    ("missed_n", "names"),
    [(10, set()), (8, set()), (7, {"hidden_success_rate"})],
)
def test_deploy_fails_if_the_policy_succeeds_without_seeing_the_object(
    missed_n: int,
    names: set[str],
) -> None:
    summary = summarise(missed(missed_n), np.random.default_rng(0))
    checks = set_checks("object hidden", summary, [0.0, 0.5], DeployConfig(trials=10))
    assert failing(checks) == names
    assert len(checks) == 1, "other seeds' rates are not of interest"
    (unjudged,) = set_checks("object hidden", summary, [0.0], DeployConfig(hidden_rate_max=None))
    assert unjudged.op is None


@pytest.mark.parametrize("name", TASKS)
def test_the_object_is_hidden_where_going_to_the_middle_fails(name: str) -> None:
    task = make_task(Config(task=name))
    trials = [task.trial(3, "hidden", index) for index in range(40)]
    xy = np.array([[placement(start)[:2] for start in trial.start.values()] for trial in trials])
    off_m = np.linalg.norm(xy - xy.mean(axis=0), axis=2).sum(axis=1)
    chosen = [trial.index for trial in farthest(trials, 5)]
    assert len(set(chosen)) == 5
    assert off_m[chosen].min() >= np.delete(off_m, chosen).max()
    if name == "rod_carry":
        assert off_m[chosen].min() > 2 * task.scene.task.goal_tolerance_m, (
            "blind grasps end off the goal"
        )


def test_a_limit_of_deploy_needs_its_condition() -> None:
    with pytest.raises(
        ValidationError,
        match=r"limits camera moved, not one of conditions \(room\)",
    ):
        DeployConfig(condition_rate_min={"camera moved": 0.5})


def test_deploy_without_a_limit_reports_the_rate_and_does_not_pass_on_it() -> None:
    (rate,) = [c for c in deploy(missed(10), judged=False) if c.name == "success_rate"]
    assert rate.passed is None
    assert rate.observed == 0.0


def test_held_out_starts_are_none_of_the_demonstrations(monkeypatch: pytest.MonkeyPatch) -> None:
    config = load_config("smoke").config
    starts = deploy_starts(config, 7, [4, 0, 2])
    assert starts.seen_n == 0
    assert [t.index for t in starts.held_out] == list(range(config.deploy.trials))
    later = config.model_copy(
        update={"deploy": config.deploy.model_copy(update={"first_start": 1000})},
    )
    assert [t.index for t in deploy_starts(later, 7, [4]).held_out] == list(
        range(1000, 1000 + later.deploy.trials),
    )
    assert [t.index for t in starts.training] == [4, 0, 2][: config.deploy.training_trials]
    # The demonstrations' starts are those that teleop-record draws.
    assert {t.purpose for t in starts.training} == {PURPOSE}
    assert (
        starts.training[0].start
        == make_task(config).trial(7, PURPOSE, 4, widen=config.teleop.widen).start
    )
    # The control: drawn from the demonstrations' stream, the starts 0 and 1 are seen at any width.
    monkeypatch.setattr(deploy_stage, "HELD_OUT", PURPOSE)
    seen_n = deploy_starts(config, 7, [4, 0, 1]).seen_n
    assert seen_n == 2
    assert failing(deploy(missed(0), seen_n=seen_n)) == {"held_out_starts_seen"}


def test_deploy_refuses_conditions_that_the_policy_does_not_feel() -> None:
    check_deploy(
        Config(deploy=DeployConfig(conditions=("room", "camera moved", "start range x1.5"))),
    )
    with pytest.raises(
        ConfigError,
        match="'pose noise x3' does not apply: act reads no sensed pose",
    ):
        check_deploy(Config(deploy=DeployConfig(conditions=("pose noise x3",))))
    with pytest.raises(UsageError, match="did you mean 'room'"):
        check_deploy(Config(deploy=DeployConfig(conditions=("rooom",))))


def test_each_training_seed_has_its_own_rate() -> None:
    changes = [{}, {}, BAD, {}, BAD, BAD]
    rows = [result(i, **change) for i, change in enumerate(changes)]
    assert seed_rates(rows, 3) == [1.0, 0.5, 0.0]
    with pytest.raises(ValueError, match="reshape"):
        seed_rates(rows[:5], 3)


def test_films_show_the_seed_that_failed(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    """Of two trainings with three starts each, the second fails on its last start."""
    filmed: list[tuple[Any, Any, str]] = []
    notes: list[str] = []

    def film(method: str, inputs: Any, trial: Any, path: Any) -> Any:
        filmed.append((inputs, trial, path.name))
        return SimpleNamespace(text="told")

    monkeypatch.setattr(deploy_stage, "film_trial", film)
    context: Any = SimpleNamespace(folder=tmp_path, progress=SimpleNamespace(note=notes.append))
    results: Any = [SimpleNamespace(success=k != 5) for k in range(6)]
    inputs: Any = ("first", "second")
    starts: Any = ("a", "b", "c")
    deploy_stage.film_outcomes(context, inputs, starts, results)
    assert filmed == [("first", "a", "success.mp4"), ("second", "c", "failure.mp4")]
    assert notes[1] == "failure.mp4 shows trial 2, seed 2: told"


def test_deploy_refuses_a_task_that_was_not_recorded(tmp_path: Path) -> None:
    """In `smoke`, which has no limit, a policy of the rod would pass without lifting a bottle."""
    (tmp_path / "config.yaml").write_text("task: rod_carry\n", encoding="utf-8")
    context = StageContext(
        config=Config(task="handover"),
        seed=1,
        profile="smoke",
        folder=tmp_path / "deploy",
        upstream={"train-act": tmp_path, "teleop-record": tmp_path},
    )
    with pytest.raises(
        UsageError,
        match="cannot do 'handover': its policy is trained on 'rod_carry'",
    ):
        deploy_stage.run(context)
