"""Analysis: held-out starts, thinnest margins."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from minidual.gate.check import Check
from minidual.gate.verdict import Verdict
from minidual.show.report.tables import finite

_THINNEST = 5


@dataclass(frozen=True)
class Facts:
    """The analysis.

    Attributes:
        gap: Success of the policy on held-out starts, with 95 % interval, and on training starts.
        margins: Stage, check and share of its limit, thinnest first.
        at_best_n: Passed checks at their best value.
    """

    gap: dict[str, float] | None
    margins: list[dict[str, Any]]
    at_best_n: int


def gather(verdicts: Mapping[str, Verdict]) -> Facts:
    """Return the analysis."""
    ranked, at_best = list[dict[str, Any]](), 0
    for stage, check in [(stage, check) for stage, verdict in verdicts.items() for check in verdict.checks]:
        relative = check.relative_margin
        if relative is not None and relative >= 0.0 and _at_its_best(check):
            at_best += 1
        elif relative is not None:
            ranked.append({"stage": stage, "check": check, "share_of_limit": relative})
    return Facts(
        gap=_gap(verdicts.get("deploy")),
        margins=sorted(ranked, key=lambda margin: margin["share_of_limit"])[:_THINNEST],
        at_best_n=at_best,
    )


def _gap(deploy: Verdict | None) -> dict[str, float] | None:
    known = {} if deploy is None else {**deploy.data, **{check.name: check.observed for check in deploy.checks}}
    names = {
        "held_out": "success_rate",
        "low": "success_low",
        "high": "success_high",
        "training": "training_success_rate",
    }
    found = {key: number for key, name in names.items() if (number := finite(known.get(name))) is not None}
    return found if len(found) == len(names) else None


def _at_its_best(check: Check) -> bool:
    share = not check.unit and check.limit is not None and 0.0 < check.limit <= 1.0
    return check.margin == 0.0 or (share and check.op in (">", ">=") and check.observed == 1.0)
