"""Render one self-contained HTML page."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any

import jinja2

from minidual.gate.check import Check, Number, format_number
from minidual.show.report.content import Report
from minidual.show.report.facts import relative_margin
from minidual.show.report.indicators import INDICATORS
from minidual.show.report.paired import CERTAIN
from minidual.show.report.wording import duration, fault, joined, percent, points

_STATE_WORDS = {
    "pass": "Pass",
    "fail": "Fail",
    "weakened": "Weakened",
    "smoke": "Smoke: wiring only",
    "tainted": "Tainted",
}
_RESULT_WORDS = {True: "pass", False: "fail", None: "reported"}


@functools.cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("minidual.show.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(duration=duration, percent=percent, points=points, fault=fault)
    return environment


def render_page(report: Report) -> str:
    """Return the page's HTML."""
    environment = _environment()
    last = report.given.newest
    return environment.get_template("report.html.j2").render(
        report=report,
        given=report.given,
        facts=report.facts,
        style=environment.get_template("report.css").render(),
        state_word=_STATE_WORDS[report.state],
        tiles=_tiles(report),
        indicators=INDICATORS,
        certain=CERTAIN,
        stages=_stages(report),
        films=[medium for medium in report.media if medium.film],
        last=last,
        made=last.fingerprint if last else None,
    )


def _tiles(report: Report) -> list[tuple[str, str]]:
    every = [check for verdict in report.given.verdicts.values() for check in verdict.checks]
    limited = [check for check in (*every, *report.shown_checks) if check.limited]
    tiles = [
        (f"{report.passing_stages} of {len(report.given.stages)}", "stages pass"),
        (f"{sum(check.passed is True for check in limited)} of {len(limited)}", "checks inside their limits"),
        (duration(report.total_s), "for all stages"),
    ]
    rated = {cell.method: cell.success.value for cell in report.tables.clean.cells if cell.success is not None}
    if rated:
        top = max(rated.values())
        best = [method for method, rate in rated.items() if rate == top]
        tiles.append((percent(top), f"best success, {joined(best)}"))
    return tiles


def _stages(report: Report) -> list[dict[str, Any]]:
    shown: list[dict[str, Any]] = []
    for name, summary in report.given.stages:
        verdict = report.given.verdicts.get(name)
        row = _stage(name, summary, verdict.status if verdict else "missing", verdict.checks if verdict else ())
        if verdict is not None:
            share = verdict.duration_s / max(report.total_s, 1e-9)
            row |= {"duration": duration(verdict.duration_s), "share": share, "notes": verdict.notes}
        row["pictures"] = [medium for medium in report.media if medium.stage == name and not medium.film]
        shown.append(row)
    own = "fail" if report.state in ("fail", "tainted") else "pass"
    return [*shown, _stage("report", "Build this page from the verdicts", own, report.shown_checks)]


def _stage(name: str, summary: str, status: str, checks: Sequence[Check]) -> dict[str, Any]:
    limited = [check for check in checks if check.limited]
    held = f"{sum(check.passed is True for check in limited)} of {len(limited)} limits held" if limited else ""
    rows = [_check_row(check) for check in checks]
    blank = {"duration": "", "share": 0.0, "notes": (), "pictures": []}
    return {"name": name, "summary": summary, "status": status, "checks": rows, "held": held, **blank}


def _check_row(check: Check) -> dict[str, str]:
    relative = relative_margin(check)
    margin = ""
    if check.margin is not None and math.isfinite(check.margin) and check.op != "==":
        margin = f"{check.margin:+.3g}" + (f" ({relative:+.0%})" if relative is not None else "")
    return {
        "name": check.name,
        "why": check.why,
        "observed": _quantity(check.observed, check.unit),
        "limit": f"{check.op} {_quantity(check.limit, check.unit)}" if check.op else "",
        "margin": margin,
        "result": _RESULT_WORDS[check.passed],
        "remedy": check.remedy if check.passed is False else "",
    }


def _quantity(value: Number | None, unit: str) -> str:
    text = f"{format_number(value)} {unit}".rstrip()
    if unit == "rad" and isinstance(value, float) and math.isfinite(value) and abs(math.degrees(value)) >= 0.01:
        text += f" ({math.degrees(value):.3g}°)"
    return text
