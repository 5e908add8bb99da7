"""Make a stored query set: `python scripts/make_query_set.py SEED [QUERIES]` (minutes to an hour).

For every query the generator's scenes are tried in turn until one is of the required kind and a way
through it is found by a search that is several times longer than the planner's own, with several
planners' seeds and less padding.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from minidual.collision.shapes import ENGINES
from minidual.config.seeds import stream, subseed
from minidual.motion.budget import Budget
from minidual.motion.search import EdgeChecker, search
from minidual.motion.shortcut import shortcut
from minidual.proof.scene_engines import SceneEngines
from minidual.robot.pair import Array
from minidual.trials.planning import queries
from minidual.trials.planning.queries import (
    OBSTACLES_N,
    ROBOT,
    Query,
    QueryGenerator,
    polyline_states,
    stored,
    stored_query,
)

_CHECKS_N = 250_000
_ROUNDS = ((0.004, 0.03), (0.002, 0.03), (0.001, 0.02), (0.001, 0.02))
"""Padding [m] and step [rad] of the searches, one after the other: 1,000,000 state checks in all."""
FOLDER = Path(queries.__file__).with_name("query_sets")


def is_free(path: Array, engines: SceneEngines) -> bool:
    """Return whether both engines find a polyline (k, n) free."""
    Q = polyline_states(path)
    return not any(engines.engine(name).collisions(Q).any() for name in ENGINES)


def witness(seed: int, group: str, index: int) -> Array:
    """Return the polyline (k, n) from start to goal of a stored query."""
    query = stored_query(seed, group, index)
    assert query is not None
    with np.load(FOLDER / f"seed-{seed}.npz") as arrays:
        corners = arrays[f"{group}.corners"].astype(float)
        ends = np.cumsum(arrays[f"{group}.corners_n"])
    of_query = np.split(corners, ends[:-1])[index]
    return np.vstack([query.q_start, of_query, query.q_goal])


def find_way(query: Query) -> Array | None:
    """Return a polyline (k, n) on which nothing touches, its corners rounded to what is stored; or None."""
    engines = SceneEngines(query.scene)
    for attempt, (padding, step) in enumerate(_ROUNDS):
        checker = EdgeChecker(engines, padding, (query.q_start, query.q_goal), step)
        checker.allow(_CHECKS_N, Budget())
        ends = np.array([query.q_start, query.q_goal])
        seed = subseed(query.seed, "witness/search", attempt)
        path = search(checker, ends, ROBOT.groups[query.group], seed=seed)
        if path is None:
            continue
        path = shortcut(path, checker, stream(query.seed, "witness/shortcut", attempt), 60)
        path = stored(path)
        if is_free(path, engines):
            return path
    return None


class Solved(NamedTuple):
    """A query with its way.

    Attributes:
        query: The query.
        path: Polyline (k, n) from start to goal.
        left_out_n: Scenes of the required kind before it in which no way was found.
    """

    query: Query
    path: Array
    left_out_n: int


def _solve(job: tuple[int, str, int]) -> Solved:
    """Return query `index` of a group, for (seed, group, index)."""
    seed, group, index = job
    generator = QueryGenerator(seed, OBSTACLES_N)
    attempt = 0
    left_out_n = 0
    while True:
        query = generator.query(group, index, attempt)
        query = replace(query, q_start=stored(query.q_start), q_goal=stored(query.q_goal))
        path = find_way(query)
        if path is not None:
            return Solved(query, path, left_out_n)
        left_out_n += 1
        attempt = query.attempt + 1


def make(seed: int, queries_n: int, workers_n: int) -> dict[str, Any]:
    """Return the arrays of a new set.

    They are `seed`, and by group G of k queries `G.attempts`, `G.seeds` (k,), `G.ends` (k, 2, n)
    start and goal, `G.corners`, `G.corners_n` witnesses, `G.left_out`.
    """
    jobs = [(seed, group, index) for group in ROBOT.groups for index in range(queries_n)]
    solved: dict[str, list[Solved]] = {group: [] for group in ROBOT.groups}
    with ProcessPoolExecutor(workers_n) as pool:
        results = pool.map(_solve, jobs)
        for number, ((_, group, index), result) in enumerate(zip(jobs, results, strict=True), 1):
            solved[group].append(result)
            print(
                f"{number} of {len(jobs)}: {group} {index}, attempt {result.query.attempt}",
                file=sys.stderr,
            )
    arrays: dict[str, Any] = {"seed": np.array(seed)}
    for group, of_group in solved.items():
        arrays |= _group_arrays(group, of_group)
    return arrays


def _group_arrays(group: str, solved: Sequence[Solved]) -> dict[str, Any]:
    queries_of_group = [each.query for each in solved]
    corners = [each.path[1:-1] for each in solved]
    ends = [(query.q_start, query.q_goal) for query in queries_of_group]
    attempts = [query.attempt for query in queries_of_group]
    seeds = [query.seed for query in queries_of_group]
    no_corners = np.zeros((0, ROBOT.dof))
    return {
        f"{group}.attempts": np.array(attempts, dtype=np.int32),
        f"{group}.seeds": np.array(seeds, dtype=np.int64),
        f"{group}.ends": np.array(ends, dtype=np.float32),
        f"{group}.corners_n": np.array([len(each) for each in corners], dtype=np.int32),
        f"{group}.corners": np.vstack([no_corners, *corners]).astype(np.float32),
        f"{group}.left_out": np.array(sum(each.left_out_n for each in solved)),
    }


def main(seed: int, queries_n: int = 100, workers_n: int = 2) -> None:
    """Make the set of a seed and write it beside the others."""
    arrays = make(seed, queries_n, workers_n)
    file = FOLDER / f"seed-{seed}.npz"
    np.savez_compressed(file, **arrays)
    print(f"{file}: {file.stat().st_size} bytes", file=sys.stderr)


if __name__ == "__main__":
    main(*(int(value) for value in sys.argv[1:]))
