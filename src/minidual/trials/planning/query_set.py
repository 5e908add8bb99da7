"""The stored query sets: for two seeds, one hundred hard queries a group and for each a way that exists.

A set holds start, goal and the generator's attempt (which gives the scene) of every query, and a witness: the
corners of a polyline on which both engines, asked every 0.002 rad, see nothing touch. So a query that the planner
fails is the planner's failure. Candidates for which a search several times longer than the planner's own found no
way are left out, and counted. `python -m minidual.trials.planning.make_query_set SEED` makes a set again.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from importlib.resources import files
from itertools import pairwise

import numpy as np

from minidual.errors import DataError
from minidual.motion.ik import ArmIK
from minidual.proof.scene_engines import SceneEngines
from minidual.proof.verify import STEP_RAD
from minidual.robot.constants import ARMS, DOF, GROUPS, Q_LOWER, Q_UPPER, Array
from minidual.trials.planning.queries import Query, QueryGenerator, goal_as_poses, scene_of

OBSTACLES_N = 5


@dataclass(frozen=True, eq=False)
class QuerySet:
    """One stored set.

    Attributes:
        seed: Seed of the generator.
        attempts: By group, (n,) the attempt of each query.
        seeds: By group, (n,) seed for the planner.
        ends: By group, (n, 2, 14) start and goal.
        corners: By group, n arrays (k, 14): the witness between start and goal.
        left_out: By group, how many candidates had no known way.
    """

    seed: int
    attempts: dict[str, Array]
    seeds: dict[str, Array]
    ends: dict[str, Array]
    corners: dict[str, list[Array]]
    left_out: dict[str, int]

    def size(self, group: str) -> int:
        """Return how many queries of a group are stored."""
        return len(self.attempts[group])

    def query(self, group: str, index: int) -> Query:
        """Return a stored query."""
        attempt = int(self.attempts[group][index])
        start, goal = (np.array(q) for q in self.ends[group][index])
        arms = ARMS if group == "both_arms" else (group.removesuffix("_arm"),)
        targets = {arm: _solver(arm).tcp_pose(goal[GROUPS[f"{arm}_arm"]]) for arm in arms}
        return Query(
            group,
            index,
            int(self.seeds[group][index]),
            scene_of(self.seed, group, index, attempt, OBSTACLES_N),
            start,
            goal,
            targets,
            goal_as_poses(index),
            True,
            QueryGenerator.kind_of(group, index),
            attempt,
        )

    def witness(self, group: str, index: int) -> Array:
        """Return the polyline (k, 14) from start to goal that proves a query feasible."""
        start, goal = self.ends[group][index]
        return np.vstack([start, self.corners[group][index], goal])

    def to_arrays(self) -> dict[str, Array]:
        """Return what `from_arrays` reads."""
        arrays: dict[str, Array] = {"seed": np.array(self.seed)}
        for group in self.attempts:
            corners = self.corners[group]
            arrays[f"{group}.attempts"] = np.asarray(self.attempts[group], dtype=np.int32)
            arrays[f"{group}.seeds"] = np.asarray(self.seeds[group], dtype=np.int64)
            arrays[f"{group}.ends"] = self.ends[group].astype(np.float32)
            arrays[f"{group}.corners_n"] = np.array([len(c) for c in corners], dtype=np.int32)
            arrays[f"{group}.corners"] = np.vstack([np.zeros((0, DOF)), *corners]).astype(np.float32)
            arrays[f"{group}.left_out"] = np.array(self.left_out[group])
        return arrays

    @classmethod
    def from_arrays(cls, arrays: dict[str, Array]) -> QuerySet:
        """Return a set from its arrays."""
        return cls(
            int(arrays["seed"]),
            *({g: arrays[f"{g}.{what}"] for g in GROUPS} for what in ("attempts", "seeds")),
            {g: stored(arrays[f"{g}.ends"]) for g in GROUPS},
            {
                g: np.split(arrays[f"{g}.corners"].astype(float), np.cumsum(arrays[f"{g}.corners_n"])[:-1])
                for g in GROUPS
            },
            {g: int(arrays[f"{g}.left_out"]) for g in GROUPS},
        )


@functools.cache
def _solver(arm: str) -> ArmIK:
    return ArmIK(arm)


@functools.cache
def stored_set(seed: int) -> QuerySet | None:
    """Return the set of a seed, or None if none is stored.

    Raises:
        DataError: The file is damaged.
    """
    file = files("minidual.trials.planning") / "query_sets" / f"seed-{seed}.npz"
    if not file.is_file():
        return None
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            found = QuerySet.from_arrays(dict(arrays))
    except (OSError, ValueError, KeyError) as error:
        raise DataError(f"the stored query set of seed {seed} cannot be read: {error}") from error
    if found.seed != seed:
        raise DataError(f"the stored query set of seed {seed} says it is of seed {found.seed}")
    return found


def stored(q: Array) -> Array:
    """Return configurations (..., 14) as a set keeps them: single precision, inside the limits."""
    return np.clip(np.asarray(q, dtype=np.float32).astype(float), Q_LOWER, Q_UPPER)


def polyline_states(path: Array, step_rad: float = STEP_RAD) -> Array:
    """Return states (m, 14) along a polyline (n, 14), no joint moving more than step_rad between two."""
    parts = [path[:1]]
    for a, b in pairwise(path):
        count = max(1, int(np.ceil(np.abs(b - a).max() / step_rad)))
        parts.append(a + np.linspace(0.0, 1.0, count + 1)[1:, None] * (b - a))
    return np.concatenate(parts)


def is_free(path: Array, engines: SceneEngines) -> bool:
    """Return whether both engines see every sample of a polyline (n, 14) free."""
    Q = polyline_states(path)
    return not engines.mujoco.collisions(Q).any() and not engines.coal.collisions(Q).any()
