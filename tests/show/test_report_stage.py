"""The stage as the gate calls it."""

from __future__ import annotations

import dataclasses
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


def test_a_stage_that_passed_and_is_stale_does_not_pass(tmp_path: Path) -> None:
    """Nothing above the report may need it: the benchmark can be without a policy."""
    given = samples.make_run(tmp_path)
    states = dict.fromkeys(given.verdicts, "pass") | {"deploy": "stale"}
    others = {"summaries": given.summaries, "states": states}
    result = run_report(given, tmp_path / "out", **others)
    (failed,) = [check for check in result.checks if check.passed is False]
    assert (failed.name, failed.observed) == ("stages_not_passing", 1)
    assert "without one: deploy" in failed.why
    assert result.data["state"] == "fail"


def test_a_benchmark_without_a_policy_leaves_stages_missing(tmp_path: Path) -> None:
    given = samples.make_run(tmp_path)
    kept = {n: v for n, v in given.verdicts.items() if n in ("env-check", "plan", "carry")}
    kept["benchmark"] = given.verdicts["benchmark"]
    result = run_report(
        dataclasses.replace(given, verdicts=kept),
        tmp_path / "out",
        summaries=given.summaries,
    )
    failed = {check.name: check for check in result.checks if check.passed is False}
    assert "without one: teleop-record, train-act, deploy" in failed["stages_not_passing"].why
    assert result.data["state"] == "fail"


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
