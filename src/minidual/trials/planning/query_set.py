"""Stored query sets: one hundred hard queries per group for two seeds, default robot.

Each query has a witness: corners of a polyline that both engines find free every 0.002 rad.
`python scripts/make_query_set.py SEED` makes a set.
"""

import functools
from importlib.resources import files
from itertools import pairwise
from typing import Any

import numpy as np

from minidual.collision.engine import ENGINES
from minidual.errors import DataError
from minidual.proof.scene_engines import STEP_RAD, SceneEngines
from minidual.robot.arms import DUAL_PANDA
from minidual.robot.pair import Array
from minidual.trials.planning.queries import Query, QueryGenerator, scene_of

OBSTACLES_N = 5
ROBOT = DUAL_PANDA


class QuerySet:
    """One stored set.

    Args:
        arrays: `seed`, and by group G of k queries `G.attempts`, `G.seeds` (k,), `G.ends` (k, 2, n) start and goal,
            `G.corners`, `G.corners_n` witnesses, `G.left_out`.

    Raises:
        KeyError, ValueError: Missing or misshapen array.
    """

    def __init__(self, arrays: dict[str, Any]) -> None:
        self.seed = int(arrays["seed"])
        self.attempts: dict[str, Array] = {g: arrays[f"{g}.attempts"] for g in ROBOT.groups}
        self._seeds = {g: arrays[f"{g}.seeds"] for g in ROBOT.groups}
        self._ends = {g: stored(arrays[f"{g}.ends"]) for g in ROBOT.groups}
        self._corners = {
            g: np.split(arrays[f"{g}.corners"].astype(float), np.cumsum(arrays[f"{g}.corners_n"])[:-1])
            for g in ROBOT.groups
        }

    def size(self, group: str) -> int:
        """Return the number of queries of a group."""
        return len(self.attempts[group])

    def query(self, group: str, index: int) -> Query:
        """Return a stored query."""
        attempt, seed = int(self.attempts[group][index]), int(self._seeds[group][index])
        start, goal = (np.array(q) for q in self._ends[group][index])
        scene = scene_of(self.seed, group, index, attempt, OBSTACLES_N)
        return Query(group, index, seed, scene, start, goal, QueryGenerator.kind_of(group, index), attempt)

    def witness(self, group: str, index: int) -> Array:
        """Return the polyline (k, n) from start to goal."""
        start, goal = self._ends[group][index]
        return np.vstack([start, self._corners[group][index], goal])


@functools.cache
def stored_set(seed: int) -> QuerySet | None:
    """Return the set of a seed, or None.

    Raises:
        DataError: The file is damaged.
    """
    file = files("minidual.trials.planning") / "query_sets" / f"seed-{seed}.npz"
    if not file.is_file():
        return None
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            found = QuerySet(dict(arrays))
    except (OSError, ValueError, KeyError) as error:
        raise DataError(f"the stored query set of seed {seed} cannot be read: {error}") from error
    if found.seed != seed:
        raise DataError(f"the stored query set of seed {seed} says it is of seed {found.seed}")
    return found


def stored(q: Array) -> Array:
    """Return configurations (..., n) as stored: single precision, inside the limits."""
    return np.clip(np.asarray(q, dtype=np.float32).astype(float), ROBOT.q_lower, ROBOT.q_upper)


def polyline_states(path: Array, step_rad: float = STEP_RAD) -> Array:
    """Return states (m, n) along a polyline (k, n), at most step_rad apart."""
    parts = [path[:1]]
    for a, b in pairwise(path):
        count = max(1, int(np.ceil(np.abs(b - a).max() / step_rad)))
        parts.append(a + np.linspace(0.0, 1.0, count + 1)[1:, None] * (b - a))
    return np.concatenate(parts)


def is_free(path: Array, engines: SceneEngines) -> bool:
    """Return whether both engines find a polyline (k, n) free."""
    Q = polyline_states(path)
    return not any(engines.engine(name).collisions(Q).any() for name in ENGINES)
