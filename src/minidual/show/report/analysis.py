"""The analysis in words, every sentence drawn from the numbers of this run and from nothing else."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any

from minidual.gate.check import Check
from minidual.gate.verdict import Verdict
from minidual.show.report.captions import fault
from minidual.show.report.comparison import Comparison, MethodRow, finite
from minidual.show.report.disturbance import CERTAIN, corrected_pairs, sentences
from minidual.show.report.indicators import INDICATORS, Indicator
from minidual.show.report.robustness import ConditionTable
from minidual.show.report.trials import CLEAN, Trial, of_method
from minidual.show.report.wording import count, joined, percent, points, sentence, stated

_THINNEST = 5


@dataclass(frozen=True)
class Passage:
    """A heading and the sentences under it."""

    heading: str
    sentences: tuple[str, ...]


def analyse(
    verdicts: Mapping[str, Verdict],
    comparison: Comparison,
    trials: Sequence[Trial],
    conditions: ConditionTable | None = None,
) -> tuple[Passage, ...]:
    """Return the passages for which there are numbers, in the order in which they are read.

    Args:
        verdicts: Of the stages.
        comparison: Methods by indicators, undisturbed.
        trials: The undisturbed trials.
        conditions: Methods by conditions.
    """
    benchmark = verdicts.get("benchmark")
    paired = benchmark.data.get("comparisons", []) if benchmark else []
    passages = (
        Passage("Which method does what best", tuple(_methods(comparison, trials, paired))),
        Passage("What disturbances cost", tuple(sentences(conditions or ConditionTable(), paired))),
        Passage("What failed, and when", tuple(_failures(comparison, trials))),
        Passage("Held-out against training starts", tuple(_gap(verdicts.get("deploy")))),
        Passage("Where the margins are thinnest", tuple(_margins(verdicts))),
    )
    return tuple(passage for passage in passages if passage.sentences)


def _methods(comparison: Comparison, trials: Sequence[Trial], paired: Sequence[Any]) -> Iterator[str]:
    ranked = [row for row in comparison.rows if row.cell("success_rate").value is not None and row.has_interval]
    ranked.sort(key=lambda row: -(row.cell("success_rate").value or 0.0))
    if ranked:
        yield sentence("success: " + joined([_success_text(row) for row in ranked]))
    corrected = corrected_pairs(paired, disturbed=False)
    for first, second in combinations(ranked, 2):
        known = corrected.get((CLEAN, frozenset((first.method, second.method))))
        yield _separation(first, second, trials, known)
    for indicator in INDICATORS[1:]:
        yield from _ranking(indicator, comparison)
    yield from _faster_in_pairs(comparison, trials, paired)
    yield from _excellence(comparison)
    idle = [row.method for row in ranked if not row.competes]
    if idle:
        yield stated(
            f"{joined(idle)} did not complete a trial, so the other indicators of "
            f"{'it are' if len(idle) == 1 else 'them are'} shown but not ranked"
        )


def _success_text(row: MethodRow) -> str:
    return (
        f"{row.method} {row.successes} of {row.trials} "
        f"({percent(row.cell('success_rate').value or 0.0)}, 95 % interval {(row.low or 0.0) * 100:.0f} to {percent(row.high or 0.0)})"
    )


def _separation(first: MethodRow, second: MethodRow, trials: Sequence[Trial], corrected: float | None) -> str:
    """Say whether two success rates differ by more than the number of trials can blur, given the corrected probability."""
    from minidual.trials.statistics import compare_paired

    pair = f"{first.method} against {second.method}"
    a, b = _by_start(of_method(trials, first.method)), _by_start(of_method(trials, second.method))
    shared = sorted(a.keys() & b.keys())
    apart = (first.low or 0.0) > (second.high or 0.0)
    if not shared:
        return stated(
            f"{pair}: the intervals "
            + ("do not overlap, they differ" if apart else "overlap, these trials do not separate them")
        )
    paired = compare_paired([a[key].success for key in shared], [b[key].success for key in shared])
    starts = count(len(shared), "shared start")
    if paired.only_first_n + paired.only_second_n == 0:
        return stated(f"{pair}: the same outcome on each of {starts}")
    low, high = paired.rate_interval
    differ = (paired.p_value if corrected is None else corrected) < CERTAIN
    many = "uncorrected" if corrected is None else f"{corrected:.2g} corrected for the number of pairs"
    return stated(
        f"{pair}: of {starts}, {_won(paired.only_first_n, first.method)} and "
        f"{_won(paired.only_second_n, second.method)} (difference {points(paired.rate_difference)} points, 95 % interval "
        f"{points(low)} to {points(high)}, exact McNemar p = {paired.p_value:.2g}, {many}): "
        + ("they differ" if differ else "these trials do not separate them")
    )


def _won(n: int, method: str) -> str:
    return f"{count(n, 'start') if n else 'none'} went to {method} alone"


def _by_start(trials: Sequence[Trial]) -> dict[tuple[str, int], Trial]:
    return {(trial.condition, trial.index): trial for trial in trials}


def _ranking(indicator: Indicator, comparison: Comparison) -> Iterator[str]:
    measured = [row for row in comparison.rows if row.competes and row.cell(indicator.key).value is not None]
    if len(measured) < 2:
        return
    sign = 1.0 if indicator.better == "less" else -1.0
    measured.sort(key=lambda row: sign * (row.cell(indicator.key).value or 0.0))
    values = [indicator.with_unit(row.cell(indicator.key).value or 0.0) for row in measured]
    title = indicator.noun
    word = "lowest" if indicator.better == "less" else "highest"
    if len(set(values)) == 1:
        yield sentence(f"{title}: all methods alike, {values[0]}")
        return
    others = [f"{row.method} {value}" for row, value in zip(measured[1:], values[1:], strict=True)]
    yield sentence(f"{title}: {word} with {measured[0].method}, {values[0]}; {joined(others)}")


def _faster_in_pairs(comparison: Comparison, trials: Sequence[Trial], paired: Sequence[Any]) -> Iterator[str]:
    """Compare completion times start by start, where both methods completed."""
    timed = [row for row in comparison.rows if row.cell("duration_median_s").value is not None]
    timed.sort(key=lambda row: row.cell("duration_median_s").value or 0.0)
    for first, second in pairwise(timed):
        a = _by_start([t for t in of_method(trials, first.method) if t.success])
        b = _by_start([t for t in of_method(trials, second.method) if t.success])
        shared = a.keys() & b.keys()
        if shared:
            faster = sum(a[k].numbers["duration_s"] < b[k].numbers["duration_s"] for k in shared)
            yield sentence(
                f"where both completed, {first.method} was faster than {second.method} on {faster} of "
                f"{count(len(shared), 'start')}{_by_how_much(first.method, second.method, paired)}"
            )


def _by_how_much(first: str, second: str, paired: Sequence[Any]) -> str:
    """Return the median difference of completion time with its interval, as the benchmark's verdict has it."""
    names = ("duration_difference_s", "duration_difference_low_s", "duration_difference_high_s")
    for row in paired:
        if row.get("condition") != CLEAN or {row.get("first"), row.get("second")} != {first, second}:
            continue
        sign = -1.0 if row["first"] == first else 1.0
        numbers = [finite(row.get(name)) for name in names]
        if all(number is not None for number in numbers):
            middle, *ends = (sign * (number or 0.0) for number in numbers)
            if middle <= 0.0:  # medians of all trials and of the shared ones may disagree
                continue
            return f", by {middle:.2f} s (median difference, 95 % interval {min(ends):.2f} to {max(ends):.2f} s)"
    return ""


def _excellence(comparison: Comparison) -> Iterator[str]:
    for row in comparison.rows:
        if not row.competes:
            continue
        judged = [cell for cell in row.cells if cell.excellent is not None]
        short = [cell.indicator for cell in judged if not cell.excellent]
        if not judged:
            continue
        if not short:
            yield stated(f"{row.method} is excellent in all {count(len(judged), 'indicator')} that have such a limit")
        else:
            yield stated(
                f"{row.method} is excellent in {len(judged) - len(short)} of {len(judged)}; short of it in "
                + joined(
                    [f"{i.noun} ({i.with_unit(row.cell(i.key).value or 0.0)}, {i.excellent_text()})" for i in short]
                )
            )


def _failures(comparison: Comparison, trials: Sequence[Trial]) -> Iterator[str]:
    clean: list[str] = []
    for row in comparison.rows:
        failed = [trial for trial in of_method(trials, row.method) if not trial.success]
        reasons = Counter(trial.failure or "unnamed" for trial in failed) or Counter(dict(row.failures))
        if not reasons:
            if row.successes is not None and row.successes == row.trials:
                clean.append(row.method)
            continue
        total = sum(reasons.values())
        parts = []
        for reason, times in reasons.most_common(3):
            ended = [t.numbers["failed_at_s"] for t in failed if (t.failure or "unnamed") == reason]
            ended = [value for value in ended if value == value]
            when = f", at {statistics.median(ended):.1f} s" + (" (median)" if len(ended) > 1 else "") if ended else ""
            parts.append(f"{fault(reason)} {count(times, 'time')}{when}")
        others = total - sum(times for _reason, times in reasons.most_common(3))
        rest = f"; {others} for other reasons" if others else ""
        yield stated(f"{row.method} failed {total} of {row.trials}: {'; '.join(parts)}{rest}")
    if clean:
        yield stated(f"{joined(clean)} did not fail in a single trial")


def _gap(deploy: Verdict | None) -> Iterator[str]:
    if deploy is None:
        return
    known = {check.name: check.observed for check in deploy.checks}
    held_out = finite(known.get("success_rate"))
    training = finite(known.get("training_success_rate", deploy.data.get("training_success_rate")))
    if held_out is None:
        return
    text = f"on starts it never saw the policy succeeded in {percent(held_out)}"
    low, high = (finite(known.get(n, deploy.data.get(n))) for n in ("success_low", "success_high"))
    if low is not None:
        text += f" (95 % interval from {percent(low)}" + (f" to {percent(high)})" if high is not None else ")")
    yield sentence(text)
    if training is None:
        return
    gap = training - held_out
    text = f"on starts it was trained on, in {percent(training)}"
    if abs(gap) < 0.005:
        yield sentence(f"{text}: no gap")
    elif low is not None and high is not None and low <= training <= high:
        yield sentence(f"{text}: {abs(gap) * 100:.0f} points {'more' if gap > 0 else 'fewer'}, within the interval")
    else:
        yield sentence(
            f"{text}: {abs(gap) * 100:.0f} points {'more' if gap > 0 else 'fewer'}, outside the interval"
            + (", so more demonstrations or wider starts should pay" if gap > 0 else "")
        )


def relative_margin(check: Check) -> float | None:
    """Return the margin as a share of the limit; None where the check has no such margin."""
    if check.margin is None or not check.limit or check.op == "==":
        return None
    return finite(check.margin / abs(check.limit))


def _at_its_best(check: Check) -> bool:
    """Return whether a passed check has no room: exactly at its limit, or a share at 100 %."""
    if check.margin == 0.0:
        return True
    share = not check.unit and check.limit is not None and 0.0 < check.limit <= 1.0
    return share and check.op in (">", ">=") and check.observed == 1.0


def _margins(verdicts: Mapping[str, Verdict]) -> Iterator[str]:
    found: list[tuple[float, str, Check]] = []
    exact = 0
    for stage, verdict in verdicts.items():
        for check in verdict.checks:
            margin = relative_margin(check)
            if margin is None:
                continue
            if margin >= 0.0 and _at_its_best(check):
                exact += 1
            else:
                found.append((margin, stage, check))
    found.sort(key=lambda item: item[0])
    for margin, stage, check in found[:_THINNEST]:
        side = f"{percent(margin)} inside its limit" if margin >= 0 else f"{percent(-margin)} beyond its limit"
        yield stated(f"{stage}: {check.sentence()}: {side}")
    if exact:
        yield sentence(
            f"{count(exact, 'check')} stood at the best value there is or exactly at the limit, such as 100 % of "
            "the queries, where a margin says nothing"
        )
