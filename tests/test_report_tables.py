"""The comparison and the words: complete or said to be incomplete, and drawn from the numbers alone."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import pytest
import report_samples as samples

from minidual.errors import DataError
from minidual.gate.check import Check
from minidual.show.report import model
from minidual.show.report.analysis import analyse, relative_margin
from minidual.show.report.captions import FAULTS
from minidual.show.report.comparison import compare
from minidual.show.report.indicators import INDICATORS, three_digits
from minidual.show.report.trials import read_trials
from minidual.show.report.wording import count, duration, joined, percent
from minidual.trials.tables import write_csv

KEYS = [indicator.key for indicator in INDICATORS]


@pytest.fixture
def table() -> dict[str, dict]:
    return samples.methods_data(samples.make_trials())


def own_check(table: dict, name: str = "tables_complete", methods: tuple[str, ...] = samples.METHODS) -> Check:
    """Return one of the report's own checks for a table of methods."""
    given = model.ReportInput("t", (), {}, {}, (), methods, True, "standard", 1)
    checks = model.report_checks(given, compare(methods, {"methods": table}))
    return next(check for check in checks if check.name == name)


def test_a_full_table_is_complete(table: dict) -> None:
    assert own_check(table).passed is True
    assert own_check(table, "missing_cells").observed == 0


def test_a_missing_method_is_counted_cell_by_cell(table: dict) -> None:
    del table["act"]
    assert own_check(table).passed is False
    assert own_check(table, "missing_cells").observed == len(INDICATORS) + 1  # and its interval
    assert "act.success_rate" in own_check(table).why


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("hole", [math.nan, "nan", math.inf, None, "no successful trial", True])
def test_a_cell_that_is_no_finite_number_is_missing(table: dict, key: str, hole: object) -> None:
    table["moveit"][key] = hole
    comparison = compare(samples.METHODS, {"methods": table})
    assert f"moveit.{key}" in comparison.missing()
    assert own_check(table).passed is False


@pytest.mark.parametrize("key", ["success_low", "success_high", "trials"])
def test_a_success_rate_without_its_interval_is_missing(table: dict, key: str) -> None:
    del table["impedance"][key]
    assert compare(samples.METHODS, {"methods": table}).missing() == ["impedance.success_interval"]


def test_no_success_leaves_completion_time_undefined_but_nothing_else(table: dict) -> None:
    table["act"].update(success_rate=0.0, success_low=0.0, success_high=0.16)
    table["act"].update(duration_median_s="nan", path_length_m="nan")
    comparison = compare(samples.METHODS, {"methods": table})
    assert comparison.complete
    assert comparison.rows[2].cell("duration_median_s").state == "undefined"
    table["act"]["jerk_rms_median"] = "nan"
    assert compare(samples.METHODS, {"methods": table}).missing() == ["act.jerk_rms_median"]


def test_no_method_at_all_is_incomplete() -> None:
    assert own_check({}, methods=()).passed is False


def test_data_that_is_no_table_is_refused() -> None:
    with pytest.raises(DataError, match="methods"):
        compare(samples.METHODS, {"methods": ["act"]})


def test_excellent_and_best_follow_the_numbers(table: dict) -> None:
    comparison = compare(samples.METHODS, {"methods": table})
    excellent = {(row.method, c.indicator.key): c.excellent for row in comparison.rows for c in row.cells}
    assert excellent["impedance", "duration_median_s"] is True
    assert excellent["moveit", "duration_median_s"] is False
    assert excellent["act", "jerk_rms_median"] is False
    assert excellent["act", "path_length_m"] is None
    best = {c.indicator.key: row.method for row in comparison.rows for c in row.cells if c.best}
    for key in KEYS:
        choose = max if key == "success_rate" else min
        assert best[key] == choose(samples.METHODS, key=lambda method: table[method][key])


def test_a_method_that_never_succeeds_is_best_and_excellent_in_nothing(table: dict) -> None:
    table["act"].update(success_rate=0.0, success_low=0.0, success_high=0.16, tilt_max_rad=0.0)
    rows = compare(samples.METHODS, {"methods": table}).rows
    tilt = {row.method: row.cell("tilt_max_rad") for row in rows}
    assert (tilt["act"].value, tilt["act"].best, tilt["act"].excellent) == (0.0, False, None)
    assert tilt["moveit"].best
    assert [cell.excellent for cell in rows[2].cells if cell.excellent is not None] == [False]  # success itself
    text = "\n".join(analyse({}, compare(samples.METHODS, {"methods": table}), [])[0].sentences)
    assert "Largest tilt: lowest with moveit" in text
    assert "act did not complete a trial" in text


def test_every_condition_of_the_success_test_has_words() -> None:
    from minidual.tasks import success

    assert set(re.findall(r"^\* (\w+)", success.__doc__ or "", re.MULTILINE)) == set(FAULTS)


def test_a_value_on_the_excellent_limit_is_not_excellent() -> None:
    torque = next(indicator for indicator in INDICATORS if indicator.key == "torque_ratio_max")
    assert torque.is_excellent(0.8) is False
    assert torque.is_excellent(0.799) is True


def test_a_tilt_that_is_rounding_is_shown_as_none() -> None:
    tilt = next(indicator for indicator in INDICATORS if indicator.key == "tilt_max_rad")
    assert tilt.shown(4e-12) == "0.000"
    assert tilt.shown(math.radians(0.0364)) == "0.0364"


def test_trials_survive_the_way_through_the_file(tmp_path: Path) -> None:
    trials = samples.make_trials(6)
    read = read_trials(write_csv(tmp_path / "benchmark.csv", trials))
    assert [(t.method, t.index, t.success, t.failure) for t in read] == [
        (t.method, t.index, t.success, t.failure) for t in trials
    ]
    for one, other in zip(trials, read, strict=True):
        assert other.numbers["tilt_max_rad"] == pytest.approx(one.tilt_max_rad)
        assert math.isnan(other.numbers["duration_s"]) == (not one.success)


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ("jerk_rms", "jerk", "lacks column 'jerk_rms'"),
        ("True", "maybe", "line 2: success is 'maybe'"),
        (",0,", ",zero,", "line 2: index is 'zero'"),
    ],
)
def test_a_damaged_table_of_trials_is_named(tmp_path: Path, before: str, after: str, says: str) -> None:
    path = write_csv(tmp_path / "benchmark.csv", samples.make_trials(2))
    path.write_text(path.read_text(encoding="utf-8").replace(before, after, 1), encoding="utf-8")
    with pytest.raises(DataError, match=says):
        read_trials(path)


def test_a_missing_table_of_trials_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"benchmark\.csv cannot be read"):
        read_trials(tmp_path / "benchmark.csv")


@pytest.fixture
def words(tmp_path: Path) -> dict[str, str]:
    given = samples.make_run(tmp_path)
    trials = read_trials(given.folders["benchmark"] / "benchmark.csv")
    passages = analyse(given.verdicts, compare(given.methods, given.verdicts["benchmark"].data), trials)
    return {passage.heading: "\n".join(passage.sentences) for passage in passages}


def test_the_words_rank_methods_and_do_not_claim_more_than_the_trials_show(words: dict[str, str]) -> None:
    text = words["Which method does what best"]
    assert "impedance 20 of 20 (100 %, 95 % interval 84 to 100 %)" in text
    assert "impedance against moveit: of 20 shared starts, one start went to impedance alone" in text
    assert text.count("these trials do not separate them") == 3
    assert "Completion time: lowest with impedance" in text
    assert "act is excellent in 2 of 5" in text


def test_the_words_do_claim_what_many_trials_show(tmp_path: Path) -> None:
    given = samples.make_run(tmp_path, samples.make_trials(200))
    trials = read_trials(given.folders["benchmark"] / "benchmark.csv")
    passages = analyse({}, compare(given.methods, given.verdicts["benchmark"].data), trials)
    (pair,) = [s for s in passages[0].sentences if s.startswith("impedance against act")]
    assert "difference +25 points, 95 % interval +19 to +31" in pair
    assert pair.endswith("they differ.")


def test_the_words_name_failures_and_when(words: dict[str, str]) -> None:
    text = words["What failed, and when"]
    assert "act failed 5 of 20: missed the goal three times, at " in text
    assert "moveit failed 1 of 20: grip lost one time, at " in text
    assert "impedance did not fail in a single trial" in text


def test_the_words_name_the_gap_between_training_and_held_out_starts(words: dict[str, str]) -> None:
    assert "95 %: 17 points more, outside the interval" in words["Held-out against training starts"]


def test_the_thinnest_margin_comes_first(words: dict[str, str]) -> None:
    first, *_ = words["Where the margins are thinnest"].splitlines()
    assert first == "carry: torque_ratio_max is 0.79, limit < 1: 21 % inside its limit."


def test_a_failed_check_has_the_thinnest_margin(tmp_path: Path) -> None:
    given = samples.make_run(tmp_path)
    bad = replace(given.verdicts["plan"], checks=(Check("both_arms.time_max_s", 12.0, "<", 10.0, "s"),))
    passages = analyse({**given.verdicts, "plan": bad}, compare(given.methods, {}), [])
    assert passages[-1].sentences[0] == "plan: both_arms.time_max_s is 12 s, limit < 10 s: 20 % beyond its limit."


def test_a_share_at_100_percent_has_no_margin_to_be_thin(words: dict[str, str]) -> None:
    text = words["Where the margins are thinnest"]
    assert "success_rate is 1," not in text
    assert "Three checks stood at the best value there is" in text  # plan, carry, and impedance's


def test_without_numbers_there_are_no_words() -> None:
    assert analyse({}, compare(samples.METHODS, {}), []) == ()


def test_relative_margins_exist_only_where_they_mean_something() -> None:
    assert relative_margin(Check("a", 5.0, "<", 10.0)) == pytest.approx(0.5)
    assert relative_margin(Check("a", 0, "<=", 0)) is None
    assert relative_margin(Check("a", 3, "==", 3)) is None
    assert relative_margin(Check("a", math.nan, "<", 1.0)) is None


@pytest.mark.parametrize(
    ("made", "wanted"),
    [
        (duration(9.96), "10.0 s"),
        (duration(59.97), "1 min 00 s"),
        (duration(3725.0), "1 h 02 min"),
        (percent(0.004), "0.4 %"),
        (percent(0.0), "0 %"),
        (percent(0.845), "84 %"),
        (count(1, "trial"), "one trial"),
        (count(12, "trial"), "12 trials"),
        (joined(["a", "b", "c"]), "a, b and c"),
        (joined([]), ""),
        (three_digits(2.0), "2.00"),
        (three_digits(118.2), "118"),
        (three_digits(1234.5), "1,234"),
        (three_digits(0.00001234), "1.2e-05"),
    ],
)
def test_numbers_as_words(made: str, wanted: str) -> None:
    assert made == wanted
