"""The indicators by which methods are compared, and how each is shown to people."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

_UNSEEN = 0.0005
"""What is smaller, in the unit that people see, is rounding: the tilt of a rod that nobody lifted."""


@dataclass(frozen=True)
class Indicator:
    """One column of the comparison.

    Attributes:
        key: Name in the benchmark's data, with its SI unit.
        column: Name of the same quantity in a row of benchmark.csv; None where a row has none.
        title: Name for people.
        unit: Unit that people see.
        scale: From the SI value to the unit that people see.
        better: Whether less or more of it is better.
        excellent: Limit of "excellent" as an SI value; None without one.
        needs_success: It exists only if a trial succeeded: nothing completed has no completion time.
        meaning: One line for the table's legend.
        middle: Name in the benchmark's data of the median over trials, of success its rate; `key` may be the largest.
        low: Name of the lower end of its 95 % interval.
        high: Name of the upper end.
    """

    key: str
    column: str | None
    title: str
    unit: str
    scale: float
    better: Literal["less", "more"]
    excellent: float | None
    needs_success: bool
    meaning: str
    middle: str
    low: str
    high: str

    @property
    def noun(self) -> str:
        """The title inside a sentence: "completion time", "RMS jerk"."""
        return self.title if self.title[:2].isupper() else self.title[0].lower() + self.title[1:]

    def shown(self, value: float) -> str:
        """Return `value` in the unit that people see, without the unit."""
        if self.unit == "%":
            return f"{value * 100:.0f}"
        seen = value * self.scale
        return "0.000" if 0.0 < abs(seen) < _UNSEEN else three_digits(seen)

    def range(self, low: float, high: float) -> str:
        """Return "5.92 to 5.98" in the unit that people see."""
        return f"{self.shown(low)} to {self.shown(high)}"

    def with_unit(self, value: float) -> str:
        """Return `value` with its unit."""
        return f"{self.shown(value)} {self.unit}"

    def is_excellent(self, value: float) -> bool | None:
        """Return whether `value` is on the good side of the excellent limit; None without a limit."""
        if self.excellent is None:
            return None
        return value < self.excellent if self.better == "less" else value > self.excellent

    def excellent_text(self) -> str:
        """Return the excellent limit for people, "" without one."""
        if self.excellent is None:
            return ""
        return f"{'<' if self.better == 'less' else '>'} {self.excellent * self.scale:g} {self.unit}"


def three_digits(value: float) -> str:
    """Return `value` with three significant digits, without exponents for what people meet here."""
    if abs(value) >= 1000:
        return f"{value:,.0f}"
    text = f"{value:#.3g}".removesuffix(".")
    return text if "e" not in text else f"{value:.1e}"


_DEGREES = 180.0 / math.pi

# The limits of "excellent" are those of the tutorial that the pipeline follows (day 11).
INDICATORS: tuple[Indicator, ...] = (
    Indicator(
        "success_rate",
        None,
        "Success",
        "%",
        100.0,
        "more",
        0.8,
        False,
        "share of trials that passed the whole success test, with its 95 % Wilson interval",
        "success_rate",
        "success_low",
        "success_high",
    ),
    Indicator(
        "duration_median_s",
        "duration_s",
        "Completion time",
        "s",
        1.0,
        "less",
        10.0,
        True,
        "median of the successful trials, from start to the rod released at its goal",
        "duration_median_s",
        "duration_low_s",
        "duration_high_s",
    ),
    Indicator(
        "torque_ratio_max",
        "torque_ratio_max",
        "Peak torque",
        "% of limit",
        100.0,
        "less",
        0.8,
        False,
        "largest motor torque over its limit, over joints, time and trials",
        "torque_ratio_median",
        "torque_ratio_low",
        "torque_ratio_high",
    ),
    Indicator(
        "jerk_rms_median",
        "jerk_rms",
        "RMS jerk",
        "rad/s³",
        1.0,
        "less",
        100.0,
        False,
        "third derivative of the 14 measured joints after a low-pass, median over trials",
        "jerk_rms_median",
        "jerk_rms_low",
        "jerk_rms_high",
    ),
    Indicator(
        "tilt_max_rad",
        "tilt_max_rad",
        "Largest tilt",
        "deg",
        _DEGREES,
        "less",
        math.radians(5.0),
        False,
        "largest angle between the rod and the horizontal, over time and trials",
        "tilt_median_rad",
        "tilt_low_rad",
        "tilt_high_rad",
    ),
    Indicator(
        "path_length_m",
        "path_length_m",
        "Path length",
        "m",
        1.0,
        "less",
        None,
        True,
        "path of a hand, mean of the two, median over the successful trials",
        "path_length_m",
        "path_length_low_m",
        "path_length_high_m",
    ),
)
