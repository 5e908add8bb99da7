"""Leading over a late network: nothing done about it, plain damping, TDPA, TDPA that takes back drift.

docs/link.md describes the experiment.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from minidual.show.report.bench import BenchRow, BenchTable
from scripts.bench.joint_wall import Arm, Course
from scripts.bench.passivity_figure import draw_passivity
from scripts.bench.tables import BenchInputs
from scripts.bench.wall_experiment import (
    contact_cases,
    groups,
    judge_contacts,
    run_contacts,
    run_traces,
    unstable,
)

FIGURE = Path("build/passivity.svg")
SHORT_MAX_MJ = 10.0
BOUNCES_MAX = 6
DRIFT_MAX_MM = 5.0
LATE = ("100 ms", "200 ms", "400 ms", "700 ms", "500 +- 100 ms, reordered")
"""Delays for which the goals hold."""
_LADDER = (100.0, 200.0, 400.0, 800.0, 1600.0)
"""Dampings that are tried [N s/m]."""
_TUNED_FOR = ("700 ms",)
_TUNING_TRACES_N = 20
_ARMS_N = 4

COLUMNS = (
    "unstable_pct",
    "bounces",
    "unsettled_pct",
    "press_n",
    "drift_mm",
    "leader_short_mj",
    "arms_short_mj",
    "active_pct",
)
_NOTES = (
    "unstable: share of the random traces that oscillate seconds after the hand rests, or are thrown",
    "bounces: most of a contact; unsettled: cases that leave the wall in the last second of a press",
    "press: median force at the wall; drift: most after the release of the last contact",
    "short: by how much the observed energy of a port was below zero, most; active: steps in which\n    the arms' port corrects",
)


def arms(damping: float) -> tuple[Arm, ...]:
    """Return the arms of the experiment."""
    return (
        Arm("nothing"),
        Arm(f"damping {damping:g} N s/m", damping=damping),
        Arm("TDPA", passive=True),
        Arm("TDPA, drift taken back", passive=True, compensates=True),
    )


def tuned_damping(traces_n: int, seed: int) -> float:
    """Return the least damping that is stable at the longest delay; the largest tried if none is."""
    tried = [Arm(f"{damping:g} N s/m", damping=damping) for damping in _LADDER]
    is_unstable = unstable(run_traces(tried, traces_n, seed, _TUNED_FOR))
    for damping, of_arm in zip(_LADDER, is_unstable.reshape(len(tried), -1), strict=True):
        if not of_arm.any():
            return damping
    return _LADDER[-1]


def measure(inputs: BenchInputs) -> BenchTable:
    """Run the experiment with `repeats_n` random traces a delay."""
    traces_n = inputs.repeats_n
    damping = tuned_damping(min(traces_n, _TUNING_TRACES_N), inputs.seed)
    inputs.advance(f"plain damping tuned for 700 ms: {damping:g} N s/m")
    compared = arms(damping)
    traces = run_traces(compared, traces_n, inputs.seed)
    inputs.advance("traces")
    contacts = run_contacts(compared, inputs.seed)
    inputs.advance("contacts")
    rows: list[BenchRow] = []
    for k, arm in enumerate(compared):
        rows += _rows(arm, _part(traces, k), _part(contacts, k), traces_n)
    FIGURE.parent.mkdir(exist_ok=True)
    courses = {arm.name: _part(traces, k) for k, arm in enumerate(compared)}
    draw_passivity(rows, courses, list(groups()), traces_n, FIGURE)
    title = (
        f"A joint led over a network against a wall of 90 kN/m: {traces_n} random traces a delay, "
        "ten contacts at each of two speeds"
    )
    return BenchTable(title, COLUMNS, tuple(rows), (*_NOTES, f"figure: {FIGURE}"))


def _part(course: Course, number: int) -> Course:
    """Return what belongs to one of the arms."""
    each = course.leader.shape[1] // _ARMS_N
    own = slice(number * each, (number + 1) * each)
    return Course(
        leader=course.leader[:, own],
        follower=course.follower[:, own],
        reference=course.reference[:, own],
        contact=course.contact[:, own],
        observed=course.observed[:, own],
        active=course.active[:, own],
        period_s=course.period_s,
    )


def _rows(arm: Arm, traces: Course, contacts: Course, traces_n: int) -> list[BenchRow]:
    names = list(groups())
    _, speeds = contact_cases(names)
    judged = judge_contacts(contacts, speeds)
    is_unstable = unstable(traces)
    rows: list[BenchRow] = []
    first = 0
    for g, name in enumerate(names):
        of_traces = slice(g * traces_n, (g + 1) * traces_n)
        cases_n = len(contact_cases([name])[0])
        of_contacts = slice(first, first + cases_n)
        first += cases_n
        numbers: dict[str, int | float] = {
            "unstable_pct": 100.0 * float(is_unstable[of_traces].mean()),
            "bounces": int(judged.bounces[of_contacts].max()),
            "unsettled_pct": 100.0 * float((~judged.settled[of_contacts]).mean()),
            "press_n": float(np.median(judged.press_n[of_contacts])),
            "drift_mm": 1e3 * float(judged.drift_m[of_contacts].max()),
            "leader_short_mj": _short_mj(traces, contacts, 0, of_traces, of_contacts),
            "arms_short_mj": _short_mj(traces, contacts, 1, of_traces, of_contacts),
            "active_pct": 100.0 * float(contacts.active[1, of_contacts].mean()),
        }
        rows.append(BenchRow(f"{arm.name}, {name}", numbers, _limits(arm, name)))
    return rows


def _short_mj(
    traces: Course, contacts: Course, port: int, of_traces: slice, of_contacts: slice
) -> float:
    """Return by how much the observed energy of a port was below zero, most [mJ]."""
    least = min(traces.observed[port, of_traces].min(), contacts.observed[port, of_contacts].min())
    return max(0.0, -1e3 * float(least))


def _limits(arm: Arm, name: str) -> dict[str, float]:
    """Return the goals of an arm that is to be stable at a delay."""
    if not arm.passive or name not in LATE:
        return {}
    limits = {"unstable_pct": 0.0, "bounces": float(BOUNCES_MAX), "unsettled_pct": 0.0}
    limits |= dict.fromkeys(("leader_short_mj", "arms_short_mj"), SHORT_MAX_MJ)
    if arm.compensates:
        limits["drift_mm"] = DRIFT_MAX_MM
    return limits
