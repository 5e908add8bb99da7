"""Build the report from verdicts and artefacts.

Equal verdicts give equal bytes: neither clock nor machine is read.
"""

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import jinja2

from minidual.errors import DataError
from minidual.gate.canonical import dumps
from minidual.gate.stage import StageContext
from minidual.show.report import wording
from minidual.show.report.figures import benchmark_figures, read_trials
from minidual.show.report.model import Medium, Report, collect_media
from minidual.show.report.tables import CERTAIN, INDICATORS, Cell, Tables, tabulate, three_digits
from minidual.trials.benchmark import limits_of, trials_asked
from minidual.trials.measures import MEASURES
from minidual.trials.methods import METHODS

TRIALS_FILE = "benchmark.csv"
_PAGES = jinja2.Environment(
    loader=jinja2.PackageLoader("minidual.show.report"),
    autoescape=True,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_FILTERS = ("commit", "duration", "fault", "joined", "moment", "percent", "points", "quantity")
_PAGES.filters |= {name: getattr(wording, name) for name in _FILTERS}


def build_report(given: StageContext, folder: Path) -> Report:
    """Write report.html, report.json and figures into `folder`.

    Raises:
        DataError: An artefact is missing or unreadable.
    """
    benchmark = given.verdicts.get("benchmark")
    wanted = given.config.benchmark
    media: list[Medium] = []
    try:
        for stage, verdict in given.verdicts.items():
            media += collect_media(verdict, given.upstream[stage], folder)
        data = benchmark.data["tasks"] if benchmark else {}
        asked = trials_asked(given.config).items()
        own = next(iter(trials_asked(given.config)))
        limits = {task: partial(limits_of, given.config, task) for task, _ in asked}
        tables = {
            task: tabulate(
                wanted.methods,
                tuple(under),
                data.get(task, {}),
                own=task == own,
                limit=limits[task],
            )
            for task, under in asked
        }
        trials = read_trials(given.upstream["benchmark"] / TRIALS_FILE) if benchmark else []
        figures = {
            k: benchmark_figures(table, [t for t in trials if t["task"] == k])
            for k, table in tables.items()
        }
        report = Report(given, tables, figures, media)
        content = dumps(document(report))
        page = render_page(report)
    except (
        LookupError,
        TypeError,
        ValueError,
        AttributeError,
        ArithmeticError,
        jinja2.UndefinedError,
    ) as error:
        damaged = (
            f"the data of a verdict, or {TRIALS_FILE}, is damaged: {type(error).__name__}: {error}"
        )
        raise DataError(damaged, remedy="minidual benchmark --force") from error
    (folder / "figures").mkdir()
    for task, drawn in figures.items():
        prefix = f"{task}-" if len(figures) > 1 else ""
        for figure in drawn:
            (folder / "figures" / f"{prefix}{figure.name}.svg").write_text(
                figure.svg,
                encoding="utf-8",
            )
    (folder / "report.json").write_text(content, encoding="utf-8")
    (folder / "report.html").write_text(page, encoding="utf-8")
    return report


def render_page(report: Report) -> str:
    """Return one self-contained HTML page."""
    return _PAGES.get_template("report.html.j2").render(
        report=report,
        indicators=INDICATORS,
        measures=MEASURES,
        digits=three_digits,
        certain=CERTAIN,
        summaries={
            name: METHODS[name].summary
            for name in report.given.config.benchmark.methods
            if name in METHODS
        },
    )


def document(report: Report) -> dict[str, Any]:
    """Return the report as JSON, without pictures."""
    given = report.given
    made = report.newest.fingerprint if report.newest else None
    margins = [{**margin, "check": margin["check"].name} for margin in report.facts["margins"]]
    head = {"schema": 4, "title": given.config.report.title, "state": report.state}
    head |= {"acceptance": report.state == "pass", "profile": given.profile, "seed": given.seed}
    return {
        **head,
        "banners": [banner._asdict() for banner in report.banners],
        "checks": [check.to_json() for check in report.shown_checks],
        "made_with": {
            n: getattr(made, n) for n in ("version", "commit", "machine", "libraries") if made
        },
        "total_s": report.total_s,
        "stages": [_stage(given, name) for name in given.summaries],
        "tasks": {task: _task(tables) for task, tables in report.tables.items()},
        "analysis": {**report.facts, "margins": margins},
    }


def _task(tables: Tables) -> dict[str, Any]:
    clean, *disturbed = tables.rows
    return {
        "comparison": {
            "missing": tables.missing(),
            "methods": {c.method: _cell(c, tables.own) for c in clean.cells},
        },
        "conditions": {
            row.condition: {
                "summary": row.summary,
                "methods": {c.method: _cell(c, tables.own) for c in row.cells},
            }
            for row in disturbed
        },
        "analysis": {name: getattr(tables, name) for name in ("pairs", "partings", "losses")},
    }


def _cell(cell: Cell, own: bool) -> dict[str, Any]:
    excellent = [indicator.key for indicator in INDICATORS if own and cell.excellent(indicator)]
    return {
        **asdict(cell),
        "failures": dict(cell.failures),
        "holes": cell.holes,
        "excellent": excellent,
    }


def _stage(given: StageContext, name: str) -> dict[str, Any]:
    if name not in given.verdicts:
        return {"name": name, "status": "missing"}
    record = given.verdicts[name].to_json()
    kept = ("status", "acceptance", "duration_s", "finished_at", "checks", "notes")
    return {"name": name, **{key: record[key] for key in kept}}
