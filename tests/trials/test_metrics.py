"""From logs to metrics to tables; a missing value is words in a file and NaN in memory."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.durable import write_csv
from minidual.errors import DataError, NothingEvaluatedError, UsageError
from minidual.tasks.judge import Failure, Outcome
from minidual.trials.measures import LOG_RATE_HZ, MEASURES, TrialLog, measure
from minidual.trials.metrics import TrialMetrics, summarise, trial_metrics


def outcome(*failures: Failure, **changes: Any) -> Outcome:
    values = {
        "success": not failures,
        "failures": failures,
        "duration_s": 8.9,
        "goal_error_m": 0.003,
        "yaw_error_rad": 0.01,
        "tilt_max_rad": 0.04,
        "rise_m": 0.2,
        "pinch_min_n": 45.0,
        "internal_force_min_n": 38.0,
    }
    values |= changes
    told = [values.pop(name) for name in ("success", "failures", "duration_s")]
    return Outcome(*told, measured=values)


def log(duration_s: float = 4.0, **changes: Any) -> TrialLog:
    t = np.arange(0.0, duration_s + 1e-9, 1.0 / LOG_RATE_HZ)
    path = np.zeros((len(t), 2, 3))
    path[:, 0, 1] = 0.5 * t / t[-1]
    path[:, 1, 2] = 0.1 * t / t[-1]
    return TrialLog(
        t=t,
        q=changes.pop("q", 0.3 * np.sin(2 * np.pi * t[:, None] + np.arange(14))),
        tau=np.full((len(t), 14), 2.0),
        tcp=path,
        position=np.zeros((len(t), 3)),
        tilt=0.0 * t,
        pinch=np.full((len(t), 2), 50.0),
        internal_force=np.full(len(t), 41.0),
        airborne=(t > 1.0) & (t < 2.0),
    )


def logs(duration_s: float = 4.0) -> dict[str, Any]:
    return {"log": log(duration_s), "torque_ratio_max": 0.75}


def trial(index: int, *, success: bool = True, method: str = "act", **changes: Any) -> TrialMetrics:
    base = TrialMetrics(
        method=method,
        index=index,
        condition="clean",
        success=success,
        failure="" if success else "held",
        reason="" if success else "left hand pinches 3 N",
        failed_at_s=math.nan if success else 3.2,
        duration_s=8.0 + index if success else math.nan,
        torque_ratio_max=0.5 + 0.01 * index,
        jerk_rms=20.0 + index,
        tilt_max_rad=0.02 if success else 1.5,
        path_length_m=1.5,
        internal_force_min_n=30.0,
        pinch_force_min_n=40.0,
        goal_error_m=0.004,
    )
    return replace(base, **changes)


def test_a_trials_metrics_come_from_its_logs() -> None:
    made = trial_metrics("impedance", 4, outcome(), **logs())
    assert (made.method, made.index, made.condition, made.success, made.failure) == (
        "impedance",
        4,
        "clean",
        True,
        "",
    )
    assert made.torque_ratio_max == pytest.approx(9.0 / 12.0)
    assert made.path_length_m == pytest.approx(0.3)
    expected = np.sqrt(14) * 0.3 * (2 * np.pi) ** 3 / np.sqrt(2)
    assert made.jerk_rms == pytest.approx(expected, rel=0.03)
    assert (made.duration_s, made.tilt_max_rad, made.goal_error_m) == (8.9, 0.04, 0.003)
    assert math.isnan(made.failed_at_s)


def test_the_first_fault_names_a_failure_and_when() -> None:
    faults = (
        Failure("arrived", 15.0, "80 mm from the goal"),
        Failure("held", 4.25, "left hand pinches 3 N"),
    )
    made = trial_metrics("act", 1, outcome(*faults), **logs())
    assert (made.success, made.failure, made.failed_at_s) == (False, "held", 4.25)
    assert made.reason == "left hand pinches 3 N"
    assert math.isnan(made.duration_s)
    row = made.to_row()
    assert row["duration_s"] == "did not succeed"
    assert trial_metrics("act", 1, outcome(), **logs()).to_row()["failed_at_s"] == "did not fail"
    stuck = trial_metrics("act", 1, outcome(success=False), **logs())
    assert (stuck.failure, stuck.failed_at_s) == ("unfinished", 8.9)


def test_a_trial_too_short_for_a_jerk_says_so() -> None:
    made = trial_metrics("act", 1, outcome(Failure("level", 0.2, "tilt")), **logs(0.3))
    assert math.isnan(made.jerk_rms)
    assert made.to_row()["jerk_rms"] == "not measured"


def test_a_log_that_is_not_finite_is_refused() -> None:
    bad = logs()
    bad["log"].q[3] = np.nan
    with pytest.raises(DataError, match="NaN or infinity"):
        trial_metrics("act", 1, outcome(), **bad)


class TestMeasures:
    """Each against a motion whose answer is known."""

    def test_what_never_happened_is_not_a_number(self) -> None:
        still = log()
        still.airborne[:] = False
        found = measure(still, 0.2, 40.0)
        assert math.isnan(found["sync_error_m"])
        assert math.isnan(found["internal_force_error_n"])
        assert found["impulse_max_ns"] == 0.0

    def test_the_hands_part_by_what_their_distance_changes_in_the_air_alone(self) -> None:
        """The left hand goes 0.125 m/s along y, the right one 0.025 along z, held from 1 to 2 s."""
        apart = [
            math.hypot(0.125 * t, 0.025 * t) for t in (1.0 + 1 / LOG_RATE_HZ, 2.0 - 1 / LOG_RATE_HZ)
        ]
        assert measure(log(), 0.2, 40.0)["sync_error_m"] == pytest.approx(apart[1] - apart[0])
        let_go = log()
        let_go.pinch[let_go.t > 1.5, 1] = 0.0
        assert measure(let_go, 0.2, 40.0)["sync_error_m"] < 0.51 * (apart[1] - apart[0])

    def test_the_internal_force_is_compared_with_what_the_method_wants(self) -> None:
        assert measure(log(), 0.2, 40.0)["internal_force_error_n"] == pytest.approx(1.0)
        assert math.isnan(measure(log(), 0.2, math.nan)["internal_force_error_n"])

    def test_a_blow_of_half_a_metre_a_second_on_two_kilograms_is_one_newton_second(self) -> None:
        struck = log()
        struck.position[:, 0] = 0.5 * np.maximum(0.0, struck.t - 2.0)
        assert measure(struck, 2.0, math.nan)["impulse_max_ns"] == pytest.approx(1.0)

    def test_work_is_torque_times_way_whichever_way(self) -> None:
        t = log().t
        swung = log(q=np.c_[np.sin(2 * np.pi * t), np.zeros((len(t), 13))])
        assert measure(swung, 0.2, math.nan)["energy_j"] == pytest.approx(2.0 * 4 * 4.0, rel=1e-3)

    def test_a_swing_of_25_hz_is_in_the_jerk_at_50_hz_alone(self) -> None:
        t = log().t
        shaken = log(q=0.001 * np.sin(2 * np.pi * 25.0 * t)[:, None] * np.ones(14))
        found = measure(shaken, 0.2, math.nan)
        expected = 0.001 * (2 * np.pi * 25.0) ** 3 * np.sqrt(7.0)
        assert found["jerk_50_hz_rms"] == pytest.approx(expected, rel=0.1)
        assert (
            trial_metrics("act", 1, outcome(), shaken, torque_ratio_max=0.1).jerk_rms
            < 0.1 * expected
        )

    def test_they_are_in_the_rows_and_their_medians_in_the_summary(self) -> None:
        made = trial_metrics("impedance", 4, outcome(progress=0.5, energy_j=3.0), **logs())
        row = made.to_row()
        assert set(MEASURES) <= set(row)
        assert (row["progress"], row["energy_j"], row["planning_s"]) == (0.5, 3.0, "not measured")
        others = [
            replace(made, index=k, measured={**made.measured, "progress": k / 4}) for k in range(4)
        ]
        others[0] = replace(others[0], wall={"planning_s": 0.2})
        summary = summarise(others, np.random.default_rng(0))
        assert summary.measures["progress"] == pytest.approx(0.375)
        assert summary.measures["planning_s"] == 0.2
        assert summary.record()["measures"]["inference_s"] == "nan"
        assert summary.to_row()["inference_s"] == "not measured"

    def test_measured_times_make_no_two_trials_differ(self) -> None:
        assert trial(0, wall={"planning_s": 1.0}) == trial(0, wall={"planning_s": 2.0})


def test_a_summary_says_over_which_trials_it_speaks() -> None:
    trials = [
        trial(0),
        trial(1),
        trial(2),
        trial(3, success=False),
        trial(4, success=False, failure="arrived"),
    ]
    row = summarise(trials, np.random.default_rng(0))
    assert (row.trials_n, row.successes_n, row["success_rate"]) == (5, 3, 0.6)
    assert (row["success_low"], row["success_high"]) == pytest.approx((0.2307, 0.8824), abs=1e-4)
    assert row["duration_median_s"] == 9.0
    assert row["duration_low_s"] <= 9.0 <= row["duration_high_s"]
    assert row["torque_ratio_max"] == pytest.approx(0.54)
    assert row["jerk_rms_median"] == 22.0
    assert row["tilt_max_rad"] == 1.5  # the dropped object counts
    assert row["tilt_median_rad"] == 0.02
    assert row.failures == {"arrived": 1, "held": 1}
    assert row.to_row()["failures"] == "1 x object not at its goal; 1 x grip lost"
    trials[3:] = [
        replace(lost, failed_in=phase)
        for lost, phase in zip(trials[3:], ("lift", "release"), strict=True)
    ]
    again = [*trials, replace(trials[3], index=5)]
    assert summarise(again, np.random.default_rng(0)).failures == {
        "held (lift)": 2,
        "arrived (release)": 1,
    }


def test_no_successful_trial_is_said_in_words_and_stays_nan_for_checks() -> None:
    row = summarise([trial(s, success=False) for s in range(4)], np.random.default_rng(0))
    assert (row["success_rate"], row["success_low"]) == (0.0, 0.0)
    assert math.isnan(row["duration_median_s"])
    cells = row.to_row()
    for name in (
        "duration_median_s",
        "duration_low_s",
        "duration_high_s",
        "path_length_m",
        "pinch_force_min_n",
    ):
        assert cells[name] == "no successful trial"
    assert cells["tilt_max_rad"] == 1.5
    for at in range(3):
        hole = [trial(i, internal_force_min_n=math.nan if i == at else 30.0) for i in range(3)]
        assert math.isnan(summarise(hole, np.random.default_rng(0))["internal_force_min_n"]), (
            "NaN in any place"
        )
        hole = [trial(i, pinch_force_min_n=math.nan if i == at else 30.0) for i in range(3)]
        assert math.isnan(summarise(hole, np.random.default_rng(0))["pinch_force_min_n"])
    unmeasured = summarise([trial(0, jerk_rms=math.nan)], np.random.default_rng(0))
    assert math.isnan(unmeasured["jerk_rms_median"])
    assert unmeasured.to_row()["jerk_rms_median"] == "not measured"


def test_summaries_refuse_mixtures_doubles_and_nothing() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(NothingEvaluatedError):
        summarise([], rng)
    with pytest.raises(UsageError, match="2 methods or conditions"):
        summarise([trial(0), trial(1, method="moveit")], rng)
    with pytest.raises(UsageError, match="2 methods or conditions"):
        summarise([trial(0), trial(1, condition="pushed")], rng)
    with pytest.raises(UsageError, match="same trial twice"):
        summarise([trial(0), trial(0)], rng)


def test_a_table_holds_the_names_and_numbers_of_the_verdict(tmp_path: Path) -> None:
    trials = [
        trial(s, method=m, success=(s + k) % 3 > 0)
        for k, m in enumerate(("moveit", "act"))
        for s in range(6)
    ]
    rng = np.random.default_rng(0)
    summaries = [summarise([t for t in trials if t.method == m], rng) for m in ("moveit", "act")]
    with write_csv(
        tmp_path / "new" / "methods.csv",
        [s.to_row() for s in summaries],
    ).open() as file:
        read = list(csv.DictReader(file))
    assert [line["method"] for line in read] == ["moveit", "act"]
    for line, summary in zip(read, summaries, strict=True):
        assert {name: float(line[name]) for name in summary.numbers} == summary.numbers
        assert summary.record().items() >= summary.numbers.items()
    assert summaries[1].record()["failures"] == {"held": 2}
    with write_csv(tmp_path / "trials.csv", [t.to_row() for t in trials]).open() as file:
        assert len(list(csv.DictReader(file))) == 12
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new", "trials.csv"]


def test_an_empty_table_and_a_folder_that_is_a_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(NothingEvaluatedError):
        write_csv(tmp_path / "a.csv", [])
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="cannot make the folder"):
        write_csv(tmp_path / "file" / "a.csv", [{"a": 1}])
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
