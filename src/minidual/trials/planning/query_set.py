"""Stored query sets: one hundred hard queries per group for two seeds, default robot.

Each query has a witness: corners of a polyline that both engines find free every 0.002 rad.
`python scripts/make_query_set.py SEED` makes a set.
"""

import functools
from importlib.resources import files
from itertools import pairwise

import numpy as np

from minidual.errors import DataError
from minidual.proof.scene_engines import STEP_RAD
from minidual.robot.arms import DUAL_PANDA
from minidual.robot.pair import Array
from minidual.trials.planning.queries import Query, QueryGenerator, scene_of

OBSTACLES_N = 5
ROBOT = DUAL_PANDA


@functools.cache
def stored_set(seed: int) -> dict[str, tuple[Array, Array, Array]] | None:
    """Return {group: (attempts (k,), seeds (k,), starts and goals (k, 2, n))} of a seed, or None.

    Raises:
        DataError: The file is damaged.
    """
    file = files("minidual.trials.planning") / "query_sets" / f"seed-{seed}.npz"
    if not file.is_file():
        return None
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as opened:
            arrays = dict(opened)
        of = int(arrays["seed"])
        found = {g: (arrays[f"{g}.attempts"], arrays[f"{g}.seeds"], stored(arrays[f"{g}.ends"])) for g in ROBOT.groups}
    except (OSError, ValueError, KeyError) as error:
        raise DataError(f"the stored query set of seed {seed} cannot be read: {error}") from error
    if of != seed:
        raise DataError(f"the stored query set of seed {seed} says it is of seed {of}")
    return found


def stored_query(seed: int, group: str, index: int) -> Query | None:
    """Return a stored query, or None beyond the sets."""
    known = stored_set(seed)
    if known is None or index >= len(known[group][0]):
        return None
    attempt, own_seed, (start, goal) = (column[index] for column in known[group])
    scene = scene_of(seed, group, index, int(attempt), OBSTACLES_N)
    return Query(group, index, int(own_seed), scene, start, goal, QueryGenerator.kind_of(group, index), int(attempt))


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
