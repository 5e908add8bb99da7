"""Tells a loop that runs at another rate than the simulation that it steps."""

from statistics import median

_PERIODS_N = 50
_TOLERANCE = 0.1


class RateWatch:
    """Measures the periods of a loop, and complains once.

    Args:
        rate_hz: Rate at which simulated time passes.
        option: What sets it, such as "--robot.fps".
    """

    def __init__(self, rate_hz: float, option: str) -> None:
        self._rate_hz = rate_hz
        self._option = option
        self._last_s: float | None = None
        self._periods_s: list[float] = []

    def note(self, now_s: float) -> str:
        """Note a step at a wall time [s]; return a complaint, or ""."""
        if self._last_s is not None and len(self._periods_s) < _PERIODS_N:
            self._periods_s.append(now_s - self._last_s)
            if len(self._periods_s) == _PERIODS_N:
                self._last_s = now_s
                return self._complaint(1.0 / max(median(self._periods_s), 1e-6))
        self._last_s = now_s
        return ""

    def _complaint(self, loop_hz: float) -> str:
        if abs(loop_hz - self._rate_hz) <= _TOLERANCE * self._rate_hz:
            return ""
        if loop_hz > self._rate_hz:
            reason = "simulated time runs fast"
        else:
            reason = "simulated time runs slowly, or the machine is too slow"
        return (
            f"the loop runs at {loop_hz:.0f} Hz, one step of the simulation is 1/{self._rate_hz:g} s:"
            f" {reason}. A dataset's times are right only if both rates agree: give --dataset.fps"
            f" and {self._option} the same value"
        )
