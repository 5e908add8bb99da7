"""Collision checks of configurations and straight edges, and sampling search with OMPL.

Checks keep `padding_m`, as paths may touch between samples. Near an endpoint with less clearance it
is 0.9 of that clearance and grows back within `RELAX_RAD` of joint motion. Limits count state
checks, so results do not depend on the machine.
"""

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
import ompl.base as ob
import ompl.geometric as og
import ompl.util as ou
from numpy.typing import ArrayLike

from minidual.config.seeds import subseed
from minidual.motion.budget import Budget
from minidual.proof import planes
from minidual.proof.layout import Padding
from minidual.proof.scene_engines import SceneEngines
from minidual.registry import Registry
from minidual.robot.compiled import floats
from minidual.robot.pair import SIDES, Array

RELAX_RAD = 0.1
_KEEP_FRACTION = 0.9


@cache
def bisection_order(count: int) -> Array:
    """Return k/count, k = 1..count, in bisection order, end first. Cached: read only."""
    order: dict[int, None] = {}  # a set that keeps its order
    for halvings in range(count.bit_length()):
        step = count >> halvings
        order.update(dict.fromkeys(range(step, count + 1, step)))
    return np.array(list(order), dtype=float) / count


class EdgeChecker:
    """Deterministic checks by separating planes; undecided counts as blocked.

    `ends` (dof,) are free. Only pairs with a part of `arms` are checked.
    """

    def __init__(
        self,
        engines: SceneEngines,
        padding_m: float,
        ends: ArrayLike,
        step_rad: float,
        arms: Sequence[str] = SIDES,
    ) -> None:
        solids = engines.solids
        self.robot = engines.solids.robot
        self.padding_m = padding_m
        self.step_rad = step_rad
        self.checks_n = 0
        self.checks_end = math.inf
        self.budget = Budget()
        self._geometry = solids.geometry
        self._rows = solids.of_arms(arms)
        ends = np.array(ends).reshape(-1, self.robot.dof)
        clearances = np.array([solids.clearance(q[None], padding_m, self._rows) for q in ends])
        tight = clearances < padding_m
        self._padding = Padding(
            padding_m=float(padding_m),
            tight=ends[tight],
            clearances_m=_KEEP_FRACTION * np.maximum(0.0, clearances[tight]),
            relax_rad=RELAX_RAD,
        )
        self._work = solids.workspace()

    def allow(self, checks_n: int, budget: Budget) -> None:
        """Bound the state checks of the next search, and all work by `budget`."""
        self.checks_end = self.checks_n + checks_n
        self.budget = budget

    @property
    def spent(self) -> bool:
        """Whether a bound is reached."""
        return self.checks_n >= self.checks_end or self.budget.ended

    def free(self, q: Array) -> bool:
        """Return whether q (dof,) keeps the padding."""
        return self.all_free(np.asarray(q)[None])

    def all_free(self, Q: Array) -> bool:
        """Return whether all rows of Q (n, dof) keep it."""
        free_n = planes.survey(self._geometry, floats(Q), self._rows, self._padding, self._work)
        made_n = min(free_n + 1, len(Q))
        self.checks_n += made_n
        self.budget.spend(made_n)
        return free_n == len(Q)

    def edge_free(self, a: Array, b: Array) -> bool:
        """Return whether the edge (dof,) is free, checked every `step_rad`; a itself is not."""
        count = math.ceil(np.abs(b - a).max() / self.step_rad)
        return self.all_free(a + bisection_order(count)[:, None] * (b - a))


PLANNERS = Registry[Any](
    "planner",
    {"rrtconnect": og.RRTConnect, "kpiece": og.KPIECE1},
    group="minidual.planners",
)
"""OMPL planners with a range.

PRM hangs: it evaluates the termination condition in its own threads.
"""


class _Motion(ob.MotionValidator):
    def __init__(self, si: Any, edge_free: Callable[[Any, Any], bool]) -> None:
        super().__init__(si)
        self._edge_free = edge_free

    def checkMotion(self, s1: Any, s2: Any) -> bool:
        return self._edge_free(s1, s2)


def bounded_space(lower: Array, upper: Array) -> Any:
    """Return OMPL's space within limits (d,)."""
    space = ob.RealVectorStateSpace(len(lower))
    bounds = ob.RealVectorBounds(len(lower))
    bounds.low = lower.tolist()
    bounds.high = upper.tolist()
    space.setBounds(bounds)
    return space


def seeded(seed: int) -> None:
    """Seed OMPL and silence it: repeated setSeed logs an error."""
    ou.setLogLevel(ou.LOG_NONE)
    ou.RNG.setSeed(max(1, subseed(seed, "ompl")))


def exact_path(
    worker: Any,
    range_rad: float,
    ends: Sequence[Any],
    enough: Callable[[], bool],
) -> Any:
    """Return the exact solution between two states, or None if `enough` came first."""
    definition = ob.ProblemDefinition(worker.getSpaceInformation())
    definition.setStartAndGoalStates(*ends)
    worker.setRange(range_rad)
    worker.setProblemDefinition(definition)
    worker.setup()
    ended = ob.PlannerTerminationCondition(lambda: definition.hasExactSolution() or enough())
    status = worker.solve(ended)  # also true for approximate solutions
    if status.getStatus() != ob.PlannerStatus.EXACT_SOLUTION:
        return None
    return definition.getSolutionPath()


def search(
    checker: EdgeChecker,
    ends: Array,
    joints: slice,
    *,
    seed: int,
    planner: str = "rrtconnect",
    range_rad: float = 1.0,
) -> Array | None:
    """Return a polyline (n, dof) between configurations (2, dof), or None if the checker is spent.

    Only `joints` move. `range_rad`: longest tree edge (Euclidean).
    """
    seeded(seed)
    robot = checker.robot
    si = ob.SpaceInformation(bounded_space(robot.q_lower[joints], robot.q_upper[joints]))
    indices = range(len(ends[0, joints]))

    def full(state: Any) -> Array:
        q = ends[0].copy()
        q[joints] = [state[i] for i in indices]
        return q

    motion = _Motion(si, lambda s1, s2: checker.edge_free(full(s1), full(s2)))
    si.setStateValidityChecker(lambda state: checker.free(full(state)))
    si.setMotionValidator(motion)
    si.setup()
    states: list[Any] = [si.allocState(), si.allocState()]
    for state, q in zip(states, ends, strict=True):
        for i, value in enumerate(q[joints]):
            state[i] = float(value)

    def enough() -> bool:
        checker.budget.spend(1)  # so that a planner which checks no state ends too
        return checker.spent

    path = exact_path(PLANNERS[planner](si), range_rad, states, enough)
    if path is None:
        return None
    return np.array([full(path.getState(i)) for i in range(path.getStateCount())])
