"""`benchmark`: its checks refuse a method below its rate, and report every indicator."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from minidual.config.root import BenchmarkConfig, Config
from minidual.gate.stage import StageContext
from minidual.stages.benchmark import benchmark_checks, network_notes
from minidual.trials.metrics import MethodSummary, TrialMetrics, summarise
from tests.support.trial_results import BAD, failing, result, results


def summaries(rows: list[TrialMetrics]) -> list[MethodSummary]:
    return [summarise(rows, np.random.default_rng(0))]


def test_benchmark_fails_a_method_below_its_rate_and_a_method_that_ran_too_little() -> None:
    asked = BenchmarkConfig().success_rate_min, 10
    all_read = {"impedance": 10}
    assert failing(benchmark_checks(summaries(results()), *asked, all_read)) == set()
    rows = results(**BAD)
    rows[:2] = [result(i, **BAD) for i in range(2)]
    checks = benchmark_checks(summaries(rows), *asked, all_read)
    assert failing(checks) == {"impedance.success_rate"}
    for read in ({"impedance": 9}, {"moveit": 10}):
        checks = benchmark_checks(summaries(results()), *asked, read)
        assert failing(checks) == {"trials_per_method"}
    assert failing(benchmark_checks([], *asked, all_read)) == {"trials_per_method"}


def test_benchmark_reports_every_indicator_of_every_method() -> None:
    limits = BenchmarkConfig().success_rate_min
    checks = benchmark_checks(summaries(results()), limits, 10, {"impedance": 10})
    names = {check.name for check in checks}
    for indicator in (
        "success_rate",
        "duration_median_s",
        "torque_ratio_max",
        "jerk_rms_median",
        "tilt_max_rad",
        "path_length_m",
    ):
        assert f"impedance.{indicator}" in names


@pytest.mark.parametrize(
    ("record", "note"),
    [
        ({"architecture": "keyframe_act"}, "act drives keyframe_act: a supervised head reads"),
        ({"architecture": "stock_act"}, "act drives stock_act: LeRobot's ACT"),
        ({"architecture": "nearest"}, "act drives nearest"),
        ({}, "act drives unknown"),
    ],
)
def test_the_network_behind_act_is_named(
    record: dict[str, str],
    note: str,
    tmp_path: Path,
) -> None:
    (tmp_path / "train.json").write_text(json.dumps(record))
    config = Config()
    upstream = {"train-act": tmp_path}
    context = StageContext(
        folder=tmp_path,
        config=config,
        seed=config.seed,
        profile="standard",
        upstream=upstream,
    )
    notes = network_notes(context, ("moveit", "act"))
    assert len(notes) == 1
    assert notes[0].startswith(note)
    assert network_notes(context, ("moveit",)) == []
