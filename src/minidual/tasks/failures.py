"""Names of failures in words: which part of the success test a trial missed."""

from collections.abc import Mapping
from typing import NamedTuple

FAILURES: Mapping[str, str] = {
    "held": "grip lost",
    "rose": "object not lifted",
    "level": "object tilted too far",
    "arrived": "object not at its goal",
    "released": "object not released",
    "at_rest": "object not at rest",
    "on_time": "too late",
    "squeezed": "internal force lost",
    "whole": "object broken",
    "clear": "obstacle touched",
    "turned": "object points the wrong way",
    "exchanged": "object not handed over",
    "carried": "object dragged, or carried too low",
    "slow": "object too fast",
    "settled": "object let go in the air, or moved after its release",
    "brought": "object brought by the wrong hand",
    "inside": "object not wholly on its field",
    "aloft": "object too low at the end",
    "mated": "peg not inserted",
    "unfinished": "object never released at rest",
    "diverged": "simulation diverged",
    "singular": "arm stretched into a singular posture",
    "late_answer": "policy answered too late",
}
"""By the name of the violated condition, or of the error that ended the trial."""

_NO_PHASES = ("active",)
"""Phases that say only that a method was driving."""


class FailureName(NamedTuple):
    """A failure as the summaries count it: "arrived (release)".

    Attributes:
        condition: Name of the violated condition.
        phase: Phase of the method; "" where it has none that says more.
    """

    condition: str
    phase: str = ""

    @classmethod
    def parse(cls, text: str) -> "FailureName":
        """Return the parts of "condition (phase)"."""
        condition, _, rest = text.partition(" (")
        phase = rest.removesuffix(")")
        return cls(condition, "" if phase in _NO_PHASES else phase)


def failure_words(text: str) -> str:
    """Return a failure as the summaries count it in words: "grip lost (phase lift)"."""
    condition, phase = FailureName.parse(text)
    words = FAILURES.get(condition) or condition.replace("_", " ") or "unnamed"
    return f"{words} (phase {phase})" if phase else words


def of_limit(value: float, limit: float, unit: str) -> str:
    """Return how much of a least value was reached: "0 of 40 mm", "39.6 of 40 mm"."""
    is_close = 0.9 * limit < value
    return f"{value:.{1 if is_close else 0}f} of {limit:.0f} {unit}"
