"""Internal force that a carry requests: reduced when the hands begin to slip."""

import math

_EASED = 0.75
"""Share of the force felt at the onset of slip that is requested afterwards."""
_MARGIN = 1.25
"""Least request in the air, relative to what the task needs; on the table half of it."""


class Squeeze:
    """Requested internal force.

    The force felt at the onset of slip is what friction carries, 2 mu times the pinch.

    Args:
        wanted_n: Request without slip.
        needed_n: What the task needs in the air.
        creep_m: Change of the hands' distance that counts as slip.

    Attributes:
        limit_n: Internal force that friction carries, learnt at the onset of slip; inf before.
    """

    def __init__(self, wanted_n: float, needed_n: float, creep_m: float) -> None:
        self._wanted_n = wanted_n
        self._least_n = 0.5 * _MARGIN * needed_n
        self._creep_m = creep_m
        self._spread_m: float | None = None
        self.limit_n = math.inf

    @property
    def request_n(self) -> float:
        """Requested internal force [N]."""
        return self._wanted_n if self._wanted_n < self.limit_n else self.limit_n

    def lift(self) -> None:
        """From now on, request no less than the task needs in the air."""
        self._least_n = 2.0 * self._least_n
        self.limit_n = max(self.limit_n, self._least_n)

    def update(self, spread_m: float, felt_n: float) -> None:
        """Reduce the request if the hands have crept; take their distance and the felt force."""
        if self._spread_m is None:
            self._spread_m = spread_m
        elif abs(spread_m - self._spread_m) > self._creep_m:
            self._spread_m = spread_m
            request_n = self.request_n
            self.limit_n = max(min(request_n, self._least_n), min(request_n, _EASED * felt_n))
