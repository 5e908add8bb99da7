"""Indicators that compare methods."""

import math
from dataclasses import dataclass

_UNSEEN = 0.0005  # smaller displayed values are rounding error


@dataclass(frozen=True)
class Indicator:
    """One column of the comparison.

    Attributes:
        key: Key in the benchmark's data.
        scale: Displayed value / SI value.
        excellent: Limit, SI.
        spread: Keys of middle and 95 % interval.
        needs_success: Undefined without a success.
    """

    key: str
    column: str
    title: str
    unit: str
    scale: float
    excellent: float | None
    spread: tuple[str, str, str]
    meaning: str
    needs_success: bool = False
    more_is_better: bool = False

    def shown(self, value: float) -> str:
        """Return `value` in the displayed unit."""
        if self.unit == "%":
            return f"{value * 100:.0f}"
        seen = value * self.scale
        return "0.000" if 0.0 < abs(seen) < _UNSEEN else three_digits(seen)

    def is_excellent(self, value: float) -> bool:
        """Return whether `value` beats the excellent limit."""
        if self.excellent is None:
            return False
        return value > self.excellent if self.more_is_better else value < self.excellent

    @property
    def excellent_text(self) -> str:
        """The excellent limit as text."""
        if self.excellent is None:
            return ""
        return f"{'>' if self.more_is_better else '<'} {self.excellent * self.scale:g} {self.unit}"


def three_digits(value: float) -> str:
    """Return three significant digits, without exponent from 0.0001 up."""
    if abs(value) >= 1000:
        return f"{value:,.0f}"
    text = f"{value:#.3g}".removesuffix(".")
    return text if "e" not in text else f"{value:.1e}"


def _spread(name: str, unit: str, middle: str = "median_") -> tuple[str, str, str]:
    return f"{name}_{middle}{unit}".rstrip("_"), f"{name}_low_{unit}".rstrip("_"), f"{name}_high_{unit}".rstrip("_")


# Limits of "excellent": day 11 of the tutorial that the pipeline follows.
# fmt: off
SUCCESS = Indicator("success_rate", "success", "Success", "%", 100.0, 0.8, ("success_rate", "success_low", "success_high"),
                    "share of trials that passed the whole success test, with its 95 % Wilson interval",
                    more_is_better=True)
INDICATORS: tuple[Indicator, ...] = (
    SUCCESS,
    Indicator("duration_median_s", "duration_s", "Completion time", "s", 1.0, 10.0, _spread("duration", "s"),
              "median of the successful trials, from start to the object released at its goal", needs_success=True),
    Indicator("torque_ratio_max", "torque_ratio_max", "Peak torque", "% of limit", 100.0, 0.8,
              _spread("torque_ratio", ""), "largest motor torque over its limit, over joints, time and trials"),
    Indicator("jerk_rms_median", "jerk_rms", "RMS jerk", "rad/s³", 1.0, 100.0, _spread("jerk_rms", ""),
              "third derivative of the measured joints of both arms after a low-pass, median over trials"),
    Indicator("tilt_max_rad", "tilt_max_rad", "Largest tilt", "deg", 180.0 / math.pi, math.radians(5.0),
              _spread("tilt", "rad"), "largest tilt of the object, over time and trials"),
    Indicator("path_length_m", "path_length_m", "Path length", "m", 1.0, None, _spread("path_length", "m", ""),
              "path of a hand, mean of the two, median over the successful trials", needs_success=True),
)
# fmt: on
