"""Lay the report out as one HTML page that needs nothing from outside its folder."""

from __future__ import annotations

import functools
import math
from typing import Any

from minidual.gate.check import Check, format_number
from minidual.show.report import model
from minidual.show.report.analysis import relative_margin
from minidual.show.report.build import Report
from minidual.show.report.disturbance import CERTAIN
from minidual.show.report.indicators import INDICATORS
from minidual.show.report.wording import duration, percent, points

_STATE_WORDS = {"pass": "Pass", "fail": "Fail", "smoke": "Smoke: wiring only", "tainted": "Tainted"}
_RESULT_WORDS = {True: "pass", False: "fail", None: "reported"}


@functools.cache
def _environment() -> Any:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("minidual.show.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(duration=duration, percent=percent, points=points)
    return environment


def render_page(report: Report) -> str:
    """Return the page's HTML."""
    environment = _environment()
    given = report.given
    last = model.newest(given)
    return environment.get_template("report.html.j2").render(
        report=report,
        given=given,
        style=environment.get_template("report.css").render(),
        state_word=_STATE_WORDS[report.state],
        tiles=_tiles(report),
        indicators=INDICATORS,
        certain=CERTAIN,
        stages=_stages(report),
        films=[medium for medium in report.media if medium.film],
        run=last.run if last else "",
        finished_at=last.finished_at if last else "",
        made=model.made_with(given),
    )


def _tiles(report: Report) -> list[tuple[str, str]]:
    """Return (number, words) of what a reader wants to know first."""
    limited = report.limited_checks
    tiles = [
        (f"{report.passing_stages} of {len(report.given.stages)}", "stages pass"),
        (f"{sum(check.passed is True for check in limited)} of {len(limited)}", "checks inside their limits"),
        (duration(report.total_s), "for all stages"),
    ]
    rated = [row for row in report.comparison.rows if row.cell("success_rate").value is not None]
    if rated:
        top = max(row.cell("success_rate").value or 0.0 for row in rated)
        names = [row.method for row in rated if row.cell("success_rate").value == top]
        tiles.append((percent(top), f"best success, {' and '.join(names[:2]) if len(names) < 3 else 'every method'}"))
    return tiles


def _stages(report: Report) -> list[dict[str, Any]]:
    """Return what the page shows of every stage, the report itself last."""
    shown: list[dict[str, Any]] = []
    total_s = max(report.total_s, 1e-9)
    for name, summary in report.given.stages:
        verdict = report.given.verdicts.get(name)
        checks = verdict.checks if verdict else ()
        shown.append(
            {
                "name": name,
                "summary": summary,
                "status": verdict.status if verdict else "missing",
                "duration": duration(verdict.duration_s) if verdict else "",
                "share": verdict.duration_s / total_s if verdict else 0.0,
                "finished_at": verdict.finished_at if verdict else "",
                "notes": verdict.notes if verdict else (),
                "checks": [_check_row(check) for check in checks],
                "held": _held(checks),
                "pictures": [m for m in report.media if m.stage == name and not m.film],
            }
        )
    shown.append(
        {
            "name": "report",
            "summary": "Build this page from the verdicts",
            "status": "fail" if report.state in ("fail", "tainted") else "pass",
            "duration": "",
            "share": 0.0,
            "finished_at": "",
            "notes": (),
            "checks": [_check_row(check) for check in report.shown_checks],
            "held": _held(report.shown_checks),
            "pictures": [],
        }
    )
    return shown


def _held(checks: Any) -> str:
    limited = [check for check in checks if check.limited]
    held = sum(check.passed is True for check in limited)
    return f"{held} of {len(limited)} limits held" if limited else ""


def _check_row(check: Check) -> dict[str, str]:
    """Return one row of a stage's table as text."""
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


def _quantity(value: float | int | bool | None, unit: str) -> str:
    text = format_number(value)
    if not unit:
        return text
    text = f"{text} {unit}"
    if unit == "rad" and isinstance(value, float) and math.isfinite(value) and abs(math.degrees(value)) >= 0.01:
        text += f" ({math.degrees(value):.3g}°)"
    return text
