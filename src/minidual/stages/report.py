"""`minidual report`: an offline page and JSON from the run's verdicts."""

from __future__ import annotations

from minidual.gate.stage import StageContext, StageResult
from minidual.show.report.model import ReportInput
from minidual.show.report.page import build_report
from minidual.trials.conditions import parse_conditions


def run(context: StageContext) -> StageResult:
    """Write report.html, report.json, figures and large films."""
    benchmark = context.config.benchmark
    given = ReportInput(
        title=context.config.report.title,
        stages=list(context.summaries.items()),
        verdicts=context.verdicts,
        folders=context.upstream,
        waivers=context.waivers,
        methods=benchmark.methods,
        acceptance=context.config.acceptance,
        profile=context.profile,
        seed=context.seed,
        conditions=parse_conditions(benchmark.conditions),
        code_changes=context.code_changes,
    )
    with context.progress.task("report", 1) as task:
        report = build_report(given, context.folder)
        task.advance()
    return StageResult(
        checks=report.checks, data={"state": report.state}, notes=[banner.title for banner in report.banners]
    )
