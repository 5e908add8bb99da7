"""The comparison and the analysis: complete or said to be incomplete, and from the numbers alone."""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from minidual.config.root import Config
from minidual.durable import write_csv
from minidual.errors import DataError
from minidual.gate.check import Check
from minidual.gate.stage import StageContext
from minidual.show.report.analysis import Analysis, analyse
from minidual.show.report.figures import read_trials
from minidual.show.report.indicators import INDICATORS, three_digits
from minidual.show.report.model import Report
from minidual.show.report.page import build_report
from minidual.show.report.tables import Tables, tabulate
from minidual.show.report.wording import duration, joined, percent, points
from minidual.tasks.failures import FAILURES
from minidual.tasks.success import OfObject, SuccessCondition
from tests.support import report_samples as samples
from tests.support.report_samples import figures_once  # noqa: F401  (a fixture for every test here)

KEYS = [indicator.key for indicator in INDICATORS]


def compare(methods: tuple[str, ...], data: dict) -> Tables:
    """Return the undisturbed table."""
    return tabulate(methods, (), data)


@pytest.fixture
def table() -> dict[str, dict]:
    return samples.methods_data(samples.make_trials())


def own_check(
    table: dict,
    name: str = "missing_cells",
    methods: tuple[str, ...] = samples.METHODS,
) -> Check:
    """Return one of the report's own checks for a table of methods."""
    given = StageContext(folder=Path(), config=Config(), seed=1, profile="standard")
    checks = Report(
        given,
        {samples.TASK: compare(methods, {"methods": table})},
        {},
        (),
    ).checks
    return next(check for check in checks if check.name == name)


def test_a_full_table_is_complete(table: dict) -> None:
    assert own_check(table).passed is True
    assert own_check(table).observed == 0


def test_a_missing_method_is_counted_cell_by_cell(table: dict) -> None:
    del table["act"]
    assert own_check(table).passed is False
    assert own_check(table).observed == len(INDICATORS) + 1  # and its number of trials
    assert "act.clean.success_rate" in own_check(table).why


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("hole", [math.nan, "nan", math.inf, None, "no successful trial", True])
def test_a_cell_that_is_no_finite_number_is_missing(table: dict, key: str, hole: object) -> None:
    table["moveit"][key] = hole
    assert f"moveit.clean.{key}" in compare(samples.METHODS, {"methods": table}).missing()
    assert own_check(table).passed is False


@pytest.mark.parametrize(
    ("key", "hole"),
    [("success_low", "success_rate"), ("success_high", "success_rate"), ("trials", "trials")],
)
def test_a_success_rate_without_its_interval_is_missing(table: dict, key: str, hole: str) -> None:
    del table["impedance"][key]
    assert compare(samples.METHODS, {"methods": table}).missing() == [f"impedance.clean.{hole}"]


def test_no_success_leaves_completion_time_undefined_but_nothing_else(table: dict) -> None:
    table["act"].update(success_rate=0.0, success_low=0.0, success_high=0.16)
    table["act"].update(duration_median_s="nan", path_length_m="nan")
    tables = compare(samples.METHODS, {"methods": table})
    assert tables.missing() == []
    assert [i.key for i in INDICATORS if tables.clean.cells[2].undefined(i)] == [
        "duration_median_s",
        "path_length_m",
    ]
    table["act"]["jerk_rms_median"] = "nan"
    assert compare(samples.METHODS, {"methods": table}).missing() == ["act.clean.jerk_rms_median"]


def test_no_method_at_all_is_incomplete() -> None:
    assert own_check({}, methods=()).passed is False


def test_excellent_and_best_follow_the_numbers(table: dict) -> None:
    row = compare(samples.METHODS, {"methods": table}).clean
    excellent = {(cell.method, i.key): cell.excellent(i) for cell in row.cells for i in INDICATORS}
    assert excellent["impedance", "duration_median_s"] is True
    assert excellent["moveit", "duration_median_s"] is False
    assert excellent["act", "jerk_rms_median"] is False
    assert excellent["act", "path_length_m"] is False  # it has no such limit
    best = {i.key: cell.method for cell in row.cells for i in INDICATORS if row.is_best(cell, i)}
    for key in KEYS:
        choose = max if key == "success_rate" else min
        assert best[key] == choose(samples.METHODS, key=lambda method: table[method][key])


def test_a_method_that_never_succeeds_is_best_and_excellent_in_nothing(table: dict) -> None:
    table["act"].update(success_rate=0.0, success_low=0.0, success_high=0.16, tilt_max_rad=0.0)
    row = compare(samples.METHODS, {"methods": table}).clean
    tilt = next(i for i in INDICATORS if i.key == "tilt_max_rad")
    assert row.cells[2].measures[tilt.key].value == 0.0
    assert [row.is_best(cell, tilt) for cell in row.cells] == [True, False, False]
    assert not any(row.cells[2].excellent(indicator) for indicator in INDICATORS)


def test_every_condition_of_the_success_test_has_words() -> None:
    kinds = (*SuccessCondition.__subclasses__(), *OfObject.__subclasses__())
    names = {kind.name for kind in kinds if hasattr(kind, "name")}
    assert len(names) > 5
    assert names <= set(FAILURES)


def test_a_value_on_the_excellent_limit_is_not_excellent() -> None:
    torque = next(indicator for indicator in INDICATORS if indicator.key == "torque_ratio_max")
    assert torque.is_excellent(0.8) is False
    assert torque.is_excellent(0.799) is True


def test_a_tilt_that_is_rounding_is_shown_as_none() -> None:
    tilt = next(indicator for indicator in INDICATORS if indicator.key == "tilt_max_rad")
    assert tilt.shown(4e-12) == "0.000"
    assert tilt.shown(math.radians(0.0364)) == "0.0364"


def test_the_figures_read_the_undisturbed_trials(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "benchmark.csv", [t.to_row() for t in samples.disturbed_trials(6)])
    read = read_trials(path)
    assert [(t["method"], t["success"] == "True") for t in read] == [
        (t.method, t.success) for t in samples.make_trials(6)
    ]


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data.update(methods=["act"]),
        lambda data: data.update(losses={"a": 1}),
        lambda data: data["comparisons"][0].pop("p_value"),
        lambda data: data["methods"]["act"].update(failures=3),
        lambda data: data["methods"]["act"].update(failures={"x": None}),
        lambda data: data["comparisons"][0].update(rate_difference="nan"),
    ],
)
def test_damaged_data_of_the_benchmark_is_named(
    tmp_path: Path,
    damage: Callable[[dict], object],
) -> None:
    given = samples.make_run(tmp_path)
    data = copy.deepcopy(given.verdicts["benchmark"].data["tasks"][samples.TASK])
    damage(data)
    with pytest.raises(DataError, match=r"the data of a verdict, or benchmark\.csv, is damaged"):
        build_report(samples.with_data(given, data), tmp_path)


def test_a_table_of_trials_without_a_column_is_named(tmp_path: Path) -> None:
    given = samples.make_run(tmp_path)
    path = given.upstream["benchmark"] / "benchmark.csv"
    path.write_text(
        path.read_text(encoding="utf-8").replace("jerk_rms", "jerk", 1),
        encoding="utf-8",
    )
    with pytest.raises(DataError, match="'jerk_rms'"):
        build_report(given, tmp_path)


def test_a_missing_table_of_trials_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"benchmark\.csv cannot be read"):
        read_trials(tmp_path / "benchmark.csv")


@pytest.fixture
def report(tmp_path: Path) -> Report:
    (tmp_path / "page").mkdir()
    return build_report(samples.make_run(tmp_path), tmp_path / "page")


@pytest.fixture
def page(report: Report, tmp_path: Path) -> str:
    """Return the words of the page without its tags."""
    text = re.sub(r"<[^>]*>", " ", (tmp_path / "page" / "report.html").read_text(encoding="utf-8"))
    return re.sub(r"\s+", " ", text.replace("&lt;", "<")).replace(" :", ":")


def test_pairs_of_methods_claim_no_more_than_the_trials_show(report: Report, page: str) -> None:
    pair = report.tables[samples.TASK].pairs[0]
    names = ("first", "second", "trials_n", "only_first_n", "only_second_n")
    assert [pair[name] for name in names] == ["moveit", "impedance", 20, 0, 1]
    assert pair["duration_difference_s"] > 0.0  # moveit takes longer
    assert page.count("not separated by these trials") == 3
    assert "they differ" not in page


def test_pairs_of_methods_claim_what_many_trials_show(tmp_path: Path) -> None:
    given = samples.make_run(tmp_path, samples.make_trials(200))
    pairs = compare(samples.METHODS, given.verdicts["benchmark"].data["tasks"][samples.TASK]).pairs
    (pair,) = [p for p in pairs if (p["first"], p["second"]) == ("impedance", "act")]
    assert pair["shown"]
    assert pair["rate_difference"] == pytest.approx(0.25)
    assert (points(pair["rate_difference_low"]), points(pair["rate_difference_high"])) == (
        "+19",
        "+31",
    )


def test_failures_are_named_and_counted(page: str) -> None:
    assert "act: 5 of 20 trials failed: 3 × object not at its goal, 2 × grip lost." in page
    assert "moveit: 1 of 20 trials failed: 1 × grip lost." in page
    assert "impedance: 0 of 20 trials failed." in page


def test_the_gap_between_training_and_held_out_starts_is_told(page: str) -> None:
    assert "held out from training: 78 % (95 % interval 65 % to 87 %)" in page
    assert "training set: 95 %, +17 points, outside that interval" in page
    assert "undisturbed: 47 of 60 succeed (65 % to 87 %); 13 × object not at its goal." in page
    assert (
        "room: 45 of 60 succeed (63 % to 87 %); 15 × object not at its goal; training by training 80 %, 65 %, 80 %."
        in page
    )


def test_the_thinnest_margin_comes_first(report: Report, page: str) -> None:
    first = report.analysis.margins[0]
    assert (first.stage, first.check.name) == ("carry", "torque_ratio_max")
    assert first.share_of_limit == pytest.approx(0.21)
    assert "carry: torque_ratio_max is 0.79, limit < 1, 21 % inside its limit." in page


def test_a_failed_check_has_the_thinnest_margin(tmp_path: Path) -> None:
    given = samples.make_run(tmp_path)
    bad = replace(
        given.verdicts["plan"],
        checks=(Check("both_arms.time_max_s", 12.0, "<", 10.0, "s"),),
    )
    first = analyse({**given.verdicts, "plan": bad}).margins[0]
    assert (first.stage, first.share_of_limit) == ("plan", pytest.approx(-0.2))


def test_a_share_at_100_percent_has_no_margin_to_be_thin(report: Report) -> None:
    assert all(margin.check.observed != 1.0 for margin in report.analysis.margins)
    assert report.analysis.at_best_n == 3  # plan, carry, and impedance's success


def test_without_numbers_there_is_no_analysis() -> None:
    assert analyse({}) == Analysis(gap=None, sets={}, margins=[], at_best_n=0)
    tables = compare(samples.METHODS, {})
    assert tables.pairs == []
    assert tables.losses == []


def test_relative_margins_exist_only_where_they_mean_something() -> None:
    assert Check("a", 5.0, "<", 10.0).relative_margin == pytest.approx(0.5)
    assert Check("a", 0, "<=", 0).relative_margin is None
    assert Check("a", 3, "==", 3).relative_margin is None
    assert Check("a", math.nan, "<", 1.0).relative_margin is None


@pytest.mark.parametrize(
    ("made", "wanted"),
    [
        (duration(9.96), "10.0 s"),
        (duration(59.97), "1 min 00 s"),
        (duration(3725.0), "1 h 02 min"),
        (percent(0.004), "0.4 %"),
        (percent(0.0), "0 %"),
        (percent(0.995), "99.5 %"),
        (percent(1.0), "100 %"),
        (INDICATORS[0].shown(0.996), "99.6"),
        (three_digits(999.7), "1,000"),
        (percent(0.845), "84 %"),
        (points(-0.004), "0"),
        (points(-0.12), "−12"),
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
