"""Build the report from verdicts and artefacts.

It reads neither clock nor machine: equal verdicts give equal bytes.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from minidual.gate.canonical import dumps
from minidual.show.report import model
from minidual.show.report.content import Report
from minidual.show.report.facts import gather, read_trials
from minidual.show.report.figures import benchmark_figures, condition_figure
from minidual.show.report.indicators import INDICATORS
from minidual.show.report.media import Medium, collect_media
from minidual.show.report.page import render_page
from minidual.show.report.tables import Cell, tabulate
from minidual.trials.conditions import CLEAN

TRIALS_FILE = "benchmark.csv"


def build_report(given: model.ReportInput, folder: Path) -> Report:
    """Write report.html, report.json and figures into `folder`.

    Raises:
        DataError: An artefact is missing or unreadable.
    """
    benchmark = given.verdicts.get("benchmark")
    tables = tabulate(given.methods, given.conditions, benchmark.data if benchmark else {})
    rows = read_trials(given.folders["benchmark"] / TRIALS_FILE) if benchmark else []
    trials = [trial for trial in rows if trial.condition == CLEAN]
    checks = model.report_checks(given, tables)
    media: list[Medium] = []
    for stage, verdict in given.verdicts.items():
        captions = verdict.data.get("captions", {})
        media += collect_media(stage, given.folders[stage], verdict.artefacts, captions, folder)
    report = Report(
        given=given,
        state=model.overall_state(given, checks),
        banners=model.banners(given, checks),
        checks=tuple(checks),
        tables=tables,
        facts=gather(given.verdicts, tables, trials),
        figures=tuple(benchmark_figures(tables, trials)),
        condition_figure=condition_figure(tables),
        media=tuple(media),
    )
    figures = folder / "figures"
    figures.mkdir()
    for figure in (*report.figures, report.condition_figure):
        if figure is not None:
            (figures / f"{figure.name}.svg").write_text(figure.svg, encoding="utf-8")
    (folder / "report.json").write_text(dumps(document(report)), encoding="utf-8")
    (folder / "report.html").write_text(render_page(report), encoding="utf-8")
    return report


def document(report: Report) -> dict[str, Any]:
    """Return the report as JSON, without pictures."""
    given, facts = report.given, report.facts
    made = asdict(given.newest.fingerprint) if given.newest else {}
    clean, *disturbed = report.tables.rows
    margins = [{"stage": m.stage, "check": m.check.name, "share_of_limit": m.relative} for m in facts.margins]
    return {
        "schema": 2,
        "title": given.title,
        "state": report.state,
        "acceptance": report.state == "pass",
        "profile": given.profile,
        "seed": given.seed,
        "banners": [asdict(banner) for banner in report.banners],
        "checks": [check.to_json() for check in report.shown_checks],
        "made_with": {name: made[name] for name in ("version", "commit", "machine", "libraries") if name in made},
        "total_s": report.total_s,
        "stages": [_stage(given, name) for name, _summary in given.stages],
        "comparison": {"missing": report.tables.missing(), "methods": {c.method: _cell(c) for c in clean.cells}},
        "conditions": {
            row.condition: {"summary": row.summary, "methods": {c.method: _cell(c) for c in row.cells}}
            for row in disturbed
        },
        "analysis": {**asdict(facts), "margins": margins},
    }


def _cell(cell: Cell) -> dict[str, Any]:
    excellent = [indicator.key for indicator in INDICATORS if cell.excellent(indicator)]
    return {**asdict(cell), "failures": dict(cell.failures), "excellent": excellent}


def _stage(given: model.ReportInput, name: str) -> dict[str, Any]:
    if name not in given.verdicts:
        return {"name": name, "status": "missing"}
    record = given.verdicts[name].to_json()
    kept = ("status", "acceptance", "duration_s", "finished_at", "checks", "notes")
    return {"name": name, **{key: record[key] for key in kept}}
