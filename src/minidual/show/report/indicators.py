"""The indicators that compare methods: the columns of the comparison.

The limits of "excellent" are those of day 11 of the tutorial that the pipeline follows.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from minidual.show.report.wording import percent

_ROUNDING = 0.0005
"""Smaller displayed values are rounding error."""


@dataclass(frozen=True)
class Indicator:
    """One column of the comparison.

    Attributes:
        key: Key of the compared number in the benchmark's data.
        column: Column of benchmark.csv, one value a trial.
        title: Heading.
        unit: Displayed unit.
        spread: Keys of the middle and of the lower and upper end of its 95 % interval.
        meaning: What one trial gives.
        over: How the trials become the compared number.
        scale: Displayed value / SI value.
        excellent: Limit, SI; None for no limit.
        needs_success: Whether it is undefined without a successful trial.
        more_is_better: Whether a larger value is better.
    """

    key: str
    column: str
    title: str
    unit: str
    spread: Sequence[str]
    meaning: str
    over: str
    scale: float = 1.0
    excellent: float | None = None
    needs_success: bool = False
    more_is_better: bool = False

    def shown(self, value: float) -> str:
        """Return an SI value in the displayed unit."""
        if self.unit == "%":
            return percent(value).removesuffix(" %")
        displayed = value * self.scale
        if 0.0 < abs(displayed) < _ROUNDING:
            return "0.000"
        return three_digits(displayed)

    def is_excellent(self, value: float) -> bool:
        """Return whether an SI value beats the limit of "excellent"."""
        if self.excellent is None:
            return False
        if self.more_is_better:
            return value > self.excellent
        return value < self.excellent

    @property
    def excellent_text(self) -> str:
        """The limit of "excellent" as text; empty for no limit."""
        if self.excellent is None:
            return ""
        sign = ">" if self.more_is_better else "<"
        return f"{sign} {self.excellent * self.scale:g} {self.unit}"


def three_digits(value: float) -> str:
    """Return three significant digits, without exponent from 0.0001 up."""
    if abs(value) >= 999.5:
        return f"{value:,.0f}"
    text = f"{value:#.3g}".removesuffix(".")
    if "e" in text:
        return f"{value:.1e}"
    return text


SUCCESS = Indicator(
    key="success_rate",
    column="success",
    title="Success",
    unit="%",
    scale=100.0,
    excellent=0.8,
    spread=("success_rate", "success_low", "success_high"),
    meaning="share of trials that passed the whole success test",
    over="with its 95 % Wilson interval",
    more_is_better=True,
)

INDICATORS = (
    SUCCESS,
    Indicator(
        key="duration_median_s",
        column="duration_s",
        title="Completion time",
        unit="s",
        excellent=10.0,
        spread=("duration_median_s", "duration_low_s", "duration_high_s"),
        meaning="from start to the object released at its goal",
        over="median of the successful trials",
        needs_success=True,
    ),
    Indicator(
        key="torque_ratio_max",
        column="torque_ratio_max",
        title="Peak torque",
        unit="% of limit",
        scale=100.0,
        excellent=0.8,
        spread=("torque_ratio_median", "torque_ratio_low", "torque_ratio_high"),
        meaning="largest motor torque over its limit in a trial",
        over="largest over trials",
    ),
    Indicator(
        key="jerk_rms_median",
        column="jerk_rms",
        title="RMS jerk",
        unit="rad/s³",
        excellent=100.0,
        spread=("jerk_rms_median", "jerk_rms_low", "jerk_rms_high"),
        meaning="third derivative of the measured joints of both arms after a low-pass",
        over="median over trials",
    ),
    Indicator(
        key="tilt_max_rad",
        column="tilt_max_rad",
        title="Largest tilt",
        unit="deg",
        scale=math.degrees(1.0),
        excellent=math.radians(5.0),
        spread=("tilt_median_rad", "tilt_low_rad", "tilt_high_rad"),
        meaning="largest tilt of the object in a trial",
        over="largest over trials",
    ),
    Indicator(
        key="path_length_m",
        column="path_length_m",
        title="Path length",
        unit="m",
        spread=("path_length_m", "path_length_low_m", "path_length_high_m"),
        meaning="path of a hand, mean of the two",
        over="median of the successful trials",
        needs_success=True,
    ),
)
