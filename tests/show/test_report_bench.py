"""The record of the bench: written, read, refused if damaged, and shown on the page of its run."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from minidual.errors import DataError
from minidual.gate.stage import StageContext
from minidual.show.report.bench import (
    BENCH_FILE,
    BenchRecord,
    BenchRow,
    BenchTable,
    read_bench,
    write_bench,
)
from minidual.show.report.page import build_report
from tests.support import report_samples as samples
from tests.support.report_samples import figures_once  # noqa: F401  (a fixture for every test here)

RECORD = BenchRecord(
    made_at="2026-01-31T12:00:00Z",
    commit="0123456789abcdef0123456789abcdef01234567",
    machine={"processor": "Some CPU", "cores": 2, "python": "3.12.1"},
    libraries={"ompl": "2.0.0"},
    tables={
        "planning": BenchTable(
            "planning: goal in to trajectory out",
            ("median_ms", "solved", "median_ratio"),
            (
                BenchRow("minidual", {"median_ms": 5.25, "solved": 20}, {}),
                BenchRow(
                    "OMPL",
                    {"median_ms": 35.0, "solved": 19, "median_ratio": 0.15},
                    {"median_ratio": 1.0 / 3.0},
                ),
                BenchRow(
                    "roboplan",
                    {"median_ms": 12.5, "median_ratio": 0.42},
                    {"median_ratio": 1.0 / 3.0},
                ),
            ),
            ("ratio: minidual's time over this planner's",),
        ),
    },
)


@pytest.fixture
def context(tmp_path: Path) -> StageContext:
    """Return the input of a report that is built in a folder of its run."""
    run = tmp_path / "run"
    return replace(samples.make_run(run), folder=run / "report")


def build(context: StageContext) -> str:
    context.folder.mkdir()
    build_report(context, context.folder)
    return (context.folder / "report.html").read_text(encoding="utf-8")


def test_a_record_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / BENCH_FILE
    write_bench(path, RECORD)
    assert read_bench(path) == RECORD


def test_counts_stay_integers_and_numbers_have_three_digits() -> None:
    minidual, ompl, roboplan = RECORD.tables["planning"].rows
    assert minidual.text("solved") == "20"
    assert minidual.text("median_ms") == "5.25"
    assert ompl.text("median_ms") == "35.0"
    assert roboplan.text("solved") == "-"


OTHER_SCHEMA = {
    "schema": 2,
    "made_at": "",
    "commit": "",
    "machine": {},
    "libraries": {},
    "tables": {},
}


@pytest.mark.parametrize("content", ["", "[]", '{"schema": 1}', json.dumps(OTHER_SCHEMA)])
def test_a_damaged_record_and_another_schema_are_named(
    context: StageContext,
    content: str,
) -> None:
    (context.folder.parent / BENCH_FILE).write_text(content, encoding="utf-8")
    with pytest.raises(DataError, match=r"bench\.json") as caught:
        build(context)
    assert "make bench" in caught.value.remedy


def test_without_a_record_the_page_says_nothing_of_speed(context: StageContext) -> None:
    assert 'id="speed"' not in build(context)
    document = json.loads((context.folder / "report.json").read_text(encoding="utf-8"))
    assert document["bench"] is None


def test_the_page_shows_the_record_of_its_run_with_goals_and_origin(context: StageContext) -> None:
    write_bench(context.folder.parent / BENCH_FILE, RECORD)
    page = build(context)
    speed = page[page.index('id="speed"') : page.index('id="made"')]
    assert "0123456789, 2026-01-31 12:00:00 UTC, on Some CPU, 2 cores" in speed
    assert "No verdict of this run depends on them" in speed
    assert speed.count("goal: at most 0.333") == 2
    assert speed.count('class="costly"') == 1  # roboplan's row misses the goal
    assert "0.42" in speed
    document = json.loads((context.folder / "report.json").read_text(encoding="utf-8"))
    assert document["bench"]["tables"]["planning"]["rows"][1]["numbers"]["median_ratio"] == 0.15
