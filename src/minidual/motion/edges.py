"""Is this configuration, is this straight edge free? The question the search asks ten thousand times.

The search keeps `padding_m` away from everything, because a path that is free at its samples may touch between them. A
start or goal that already lies nearer could then never be left, so near the two endpoints the padding shrinks to 0.9 of
the endpoint's own clearance, and grows back to the full padding within `RELAX_RAD` of joint motion.
"""

from __future__ import annotations

import math
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
    """Return the fractions k/count, k = 1..count, far apart first: a blocked edge shows early.

    The end comes first, then the middle, then the quarters. Read only: the array is kept.
    """
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
    """Collision checks with padding for one query, by separating planes; what they leave open counts as blocked.

    The same questions in the same order get the same answers, in any process.

    Args:
        engines: Engines of the scene.
        padding_m: Distance to keep.
        endpoints: Configurations (dof,) near which the padding relaxes; they must be free themselves.
        step_rad: Largest joint step between two checks of an edge.
        arms: Only pairs with a part that moves with one of these arms are checked.
    """

    def __init__(
        self,
        engines: SceneEngines,
        padding_m: float,
        endpoints: Sequence[Array],
        step_rad: float,
        arms: Sequence[str] = SIDES,
    ) -> None:
        solids = engines.solids
        self.robot = solids.robot
        self.padding_m = padding_m
        self.step_rad = step_rad
        self.checks_n = 0
        rows = solids.of_arms(arms)
        near = [(q, solids.clearance(np.asarray(q)[None], padding_m, rows)) for q in endpoints]
        near = [(q, max(0.0, clearance)) for q, clearance in near if clearance < padding_m]
        tight = np.array([q for q, _ in near]).reshape(len(near), self.robot.dof)
        keep = float(padding_m), tight, _KEEP_FRACTION * np.array([clearance for _, clearance in near]), RELAX_RAD
        self._geometry, self._rest = solids.geometry, (rows, keep, solids.workspace())
        self._q = np.empty(self.robot.dof)

    def free(self, q: Array) -> bool:
        """Return whether q (dof,) keeps its distance."""
        return self.all_free(np.asarray(q)[None])

    def all_free(self, Q: Array) -> bool:
        """Return whether every row of Q (n, dof) keeps its distance; stops at the first that does not."""
        return self._counted(planes.survey(self._geometry, floats(Q), *self._rest), len(Q))

    def edge_free(self, a: Array, b: Array, step_rad: float | None = None) -> bool:
        """Return whether the straight line from a to b (both (dof,)) is free; a itself is taken as checked."""
        count = math.ceil(np.abs(b - a).max() / (step_rad or self.step_rad))
        if count == 0:
            return True
        order = bisection_order(count)
        return self._counted(planes.sweep(self._geometry, floats(a), floats(b), order, self._q, *self._rest), count)

    def _counted(self, free_n: int, count: int) -> bool:
        self.checks_n += min(free_n + 1, count)
        return free_n == count
