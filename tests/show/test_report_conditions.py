"""Methods under disturbances on the page: every hole is named, every blank has its reason, every word its number."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from minidual.config.root import Config
from minidual.gate.stage import StageContext
from minidual.show.report.figures import success_figure
from minidual.show.report.model import Report
from minidual.show.report.page import build_report
from minidual.show.report.tables import Tables, tabulate
from minidual.stages.registry import STAGES
from minidual.trials.benchmark import limits_of
from minidual.trials.conditions import CLEAN
from tests.support import report_samples as samples
from tests.support.report_samples import figures_once  # noqa: F401  (a fixture for every test here)


@pytest.fixture
def data() -> dict[str, Any]:
    return samples.benchmark_data(samples.disturbed_trials())


@pytest.fixture
def given(tmp_path: Path) -> StageContext:
    return samples.make_run(tmp_path / "run", samples.disturbed_trials())


def built(given: StageContext, root: Path) -> tuple[Report, str]:
    (root / "report").mkdir()
    return build_report(given, root / "report"), (root / "report" / "report.html").read_text(
        encoding="utf-8",
    )


def table(data: dict[str, Any]) -> Tables:
    return tabulate(samples.METHODS, samples.CONDITIONS, data)


def test_the_table_holds_every_cell_with_its_numbers(data: dict[str, Any]) -> None:
    found = table(data)
    assert found.missing() == []
    assert [row.condition for row in found.rows] == list(samples.CONDITIONS)
    cells = {(c.method, c.condition): c for c in found.cells}
    push = cells["act", "push +x"]
    assert (push.successes, push.trials, push.success.low) == (0, 20, 0.0)
    assert push.measures["duration_median_s"] is None, "nothing completed"
    assert push.loss is not None
    assert (push.loss["rate_difference"], push.loss["trials_n"]) == (-0.75, 20)
    assert push.loss["rate_difference_high"] < 0.0
    moved = cells["moveit", "push +x"].measures["duration_median_s"]
    still = cells["moveit", CLEAN].measures["duration_median_s"]
    assert moved.middle == pytest.approx(still.middle + 0.5)
    assert moved.low <= moved.middle <= moved.high
    assert (cells["act", "delay 20 ms"].state, cells["act", "delay 20 ms"].why) == (
        "spared",
        "act reads no force",
    )


def test_a_cell_says_what_is_promised_and_nothing_where_nothing_is(
    given: StageContext,
    tmp_path: Path,
) -> None:
    report, text = built(given, tmp_path)
    limits = {(c.method, c.condition): c.limit for c in report.tables[samples.TASK].cells}
    assert limits["impedance", CLEAN] == "more than 80 %"
    assert limits["impedance", "push +x"] == "95 % or more (carry --perturb)"
    assert (limits["moveit", "push +x"], limits["act", "push +x"]) == ("", "")
    assert (
        text.count("(carry --perturb)")
        == sum("(carry --perturb)" in limit for limit in limits.values())
        > 0
    )
    asked = given.config.deploy.model_copy(update={"condition_rate_min": {"room": 0.85}})
    config = given.config.model_copy(update={"deploy": asked})
    assert limits_of(config, samples.TASK, "act", "room") == "85 % or more (deploy)"
    assert limits_of(config, "handover", "act", "room") == ""
    assert limits_of(config, "handover", "impedance", "push +x") == ""


def _drop(*path: str) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        for key in path[:-1]:
            data = data[key]
        del data[path[-1]]

    return change


def _set(value: Any, *path: str) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        for key in path[:-1]:
            data = data[key]
        data[path[-1]] = value

    return change


_PUSH = ("conditions", "push +x", "methods")


@pytest.mark.parametrize(
    ("change", "hole"),
    [
        (_drop("conditions", "push +x"), "moveit.push +x.success_rate"),
        (_drop(*_PUSH, "act"), "act.push +x.success_rate"),
        (_drop(*_PUSH, "moveit", "success_low"), "moveit.push +x.success_rate"),
        (_set("nan", *_PUSH, "moveit", "jerk_rms_median"), "moveit.push +x.jerk_rms_median"),
        (_set(float("inf"), *_PUSH, "moveit", "tilt_high_rad"), "moveit.push +x.tilt_max_rad"),
        (_set("nan", *_PUSH, "moveit", "duration_median_s"), "moveit.push +x.duration_median_s"),
        (_set({"applies": False, "why": ""}, *_PUSH, "moveit"), "moveit.push +x.success_rate"),
        (_set([], "losses"), "impedance.push +x.loss"),
    ],
)
def test_a_hole_is_named_and_fails_the_report(
    data: dict[str, Any],
    change: Callable[[dict[str, Any]], None],
    hole: str,
    given: StageContext,
) -> None:
    assert {c.passed for c in Report(given, {samples.TASK: table(data)}, {}, ()).checks} == {True}
    broken = copy.deepcopy(data)
    change(broken)
    assert hole in table(broken).missing()
    checks = {
        check.name: check for check in Report(given, {samples.TASK: table(broken)}, {}, ()).checks
    }
    assert checks["missing_cells"].passed is False
    assert checks["missing_cells"].observed == len(table(broken).missing()) > 0
    assert checks["stages_not_passing"].passed


def test_conditions_that_nobody_ran_fail_the_report(
    given: StageContext,
    data: dict[str, Any],
    tmp_path: Path,
) -> None:
    plain = {key: value for key, value in data.items() if key not in ("conditions", "losses")}
    report, text = built(samples.with_data(given, plain), tmp_path)
    assert report.state == "fail"
    assert (
        len(report.tables[samples.TASK].missing()) == 6 * 8
    )  # six indicators, the number of trials and the loss
    assert "This report does not pass" in text
    assert text.count('<td class="missing"') == 6 * (1 + 5)


def test_an_undisturbed_benchmark_has_no_such_table_and_passes(tmp_path: Path) -> None:
    report, text = built(samples.make_run(tmp_path), tmp_path)
    assert (report.state, len(report.tables[samples.TASK].rows), "Under disturbances" in text) == (
        "pass",
        1,
        False,
    )
    assert 'id="conditions"' not in text


def test_an_indicator_without_its_interval_is_a_hole() -> None:
    rows = samples.methods_data(samples.make_trials())
    assert tabulate(samples.METHODS, (), {"methods": rows}).missing() == []
    del rows["act"]["jerk_rms_low"]
    assert tabulate(samples.METHODS, (), {"methods": rows}).missing() == [
        "act.clean.jerk_rms_median",
    ]


def test_the_page_shows_what_applies_what_is_lost_and_what_is_behind_it(
    given: StageContext,
    tmp_path: Path,
) -> None:
    report, text = built(given, tmp_path)
    assert report.state == "pass"
    part = text[text.index('id="conditions"') : text.index('id="analysis"')]
    words = re.sub(r"<[^>]*>|\s+", " ", part)
    words = re.sub(r" +", " ", words)
    assert "0 of 20 0 to 16 % −75 points on 20 shared starts stopped itself in 20" in words
    assert part.count('class="measured costly"') == 1
    assert "does not apply moveit reads no force" in words
    assert "no trial completed" in words
    assert "not told what has changed; they know only the age of a sensed pose" in words
    assert "Holm" in words
    assert part.count("<table") == 1 + 5
    document = json.loads((tmp_path / "report" / "report.json").read_text(encoding="utf-8"))
    document = document["tasks"][samples.TASK]
    act = document["conditions"]["push +x"]["methods"]["act"]
    rate = act["measures"]["success_rate"]
    assert (rate["value"], rate["low"]) == (0.0, 0.0)
    assert rate["high"] == pytest.approx(0.161, abs=1e-3)
    assert act["loss"]["rate_difference"] == -0.75
    assert document["conditions"]["delay 20 ms"]["methods"]["act"]["state"] == "spared"


def test_ranks_and_figures_of_trials_are_those_of_undisturbed_ones(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    plain, _ = built(samples.make_run(tmp_path / "a"), tmp_path / "a")
    disturbed, _ = built(
        samples.make_run(tmp_path / "b", samples.disturbed_trials()),
        tmp_path / "b",
    )
    (new,) = disturbed.tables.values()
    (old,) = plain.tables.values()
    assert (new.clean, new.pairs) == (old.clean, old.pairs)
    (drawn,) = disturbed.figures.values()
    (known,) = plain.figures.values()
    assert [f.svg for f in drawn[1:]] == [f.svg for f in known[1:]]


def test_losses_and_pairs_are_listed_only_where_the_trials_show_them(
    data: dict[str, Any],
    given: StageContext,
    tmp_path: Path,
) -> None:
    found = table(data)
    (loss,) = found.losses
    assert tuple(loss[name] for name in ("method", "first", "rate_difference", "trials_n")) == (
        "act",
        "push +x",
        -0.75,
        20,
    )
    parted = {(pair["condition"], pair["first"], pair["second"]) for pair in found.partings}
    assert parted == {("push +x", "moveit", "act"), ("push +x", "impedance", "act")}
    words = re.sub(r"<[^>]*>", "", built(given, tmp_path)[1])
    assert "act under push +x: −75 points on 20 starts (95 % interval −" in words
    assert "push +x: moveit against act +95 points" in words
    assert "act under push +x: 20 × grip lost; stopped itself in 20." in words
    few = samples.benchmark_data(samples.disturbed_trials(4))
    assert table(few).losses == []


def test_a_difference_is_shown_after_correction_for_the_number_of_tests(
    data: dict[str, Any],
) -> None:
    """p = 0.02 in one test of four is not below 0.05 over all of them."""
    for rows in (data["losses"], data["comparisons"]):
        for row in rows:
            row["p_value"] = (
                0.02
                if row.get("condition", row["first"]) == "push +x" and "act" in row.values()
                else 1.0
            )
    assert table(data).losses == []
    many = [{**row, "condition": f"other {i}"} for i, row in enumerate(data["comparisons"][:3])]
    assert table({**data, "comparisons": data["comparisons"] + many}).partings == []
    data["losses"] = [row for row in data["losses"] if row["method"] == "act"]
    data["comparisons"] = [
        r for r in data["comparisons"] if (r["first"], r["condition"]) == ("moveit", "push +x")
    ][1:]
    alone = table(data)
    assert [loss["p_holm"] for loss in alone.losses] == [0.02]
    assert [pair["p_holm"] for pair in alone.partings] == [0.02]


def test_each_task_has_its_own_tables_and_figures(
    given: StageContext,
    data: dict[str, Any],
    tmp_path: Path,
) -> None:
    other = copy.deepcopy(data)
    other["methods"]["act"] = {"applies": False, "why": "its policy is trained on 'rod_carry'"}
    given.verdicts["benchmark"].data["tasks"]["handover"] = other
    changes = {
        "benchmark": given.config.benchmark.model_copy(
            update={"tasks": (samples.TASK, "handover")}
        ),
    }
    report, text = built(replace(given, config=given.config.model_copy(update=changes)), tmp_path)
    assert list(report.tables) == [samples.TASK, "handover"]
    assert (
        text.count("<h2>Comparison of the methods: ") == text.count("<h2>Under disturbances: ") == 2
    )
    assert text.count("Thinnest margins") == 1
    assert text.count("Success in each task") == 1
    assert '<th scope="row"><a href="#comparison-handover">handover</a>' in text
    # The excellent limits were set for the run's own task.
    assert text.count('<th scope="row">excellent</th>') == text.count("Star: better than") == 1
    first, second = (report.tables[task] for task in (samples.TASK, "handover"))
    assert (first.own, second.own) == (True, False)
    handover = json.loads((tmp_path / "report" / "report.json").read_text())["tasks"]["handover"]
    assert all(cell["excellent"] == [] for cell in handover["comparison"]["methods"].values())
    assert "does not apply</span><small>its policy is trained on &#39;rod_carry&#39;" in text
    assert report.tables["handover"].clean.cells[2].state == "spared"
    assert len(list((tmp_path / "report" / "figures").glob("handover-*.svg"))) == 1
    (tmp_path / "again").mkdir()
    given.verdicts["benchmark"].data["tasks"].pop("handover")
    report, _ = built(report.context, tmp_path / "again")
    assert "handover.moveit.clean.success_rate" in report.checks[0].why, (
        "a task that nobody ran is a hole"
    )


def test_the_figure_has_a_line_for_every_cell_that_ran_and_says_which_did_not(
    data: dict[str, Any],
) -> None:
    figure = success_figure(table(data).rows)
    assert figure is not None
    for word in (
        *samples.METHODS,
        *samples.CONDITIONS,
        "moveit: does not apply",
        "act: does not apply",
    ):
        assert word in figure.svg
    assert "impedance: does not apply" not in figure.svg
    assert "var(--ink)" in figure.themed


def test_the_result_depends_on_the_conditions() -> None:
    other = Config.model_validate({"benchmark": {"conditions": ["clean", "push +x"]}})
    assert STAGES["report"].parameters(Config()) != STAGES["report"].parameters(other)
