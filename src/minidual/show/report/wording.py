"""Words of the report: its checks, captions and fault names, and numbers as text."""

import math
from collections.abc import Mapping, Sequence

from minidual.gate.check import Number, with_unit

CHECK_WORDS: Mapping[str, Mapping[str, str]] = {
    "missing_cells": {
        "why": "every method has every indicator as a finite number with its interval, undisturbed "
        "and under every condition that applies to it{missing}",
        "remedy": "run minidual benchmark again, with every method and condition that the tables "
        "should hold; if fewer were meant, name them with --set benchmark.tasks=..., "
        "benchmark.methods=... and benchmark.conditions=... (docs/report.md, Settings)",
    },
    "stages_not_passing": {
        "why": "a report is built on passing, fresh verdicts{without}",
        "remedy": "minidual status says what to run",
    },
}
"""Words of the report's own checks; see `checks_of`."""

CAPTIONS: Mapping[str, Mapping[str, str]] = {
    "env-check": {
        "sine.mp4": "All joints follow a sine",
        "cameras.png": "What each camera sees at home",
        "tracking.svg": "Step, sine and single joints: target against measurement",
    },
    "plan": {
        "paths.png": "One query a group: paths of the hands among the obstacles",
        "times.svg": "Planning times and their phases",
    },
    "carry": {
        "carry.mp4": "The median carry under object impedance control",
        "worst.mp4": "The worst carry: the first failure, or the largest tilt",
        "median.svg": "The median trial",
        "worst.svg": "The worst trial: the first failure, or the largest tilt",
    },
    "teleop-record": {
        "demonstration.mp4": "A recorded demonstration",
        "quality.svg": "Quality of every episode",
    },
    "train-act": {
        "loss.svg": "Training and validation loss",
    },
    "deploy": {
        "success.mp4": "The policy succeeds on a start held out from training",
        "occlusion.png": "Where the policy looks, at the first tick of a trial",
        "failure.mp4": "The policy fails on a start held out from training",
    },
}
"""Captions of pictures and films by stage and file."""

_LEAST_DEGREES = 0.01


def joined(items: Sequence[str]) -> str:
    """Return "a, b and c"."""
    if len(items) <= 1:
        return "".join(items)
    return f"{', '.join(items[:-1])} and {items[-1]}"


def moment(stamp: str) -> str:
    """Return an ISO time as "2026-01-31 12:00:00 UTC"."""
    return stamp.replace("T", " ").replace("Z", " UTC")


def commit(name: str | None) -> str:
    """Return the short name of a commit, with its mark of uncommitted changes."""
    identifier, plus, changes = (name or "unknown").partition("+")
    return identifier[:10] + plus + changes


def duration(seconds: float) -> str:
    """Return e.g. "4 min 05 s"."""
    if seconds < 59.95:
        return f"{seconds:.1f} s"
    minutes, whole_seconds = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {whole_seconds:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"


def percent(share: float) -> str:
    """Return "85 %"; one decimal below 1 % and above 99 %."""
    is_near_an_end = 0.0 < share < 0.01 or 0.99 < share < 1.0
    decimals = 1 if is_near_an_end else 0
    return f"{share * 100:.{decimals}f} %"


def points(difference: float) -> str:
    """Return a difference of rates in percentage points: "+5", "0", "−12"."""
    whole = round(100.0 * difference)
    if whole == 0:
        return "0"
    return f"{whole:+d}".replace("-", "\u2212")


def quantity(value: Number | None, unit: str) -> str:
    """Return a value with its unit, angles in degrees too."""
    text = with_unit(value, unit)
    if unit != "rad" or not isinstance(value, float) or not math.isfinite(value):
        return text
    degrees = math.degrees(value)
    if abs(degrees) < _LEAST_DEGREES:
        return text
    return f"{text} ({degrees:.3g}°)"
