"""Results across verdicts: the policy on held-out starts, and the thinnest margins."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from minidual.gate.check import Check
from minidual.gate.verdict import Verdict
from minidual.show.report.tables import finite

_THINNEST_N = 5


class PolicyGap(NamedTuple):
    """Success rate of the policy on held-out starts, its 95 % interval, and on training starts."""

    held_out: float
    low: float
    high: float
    training: float


class Margin(NamedTuple):
    """A check with a limit.

    Attributes:
        stage: Its stage.
        check: The check.
        share_of_limit: Distance to the limit / limit; negative if the check failed.
    """

    stage: str
    check: Check
    share_of_limit: float


@dataclass(frozen=True)
class Analysis:
    """Conclusions over all stages.

    Attributes:
        gap: None without a deployed policy.
        sets: Summary of each set of the policy's trials, by condition; "held_out" is undisturbed.
        margins: Thinnest first.
        at_best_n: Number of passed checks at their best possible value; they are not ranked.
    """

    gap: PolicyGap | None
    sets: Mapping[str, Mapping[str, Any]]
    margins: Sequence[Margin]
    at_best_n: int


def analyse(verdicts: Mapping[str, Verdict]) -> Analysis:
    """Return the conclusions from the verdicts by stage."""
    margins = list(_margins(verdicts))
    ranked = [
        margin
        for margin in margins
        if margin.share_of_limit < 0.0 or not _at_its_best(margin.check)
    ]
    ranked.sort(key=lambda margin: margin.share_of_limit)
    deploy = verdicts.get("deploy")
    return Analysis(
        gap=None if deploy is None else _policy_gap(deploy),
        sets={} if deploy is None else _trial_sets(deploy),
        margins=ranked[:_THINNEST_N],
        at_best_n=len(margins) - len(ranked),
    )


def _margins(verdicts: Mapping[str, Verdict]) -> Iterator[Margin]:
    for stage, verdict in verdicts.items():
        for check in verdict.checks:
            if check.relative_margin is not None:
                yield Margin(stage, check, check.relative_margin)


def _at_its_best(check: Check) -> bool:
    """Return whether a passed check is exactly at its limit, or a rate is 100 %."""
    if check.margin == 0.0:
        return True
    if check.unit or check.limit is None or not 0.0 < check.limit <= 1.0:
        return False
    return check.op in (">", ">=") and check.observed == 1.0


def _policy_gap(deploy: Verdict) -> PolicyGap | None:
    values = {**deploy.data, **{check.name: check.observed for check in deploy.checks}}
    held_out = finite(values.get("success_rate"))
    low = finite(values.get("success_low"))
    high = finite(values.get("success_high"))
    training = finite(values.get("training_success_rate"))
    if held_out is None or low is None or high is None or training is None:
        return None
    return PolicyGap(held_out, low, high, training)


def _trial_sets(deploy: Verdict) -> dict[str, Mapping[str, Any]]:
    candidates = {"held_out": deploy.data, **deploy.data}
    return {
        name: candidate
        for name, candidate in candidates.items()
        if isinstance(candidate, Mapping) and "successes_n" in candidate
    }
