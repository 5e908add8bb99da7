"""Negative controls: every check of carry, deploy and benchmark can say no, and says no for its own reason."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from minidual.config.control import CarryLimits
from minidual.config.learning import DeployConfig
from minidual.config.loader import load_config
from minidual.config.root import BenchmarkConfig, Config
from minidual.demos.rig import PURPOSE
from minidual.errors import ConfigError, UsageError
from minidual.gate.check import Check
from minidual.gate.stage import StageContext
from minidual.registry import rows_beside
from minidual.stages import deploy as deploy_stage
from minidual.stages import words
from minidual.stages.benchmark import benchmark_checks
from minidual.stages.carry import carry_checks
from minidual.stages.config_checks import check_deploy
from minidual.stages.deploy import deploy_checks, deploy_starts, farthest, seed_rates, set_checks
from minidual.stages.train_act import training_seeds
from minidual.tasks.catalogue import TASKS, make_task
from minidual.tasks.task import placement
from minidual.trials.metrics import TrialMetrics, summarise

TASK = Config().scene.task

GOOD: dict[str, Any] = {
    "method": "impedance",
    "index": 0,
    "condition": "clean",
    "success": True,
    "failure": "",
    "reason": "",
    "failed_at_s": math.nan,
    "duration_s": 7.9,
    "torque_ratio_max": 0.8,
    "jerk_rms": 22.0,
    "tilt_max_rad": 0.01,
    "path_length_m": 2.8,
    "internal_force_min_n": 39.0,
    "pinch_force_min_n": 60.0,
    "goal_error_m": 0.001,
}
BAD = {
    "success": False,
    "failure": "held",
    "reason": "dropped",
    "failed_at_s": 3.0,
    "duration_s": math.nan,
}


def trials(n: int = 10, **last: Any) -> list[TrialMetrics]:
    """Return n good trials, the last one changed."""
    made = [TrialMetrics(**{**GOOD, "index": i}) for i in range(n)]
    made[-1] = TrialMetrics(**{**GOOD, "index": n - 1, **last})
    return made


def failing(checks: list[Check]) -> set[str]:
    return {check.name for check in checks if check.passed is False}


def carry(rows: list[TrialMetrics]) -> list[Check]:
    return carry_checks(rows, CarryLimits(), TASK)


def test_good_carries_pass_every_check() -> None:
    checks = carry(trials())
    assert failing(checks) == set()
    assert all(check.op for check in checks)


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({"tilt_max_rad": 0.036}, {"tilt_max_rad"}),
        ({"tilt_max_rad": math.nan}, {"tilt_max_rad"}),
        ({"internal_force_min_n": 19.0}, {"internal_force_min_n"}),
        ({"duration_s": 8.1}, {"duration_max_s"}),
        ({"torque_ratio_max": 1.0}, {"torque_ratio_max"}),
        (BAD, {"success_rate", "duration_max_s"}),
    ],
)
def test_one_bad_carry_fails_the_check_it_should(change: dict[str, Any], names: set[str]) -> None:
    assert failing(carry(trials(**change))) == names


def test_two_lost_rods_of_two_hundred_are_allowed_and_three_are_not() -> None:
    rows = trials(200, **BAD)
    rows[0] = TrialMetrics(**{**GOOD, **BAD})
    assert "success_rate" not in failing(carry(rows))
    rows[1] = TrialMetrics(**{**GOOD, **BAD, "index": 1})
    assert "success_rate" in failing(carry(rows))


def test_a_motor_that_stands_at_its_limit_fails_the_stage() -> None:
    def saturated(seconds: float) -> set[str]:
        results = [
            replace(row, saturated_max_s=seconds if row.index == 3 else 0.0) for row in trials()
        ]
        return failing(carry_checks(results, CarryLimits(), TASK))

    assert saturated(0.02) == set()
    assert saturated(0.021) == {"saturated_max_s"}
    assert saturated(math.nan) == {"saturated_max_s"}


def deploy(
    rows: list[TrialMetrics],
    hz: float = 200.0,
    *,
    seen_n: int = 0,
    judged: bool = True,
) -> list[Check]:
    settings = DeployConfig(trials=10, **({} if judged else {"success_rate_min": None}))
    return deploy_checks(summarise(rows, np.random.default_rng(0)), seen_n, hz, settings)


def missed(count: int) -> list[TrialMetrics]:
    return [TrialMetrics(**{**GOOD, **(BAD if i < count else {}), "index": i}) for i in range(10)]


@pytest.mark.parametrize(
    ("checks", "names"),
    [
        (deploy(missed(4)), set()),
        (deploy(missed(5)), {"success_rate"}),
        (deploy(missed(0), 29.0), {"inference_hz"}),
        (deploy(missed(0), math.nan), {"inference_hz"}),
        (deploy(missed(0)[:9]), {"trials"}),
        (deploy(missed(0), seen_n=1), {"held_out_starts_seen"}),
    ],
)
def test_deploy_fails_below_half_when_slow_and_on_demonstrated_starts(
    checks: list[Check],
    names: set[str],
) -> None:
    assert failing(checks) == names


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
    starts, seen_n = deploy_starts(config, 7, [4, 0, 2])
    assert seen_n == 0
    assert [t.index for t in starts["held_out"]] == list(range(config.deploy.trials))
    later = config.model_copy(
        update={"deploy": config.deploy.model_copy(update={"first_start": 1000})},
    )
    assert [t.index for t in deploy_starts(later, 7, [4])[0]["held_out"]] == list(
        range(1000, 1000 + later.deploy.trials),
    )
    assert [t.index for t in starts["training"]] == [4, 0, 2][: config.deploy.training_trials]
    # The demonstrations' starts are those that teleop-record draws.
    assert {t.purpose for t in starts["training"]} == {PURPOSE}
    assert (
        starts["training"][0].start
        == make_task(config).trial(7, PURPOSE, 4, widen=config.teleop.widen).start
    )
    # The control: drawn from the demonstrations' stream, the starts 0 and 1 were seen, whatever their width.
    monkeypatch.setattr(deploy_stage, "HELD_OUT", PURPOSE)
    assert deploy_starts(config, 7, [4, 0, 1])[1] == 2


def summaries(rows: list[TrialMetrics]) -> list[Any]:
    return [summarise(rows, np.random.default_rng(0))]


def test_benchmark_fails_a_method_below_its_rate_and_a_method_that_ran_too_little() -> None:
    asked = BenchmarkConfig().success_rate_min, 10
    assert failing(benchmark_checks(summaries(trials()), *asked)) == set()
    rows = trials(**BAD)
    rows[:2] = [TrialMetrics(**{**GOOD, **BAD, "index": i}) for i in range(2)]
    assert failing(benchmark_checks(summaries(rows), *asked)) == {"impedance.success_rate"}
    assert failing(benchmark_checks(summaries(trials(9)), *asked)) == {"trials_per_method"}
    assert failing(benchmark_checks([], *asked)) == {"trials_per_method"}


def test_benchmark_reports_every_indicator_of_every_method() -> None:
    names = {
        check.name
        for check in benchmark_checks(summaries(trials()), BenchmarkConfig().success_rate_min, 10)
    }
    for indicator in (
        "success_rate",
        "duration_median_s",
        "torque_ratio_max",
        "jerk_rms_median",
        "tilt_max_rad",
        "path_length_m",
    ):
        assert f"impedance.{indicator}" in names


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


def test_rates_of_seeds_are_told_apart_and_each_training_has_its_own_seed() -> None:
    results = [
        TrialMetrics(**{**GOOD, **won, "index": i})
        for i, won in enumerate([{}, {}, BAD, {}, BAD, BAD])
    ]
    assert seed_rates(results, 3) == [1.0, 0.5, 0.0]
    with pytest.raises(ValueError, match="reshape"):
        seed_rates(results[:5], 3)
    seeds = training_seeds(20260, 3)
    assert seeds[0] == 20260
    assert len(set(seeds)) == 3
    assert training_seeds(20260, 1) == seeds[:1]


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
    """Before, a policy of the rod drove at a bottle and passed in smoke, which has no limit."""
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


REPORTED = {
    "env-check": ["latency.wall_median_us"],
    "plan": [
        "first_plan_median_s",
        "replan_p99_s",
        "core_share",
        "line_blocked_rate",
        "closed_chain.time_median_s",
    ],
    "carry": [
        "success_low",
        "goal_error_max_m",
        "pinch_force_min_n",
        "duration_median_s",
        "jerk_rms_median",
    ],
    "teleop-record": ["success_rate", "attempts", "latency_p50_s", "recorded_per_min"],
    "train-act": [
        "train_s",
        "samples_per_s",
        "parameters",
        "overshoot_max_rad",
        "inference_hz",
        "validation_l1",
    ],
    "deploy": ["success_low", "success_high", "goal_error_median_m", "looks_at_object"],
    "deploy-set": ["worst_seed", "median_seed"],
    "benchmark": [
        "duration_median_s",
        "torque_ratio_max",
        "jerk_rms_median",
        "tilt_max_rad",
        "path_length_m",
    ],
}
REPORTED["plan"].append("closed_chain.draws_left_out_n")
REPORTED["train-act"].append("validation_keyframe_rad")


def test_every_check_says_why_and_each_that_has_a_limit_what_to_do() -> None:
    """Those named here have none: they are reported."""
    rows = rows_beside(words.__file__, "checks.yaml")
    silent = {
        stage: [name for name, row in checks.items() if "remedy" not in row]
        for stage, checks in rows.items()
    }
    assert all(row["why"] for checks in rows.values() for row in checks.values())
    assert {k: sorted(v) for k, v in silent.items() if v} == {
        k: sorted(v) for k, v in REPORTED.items()
    }
