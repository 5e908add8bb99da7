"""Is this configuration, is this straight edge free? The question the search asks ten thousand times.

The search keeps `padding_m` away from everything, because a path that is free at its samples may touch between
them. A start or goal that already lies nearer than that could then never be left, so the padding shrinks near
the two endpoints: there it asks for 0.9 of the endpoint's own clearance, and grows back to the full padding
within `RELAX_RAD` of joint motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import numpy as np

from minidual.proof import planes
from minidual.proof.scene_engines import SceneEngines
from minidual.robot.compiled import floats
from minidual.robot.constants import ARMS, DOF, Array

RELAX_RAD = 0.1
_KEEP_FRACTION = 0.9


@cache
def bisection_order(count: int) -> Array:
    """Return the fractions k/count, k = 1..count, far apart first: a blocked edge shows early.

    The end comes first, then the middle, then the quarters. Nobody writes into what is returned: it is kept.
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
    """Collision checks with padding for one query.

    Separating planes answer nearly always (`minidual.proof.planes`); MuJoCo is asked about what they leave open. The
    same questions in the same order get the same answers, in any process.

    Args:
        engines: Engines of the scene.
        padding_m: Distance to keep.
        endpoints: Configurations (14,) near which the padding relaxes; they must be free themselves.
        step_rad: Largest joint step between two checks of an edge.
        arms: Only pairs with a part that moves with one of these arms are checked.
    """

    def __init__(
        self,
        engines: SceneEngines,
        padding_m: float,
        endpoints: Sequence[Array],
        step_rad: float,
        arms: Sequence[str] = ARMS,
    ) -> None:
        self._engine = engines.mujoco
        self._arms = arms
        self.padding_m = padding_m
        self.step_rad = step_rad
        self.checks_n = 0
        solids = engines.solids
        rows = solids.of_arms(arms)
        tight = [(q, solids.clearance(np.asarray(q)[None], padding_m, rows)) for q in endpoints]
        tight = [(q, max(0.0, clearance)) for q, clearance in tight if clearance < padding_m]
        self._tight = np.array([q for q, _ in tight]).reshape(len(tight), DOF)
        self._clearances = _KEEP_FRACTION * np.array([clearance for _, clearance in tight])
        self._geometry = solids.geometry
        self._q = np.empty(DOF)
        self._rest = (
            rows,
            padding_m,
            self._tight,
            self._clearances,
            RELAX_RAD,
            solids.directions(),
            solids.workspace(),
        )

    def required_m(self, q: Array) -> float:
        """Return the distance that must be kept at q (14,) [m]."""
        needed = self.padding_m
        for endpoint, clearance in zip(self._tight, self._clearances, strict=True):
            away = float(np.max(np.abs(q - endpoint))) / RELAX_RAD
            needed = min(needed, float(clearance) + (self.padding_m - float(clearance)) * min(1.0, away))
        return needed

    def free(self, q: Array) -> bool:
        """Return whether q (14,) keeps its distance."""
        return self.all_free(np.asarray(q)[None])

    def all_free(self, Q: Array) -> bool:
        """Return whether every row of Q (n, 14) keeps its distance; stops at the first that does not."""
        begin, Q = 0, floats(Q)
        while True:
            k, verdict = planes.survey(self._geometry, Q, begin, *self._rest)
            self.checks_n += k - begin + (verdict != planes.FREE)
            if verdict != planes.UNDECIDED or not self._asked(Q[k]):
                return verdict == planes.FREE
            begin = k + 1

    def _asked(self, q: Array) -> bool:
        """Return whether q (14,) keeps its distance as MuJoCo sees it."""
        engine = self._engine
        with engine.moving(self._arms):
            engine.set_margin(self.padding_m)
            if engine.contact_count(q) == 0:
                return True
            nearest = engine.nearest_m()
        return nearest > 0.0 and len(self._tight) > 0 and nearest >= self.required_m(q)

    def edge_free(self, a: Array, b: Array, step_rad: float | None = None) -> bool:
        """Return whether the straight line from a to b (both (14,)) is free; a itself is taken as checked."""
        count = math.ceil(np.abs(b - a).max() / (step_rad or self.step_rad))
        if count == 0:
            return True
        a, b, fractions, begin = floats(a), floats(b), bisection_order(count), 0
        while True:
            k, verdict = planes.sweep(self._geometry, a, b, fractions, begin, self._q, *self._rest)
            self.checks_n += k - begin + (verdict != planes.FREE)
            if verdict != planes.UNDECIDED or not self._asked(self._q):
                return verdict == planes.FREE
            begin = k + 1
