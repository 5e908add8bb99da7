"""Collision checks of configurations and straight edges.

Checks keep `padding_m`, as paths may touch between samples. Near an endpoint with less clearance it is 0.9 of that
clearance and grows back within `RELAX_RAD` of joint motion.
"""

import math
import time
from collections.abc import Sequence
from functools import cache

import numpy as np

from minidual.proof import planes
from minidual.proof.scene_engines import SceneEngines
from minidual.robot.compiled import floats
from minidual.robot.pair import SIDES, Array

RELAX_RAD = 0.1
_KEEP_FRACTION = 0.9


@cache
def bisection_order(count: int) -> Array:
    """Return k/count, k = 1..count, in bisection order, end first. Cached: read only."""
    order: list[int] = []
    seen = {0}
    step = count
    while step >= 1 and len(order) < count:
        for k in range(step, count + 1, step):
            if k not in seen:
                seen.add(k)
                order.append(k)
        step //= 2
    return np.array(order, dtype=float) / count


class EdgeChecker:
    """Deterministic checks by separating planes; undecided counts as blocked.

    `ends` (dof,) are free. Only pairs with a part of `arms` are checked.
    """

    def __init__(
        self,
        engines: SceneEngines,
        padding_m: float,
        ends: Sequence[Array],
        step_rad: float,
        arms: Sequence[str] = SIDES,
    ) -> None:
        solids = engines.solids
        self.robot = solids.robot
        self.padding_m = padding_m
        self.step_rad = step_rad
        self.checks_n = 0
        self._checks_end = self._deadline = math.inf
        rows = solids.of_arms(arms)
        near = [(q, solids.clearance(np.asarray(q)[None], padding_m, rows)) for q in ends]
        near = [(q, max(0.0, clearance)) for q, clearance in near if clearance < padding_m]
        tight = np.array([q for q, _ in near]).reshape(len(near), self.robot.dof)
        keep = float(padding_m), tight, _KEEP_FRACTION * np.array([clearance for _, clearance in near]), RELAX_RAD
        self._geometry, self._rest = solids.geometry, (rows, keep, solids.workspace())

    def allow(self, checks_n: int, deadline: float) -> None:
        """Bound what follows: state checks, and `deadline` by time.perf_counter()."""
        self._checks_end, self._deadline = self.checks_n + checks_n, deadline

    @property
    def spent(self) -> bool:
        """Whether a bound is reached."""
        return self.checks_n >= self._checks_end or time.perf_counter() > self._deadline

    def free(self, q: Array) -> bool:
        """Return whether q (dof,) keeps the padding."""
        return self.all_free(np.asarray(q)[None])

    def all_free(self, Q: Array) -> bool:
        """Return whether all rows of Q (n, dof) keep it."""
        free_n = planes.survey(self._geometry, floats(Q), *self._rest)
        self.checks_n += min(free_n + 1, len(Q))
        return free_n == len(Q)

    def edge_free(self, a: Array, b: Array, step_rad: float | None = None) -> bool:
        """Return whether the edge (dof,) is free, checked every `step_rad`; a itself is not."""
        count = math.ceil(np.abs(b - a).max() / (step_rad or self.step_rad))
        if count == 0:
            return True
        return self.all_free(a + bisection_order(count)[:, None] * (b - a))
