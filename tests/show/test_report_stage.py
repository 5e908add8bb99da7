"""The stage as the gate calls it."""

from __future__ import annotations

from pathlib import Path

from minidual.config.root import Config
from minidual.gate.stage import StageContext, StageResult
from minidual.stages.registry import STAGES
from minidual.stages.report import run
from tests.support import report_samples as samples
from tests.support.report_samples import figures_once  # noqa: F401  (a fixture for every test here)


def run_report(given: StageContext, folder: Path, **other: object) -> StageResult:
    folder.mkdir()
    config = Config()
    context = StageContext(
        folder=folder,
        config=config,
        seed=config.seed,
        profile="standard",
        upstream=given.upstream,
        verdicts=given.verdicts,
        **other,
    )
    return run(context)


def test_the_registry_and_the_stage_agree() -> None:
    assert STAGES["report"].load() is run
    assert STAGES.upstream("report") == tuple(name for name, _ in samples.STAGES)


def test_the_stage_writes_the_page_and_derives_its_checks(tmp_path: Path) -> None:
    result = run_report(samples.make_run(tmp_path), tmp_path / "out")
    assert {check.name: check.passed for check in result.checks} == {
        "missing_cells": True,
        "stages_not_passing": True,
    }
    assert (tmp_path / "out" / "report.html").is_file()
    assert (tmp_path / "out" / "report.json").is_file()
    assert result.data["state"] == "pass"


def test_a_waiver_reaches_the_page(tmp_path: Path) -> None:
    result = run_report(samples.make_run(tmp_path), tmp_path / "out", waivers=(samples.WAIVER,))
    assert result.data["state"] == "tainted"
    assert samples.WAIVER.reason in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_the_result_depends_on_title_and_methods() -> None:
    one = Config()
    other = Config.model_validate({"report": {"title": "Another"}})
    fewer = Config.model_validate({"benchmark": {"methods": ["act"]}})
    assert STAGES["report"].parameters(one) != STAGES["report"].parameters(other)
    assert STAGES["report"].parameters(one) != STAGES["report"].parameters(fewer)
