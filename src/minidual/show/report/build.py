"""Build the report: the page, its JSON and its figures, from verdicts and artefacts alone.

Nothing here looks at the clock or at the machine, so the same verdicts give the same bytes.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from minidual.gate.canonical import dumps
from minidual.gate.check import Check
from minidual.show.report import model
from minidual.show.report.analysis import Passage, analyse
from minidual.show.report.comparison import Comparison, compare
from minidual.show.report.condition_figure import condition_figure
from minidual.show.report.figures import Figure, benchmark_figures
from minidual.show.report.media import Medium, collect_media
from minidual.show.report.robustness import ConditionCell, ConditionTable, tabulate
from minidual.show.report.trials import Trial, read_trials, undisturbed

PAGE_FILE = "report.html"
JSON_FILE = "report.json"
FIGURES_FOLDER = "figures"
TRIALS_FILE = "benchmark.csv"


@dataclass(frozen=True)
class Report:
    """Everything on the page."""

    given: model.ReportInput
    state: model.OverallState
    banners: tuple[model.Banner, ...]
    checks: tuple[Check, ...]
    comparison: Comparison
    conditions: ConditionTable
    trials: tuple[Trial, ...]
    passages: tuple[Passage, ...]
    figures: tuple[Figure, ...]
    condition_figure: Figure | None
    media: tuple[Medium, ...]

    @property
    def passing_stages(self) -> int:
        """Number of stages with a passing verdict."""
        return len(self.given.stages) - len(self.given.not_passing())

    @property
    def shown_checks(self) -> list[Check]:
        """The report's own checks and, where a gate was waived, the one that the gate adds to its verdict."""
        waived = len(self.given.all_waivers())
        why = "evidence behind a waived gate is no acceptance"
        return [*self.checks, *([Check("gate.waivers", waived, "==", 0, why=why)] if waived else [])]

    @property
    def limited_checks(self) -> list[Check]:
        """Every check with a limit, of the stages and of the report."""
        every = [check for verdict in self.given.verdicts.values() for check in verdict.checks]
        return [check for check in (*every, *self.shown_checks) if check.limited]

    @property
    def total_s(self) -> float:
        """Wall time of all stages together."""
        return sum(verdict.duration_s for verdict in self.given.verdicts.values())


def build_report(given: model.ReportInput, folder: Path) -> Report:
    """Write report.html, report.json and the figures into `folder` and return what they say.

    Raises:
        DataError: an artefact that the report needs is gone or cannot be read.
    """
    from minidual.show.report.page import render_page

    benchmark = given.verdicts.get("benchmark")
    data = benchmark.data if benchmark else {}
    comparison = compare(given.methods, data)
    conditions = tabulate(given.methods, given.conditions, data)
    trials = undisturbed(read_trials(given.folders["benchmark"] / TRIALS_FILE)) if benchmark else []
    checks = model.report_checks(given, comparison, conditions)
    report = Report(
        given=given,
        state=model.overall_state(given, checks),
        banners=model.banners(given, checks),
        checks=tuple(checks),
        comparison=comparison,
        conditions=conditions,
        trials=tuple(trials),
        passages=analyse(given.verdicts, comparison, trials, conditions),
        figures=tuple(benchmark_figures(comparison, trials)),
        condition_figure=condition_figure(conditions),
        media=tuple(_media(given, folder)),
    )
    _write_figures(report, folder / FIGURES_FOLDER)
    (folder / JSON_FILE).write_text(dumps(document(report)), encoding="utf-8")
    (folder / PAGE_FILE).write_text(render_page(report), encoding="utf-8")
    return report


def _media(given: model.ReportInput, folder: Path) -> list[Medium]:
    media: list[Medium] = []
    for stage, _summary in given.stages:
        if stage in given.verdicts:
            verdict = given.verdicts[stage]
            captions = verdict.data.get("captions", {})
            media += collect_media(stage, given.folders[stage], verdict.artefacts, captions, folder)
    return media


def _write_figures(report: Report, folder: Path) -> None:
    folder.mkdir()
    for figure in (*report.figures, *([report.condition_figure] if report.condition_figure else [])):
        (folder / f"{figure.name}.svg").write_text(figure.svg, encoding="utf-8")


def document(report: Report) -> dict[str, Any]:
    """Return the report as JSON types: what the page shows, without pictures."""
    given = report.given
    made = model.made_with(given)
    return {
        "schema": 1,
        "title": given.title,
        "state": report.state,
        "acceptance": report.state == "pass",
        "profile": given.profile,
        "seed": given.seed,
        "banners": [asdict(banner) for banner in report.banners],
        "checks": [check.to_json() for check in report.shown_checks],
        "made_with": None
        if made is None
        else {"version": made.version, "commit": made.commit, "machine": made.machine, "libraries": made.libraries},
        "total_s": report.total_s,
        "stages": [_stage(given, name) for name, _summary in given.stages],
        "comparison": {
            "missing": report.comparison.missing() + report.conditions.missing(),
            "methods": {
                row.method: {
                    "trials": row.trials,
                    "success_low": row.low,
                    "success_high": row.high,
                    "failures": dict(row.failures),
                    **{
                        cell.indicator.key: {
                            "value": cell.value,
                            "state": cell.state,
                            "excellent": cell.excellent,
                            "median": cell.middle,
                            "low": cell.low,
                            "high": cell.high,
                        }
                        for cell in row.cells
                    },
                }
                for row in report.comparison.rows
            },
        },
        "conditions": {
            row.condition: {"summary": row.summary, "methods": {c.method: _condition(c) for c in row.cells}}
            for row in report.conditions.rows
        },
        "analysis": [asdict(passage) for passage in report.passages],
    }


def _condition(cell: ConditionCell) -> dict[str, Any]:
    if cell.state != "measured":
        return {"state": cell.state, "why": cell.why}
    return {
        "state": cell.state,
        "trials": cell.trials,
        "success": {"value": cell.rate, "low": cell.low, "high": cell.high},
        "loss": None if cell.loss is None else asdict(cell.loss),
        "failures": dict(cell.failures),
        "stopped": cell.stopped,
        **{key: None if m is None else asdict(m) for key, m in cell.measures.items()},
    }


def _stage(given: model.ReportInput, name: str) -> dict[str, Any]:
    verdict = given.verdicts.get(name)
    if verdict is None:
        return {"name": name, "status": "missing"}
    return {
        "name": name,
        "status": verdict.status,
        "acceptance": verdict.acceptance,
        "duration_s": verdict.duration_s,
        "finished_at": verdict.finished_at,
        "checks": [check.to_json() for check in verdict.checks],
        "notes": list(verdict.notes),
    }
