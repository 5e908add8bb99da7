"""Build the report from verdicts and artefacts.

Equal verdicts, and an equal bench.json if there is one, give equal bytes: neither clock nor machine
is read.
"""

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jinja2

from minidual.errors import DataError
from minidual.gate.canonical import dumps
from minidual.gate.stage import StageContext
from minidual.policies.architectures import Architecture, architecture
from minidual.show.report import wording
from minidual.show.report.analysis import Analysis
from minidual.show.report.bench import BENCH_FILE, read_bench
from minidual.show.report.figures import benchmark_figures, read_trials
from minidual.show.report.indicators import INDICATORS, three_digits
from minidual.show.report.media import collect_media
from minidual.show.report.model import Report
from minidual.show.report.sentences import evidence, headline_sentences
from minidual.show.report.tables import CERTAIN, Cell, Row, Tables, tabulate
from minidual.show.report.words import Words
from minidual.trials.benchmark import limits_of, trials_asked
from minidual.trials.measures import MEASURES
from minidual.trials.methods import METHODS

TRIALS_FILE = "benchmark.csv"
_SCHEMA = 5

_DAMAGED = (
    LookupError,
    TypeError,
    ValueError,
    AttributeError,
    ArithmeticError,
    jinja2.UndefinedError,
)
"""Raised while damaged data is read; the verdict's own schema does not cover `data`."""

_PAGES = jinja2.Environment(
    loader=jinja2.PackageLoader("minidual.show.report"),
    autoescape=True,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_PAGES.filters |= {
    "commit": wording.commit,
    "duration": wording.duration,
    "evidence": evidence,
    "moment": wording.moment,
    "percent": wording.percent,
    "points": wording.points,
    "quantity": wording.quantity,
}


def build_report(context: StageContext, folder: Path) -> Report:
    """Write report.html, report.json and figures into `folder`.

    Raises:
        DataError: An artefact is missing or unreadable.
    """
    try:
        report = _gather(context, folder)
        content = dumps(document(report))
        page = render_page(report)
    except _DAMAGED as error:
        raise DataError(
            f"the data of a verdict, or {TRIALS_FILE}, is damaged: {type(error).__name__}: {error}",
            remedy="minidual benchmark --force",
        ) from error
    _write_figures(report, folder / "figures")
    (folder / "report.json").write_text(content, encoding="utf-8")
    (folder / "report.html").write_text(page, encoding="utf-8")
    return report


def _gather(context: StageContext, folder: Path) -> Report:
    """Return the report's content; large films are copied into `folder`."""
    words = Words(context.config.report.language)
    media = [
        medium
        for stage, verdict in context.verdicts.items()
        for medium in collect_media(verdict, context.upstream[stage], folder, words)
    ]
    tables = _tables(context)
    benchmark = context.verdicts.get("benchmark")
    trials = read_trials(context.upstream["benchmark"] / TRIALS_FILE) if benchmark else []
    figures = {}
    for task, of_task in tables.items():
        own_trials = [trial for trial in trials if trial["task"] == task]
        figures[task] = benchmark_figures(of_task, own_trials, words)
    bench = read_bench(context.folder.parent / BENCH_FILE)
    data = benchmark.data["tasks"] if benchmark else {}
    headlines = headline_sentences({task: data[task] for task in tables if task in data}, words)
    return Report(context, tables, figures, media, bench, headlines)


def _tables(context: StageContext) -> dict[str, Tables]:
    """Return the tables of every task that the benchmark was asked for; the first is the run's own."""
    benchmark = context.verdicts.get("benchmark")
    data = benchmark.data["tasks"] if benchmark else {}
    requested = trials_asked(context.config)
    own_task = next(iter(requested))
    return {
        task: tabulate(
            context.config.benchmark.methods,
            tuple(trials_by_condition),
            data.get(task, {}),
            own=task == own_task,
            limit=partial(limits_of, context.config, task),
        )
        for task, trials_by_condition in requested.items()
    }


def _write_figures(report: Report, folder: Path) -> None:
    folder.mkdir()
    for task, figures in report.figures.items():
        prefix = f"{task}-" if len(report.figures) > 1 else ""
        for figure in figures:
            (folder / f"{prefix}{figure.name}.svg").write_text(figure.svg, encoding="utf-8")


def render_page(report: Report) -> str:
    """Return one self-contained HTML page."""
    words = report.words
    return _PAGES.get_template("report.html.j2").render(
        report=report,
        words=words,
        t=words,
        indicators=INDICATORS,
        measures=MEASURES,
        digits=three_digits,
        certain=CERTAIN,
        described={name: _described(report, name) for name in _methods(report.context)},
    )


class MethodDescription(NamedTuple):
    """A method in words.

    Attributes:
        title: Its name; of one that drives the trained policy, with the name of the network.
        summary: What drives the arms, or "".
        beside: What was measured of its network beside another one, or "".
    """

    title: str
    summary: str = ""
    beside: str = ""


def _methods(context: StageContext) -> tuple[str, ...]:
    return tuple(context.config.benchmark.methods)


def _described(report: Report, method: str) -> MethodDescription:
    """Return a method in words; one that the table of methods does not have is named only."""
    if method not in METHODS:
        return MethodDescription(method)
    words = report.words
    spec = METHODS[method]
    network = _network(report.context)
    titles = [f"{task}: {spec.title(task)}" for task in report.tables if spec.title(task)]
    summary = "; ".join([words.method(method, spec.summary), *titles])
    is_named = method in report.context.config.benchmark.policies
    drives_network = spec.learned and spec.trainer is None and not is_named
    if not drives_network or network is None:
        return MethodDescription(method, summary)
    if network.summary and words.is_source:
        summary = f"{summary}: {network.summary}"
    beside = words("beside", text=network.beside) if network.beside and words.is_source else ""
    return MethodDescription(f"{method} ({network.name})", summary, beside)


def _network(context: StageContext) -> Architecture | None:
    """Return the network that train-act trained, or None without its verdict."""
    trained = context.verdicts.get("train-act")
    name = trained.data.get("architecture", "") if trained else ""
    return architecture(name) if name else None


def document(report: Report) -> dict[str, Any]:
    """Return the report as JSON, without pictures."""
    context = report.context
    return {
        "schema": _SCHEMA,
        "title": context.config.report.title,
        "state": report.state,
        "headlines": list(report.headlines),
        "acceptance": report.state == "pass",
        "profile": context.profile,
        "seed": context.seed,
        "banners": [banner._asdict() for banner in report.banners],
        "checks": [check.to_json() for check in report.shown_checks],
        "made_with": _made_with(report),
        "total_s": report.total_s,
        "stages": [_stage(context, name) for name in context.summaries],
        "tasks": {task: _task(tables) for task, tables in report.tables.items()},
        "analysis": _analysis(report.analysis),
        "bench": None if report.bench is None else asdict(report.bench),
    }


def _made_with(report: Report) -> dict[str, Any]:
    if report.newest is None:
        return {}
    fingerprint = report.newest.fingerprint
    return {
        "version": fingerprint.version,
        "commit": fingerprint.commit,
        "machine": fingerprint.machine,
        "libraries": fingerprint.libraries,
    }


def _stage(context: StageContext, name: str) -> dict[str, Any]:
    if name not in context.verdicts:
        return {"name": name, "status": "missing"}
    record = context.verdicts[name].to_json()
    kept = ("status", "acceptance", "duration_s", "finished_at", "checks", "notes")
    return {"name": name, **{key: record[key] for key in kept}}


def _task(tables: Tables) -> dict[str, Any]:
    clean, *disturbed = tables.rows
    return {
        "comparison": {
            "missing": tables.missing(),
            "methods": _cells(clean, tables.own),
        },
        "conditions": {
            row.condition: {"summary": row.summary, "methods": _cells(row, tables.own)}
            for row in disturbed
        },
        "analysis": {
            "pairs": tables.pairs,
            "partings": tables.partings,
            "losses": tables.losses,
        },
    }


def _cells(row: Row, own: bool) -> dict[str, Any]:
    return {cell.method: _cell(cell, own) for cell in row.cells}


def _cell(cell: Cell, own: bool) -> dict[str, Any]:
    """Return one cell; `own`: whether the limits of "excellent" were set for its task."""
    excellent = [indicator.key for indicator in INDICATORS if own and cell.excellent(indicator)]
    return {
        **asdict(cell),
        "failures": dict(cell.failures),
        "holes": cell.holes,
        "excellent": excellent,
    }


def _analysis(analysis: Analysis) -> dict[str, Any]:
    margins = [
        {
            "stage": margin.stage,
            "check": margin.check.name,
            "share_of_limit": margin.share_of_limit,
        }
        for margin in analysis.margins
    ]
    return {
        "gap": None if analysis.gap is None else analysis.gap._asdict(),
        "sets": analysis.sets,
        "margins": margins,
        "at_best_n": analysis.at_best_n,
    }
