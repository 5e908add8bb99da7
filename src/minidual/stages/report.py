"""`minidual report`: one offline page and its JSON, from the verdicts of the run alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from minidual.gate.stage import StageContext, StageResult

if TYPE_CHECKING:
    from minidual.config.root import Config


class ReportStage:
    """Gather the verdicts of the run into the page that people read."""

    name = "report"
    requires = ("benchmark",)
    summary = "Build the report from the verdicts: one offline HTML and report.json"

    def parameters(self, config: Config) -> dict[str, Any]:
        """Return the title, and the methods and conditions that the tables must hold."""
        benchmark = config.benchmark
        return {"report": config.report, "methods": benchmark.methods, "conditions": benchmark.conditions}

    def run(self, context: StageContext) -> StageResult:
        """Write report.html, report.json, the figures and the large films."""
        from minidual.show.report.build import build_report
        from minidual.show.report.model import ReportInput
        from minidual.stages.registry import STAGES
        from minidual.trials.conditions import parse_conditions

        names = STAGES.upstream(self.name)
        given = ReportInput(
            title=context.config.report.title,
            stages=[(name, STAGES[name].summary) for name in names],
            verdicts={name: context.verdicts[name] for name in names if name in context.verdicts},
            folders={name: context.upstream[name] for name in names if name in context.upstream},
            waivers=context.waivers,
            methods=context.config.benchmark.methods,
            acceptance=context.config.acceptance,
            profile=context.profile,
            seed=context.seed,
            conditions=parse_conditions(context.config.benchmark.conditions),
        )
        with context.progress.task("report", 1) as task:
            report = build_report(given, context.folder)
            task.advance()
        return StageResult(
            checks=report.checks,
            data={
                "state": report.state,
                "stages_passing": report.passing_stages,
                "stages": len(given.stages),
                "analysis": [text for passage in report.passages for text in passage.sentences],
            },
            notes=[banner.title for banner in report.banners],
        )


STAGE = ReportStage()
