"""Limits on the work of a query: counted by default, by the clock for a person who waits."""

import math
from time import perf_counter
from typing import TypedDict

SOLVE_CHECKS_N = 4
"""Charge for the IK of both hands: it takes the time of four state checks."""
ATTEMPT_CHECKS_N = 1_000
"""Charge for what an attempt does besides its search: blend, timing and proof take 4 to 50 ms."""


class BudgetOptions(TypedDict, total=False):
    """Keyword arguments that limit a query; by default the configuration's `budget_checks_n`."""

    budget_checks_n: int | None
    """Work, in state checks. The result is the same on a slow or a busy machine."""
    budget_s: float | None
    """Wall time, for a person who waits. Alone, it replaces the counted limit."""


class Budget:
    """Work that is allowed, in state checks, and wall time.

    A search charges its state checks, its IK at `SOLVE_CHECKS_N` each, its evaluations of a
    constraint and its looks at its end at one each. An attempt is charged `ATTEMPT_CHECKS_N`. So
    every loop ends, and without a `wall_s` it ends at the same point on every machine.

    A core does 10 000 (held objects) to 50 000 (one arm) of these checks a second.

    Args:
        checks_n: Work; by default without limit.
        wall_s: Wall time from now [s]; by default without limit.
        within: A larger account, which is charged too.
    """

    def __init__(
        self,
        checks_n: float = math.inf,
        wall_s: float = math.inf,
        within: "Budget | None" = None,
    ) -> None:
        self.checks_n = checks_n
        self.wall_s = wall_s
        self.spent_n = 0
        self._within = within
        self._deadline_s = math.inf
        if math.isfinite(wall_s):
            self._deadline_s = perf_counter() + wall_s

    def spend(self, checks_n: int) -> None:
        """Charge work."""
        self.spent_n += checks_n
        if self._within is not None:
            self._within.spend(checks_n)

    @property
    def ended(self) -> bool:
        """Whether a limit is reached. The clock is read only if it is a limit."""
        if self.spent_n >= self.checks_n:
            return True
        return math.isfinite(self._deadline_s) and perf_counter() > self._deadline_s

    def __str__(self) -> str:
        """Return the limits, as in "no path in ..."."""
        limits: list[str] = []
        if math.isfinite(self.checks_n):
            limits.append(f"{self.checks_n:.0f} state checks")
        if math.isfinite(self.wall_s):
            limits.append(f"{self.wall_s:.2f} s")
        return " or ".join(limits) or "unlimited work"
