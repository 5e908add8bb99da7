"""`minidual report`: an offline page and JSON from the run's verdicts."""

from minidual.gate.stage import StageContext, StageResult
from minidual.show.report.page import build_report


def run(context: StageContext) -> StageResult:
    """Write report.html, report.json, figures and large films."""
    report = build_report(context, context.folder)
    return StageResult(
        checks=report.checks,
        data={"state": report.state},
        notes=[b.title for b in report.banners],
    )
