"""Joint goals of tcp poses."""

import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from minidual.collision.errors import GoalInCollisionError
from minidual.motion.checks import check_targets, require_free
from minidual.motion.ik import ArmIK, solvers
from minidual.proof.scene_engines import SceneEngines
from minidual.robot.pair import Array


def pose_goals(
    group: str,
    q_start: Array,
    targets: Mapping[str, Array],
    engines: SceneEngines,
    rng: np.random.Generator,
    restarts_n: int,
    goals_n: int = 1,
) -> list[Array]:
    """Return free configurations at tcp poses, nearest to the start first.

    Args:
        group: Planning group.
        q_start: All joints (n,); the other arm stays there.
        targets: {arm: T_world_tcp (4, 4)} of exactly the group's arms.
        engines: The scene.
        rng: Draws the starts of the inverse kinematics.
        restarts_n: Their number per arm.
        goals_n: Most configurations returned.

    Raises:
        IKUnreachableError, GoalInCollisionError: None exists.
        UsageError: Wrong arms or invalid pose.
    """
    arms = solvers(engines.scene.robot)
    streams = {
        side: arms[side].solutions(T, q_start[arms[side].joints], rng, restarts_n)
        for side, T in check_targets(group, targets).items()
    }
    solutions: dict[str, list[Array]] = {side: [] for side in streams}
    while True:
        drawn_n = _draw(streams, solutions, goals_n)
        candidates = _combinations(arms, solutions, q_start)
        free = list(itertools.islice(filter(engines.solids.free, candidates), goals_n))
        if free:
            return free
        if drawn_n == 0:
            require_free(engines, candidates[0], "goal")
            raise GoalInCollisionError(
                "the goal is too close to contact: no plane separates all pairs at any of its"
                " solutions",
                remedy="move it a little, or allow the pair in the scene",
            )


def _draw(
    streams: Mapping[str, Iterator[Array]],
    solutions: dict[str, list[Array]],
    count: int,
) -> int:
    """Add up to `count` more solutions of each arm; return how many there were."""
    drawn_n = 0
    for side, stream in streams.items():
        drawn = list(itertools.islice(stream, count))
        solutions[side] += drawn
        drawn_n += len(drawn)
    return drawn_n


def _combinations(
    arms: Mapping[str, ArmIK],
    solutions: Mapping[str, Sequence[Array]],
    q_start: Array,
) -> list[Array]:
    """Return all combinations (n,) of the arms' solutions, nearest to the start first."""
    combinations: list[Array] = []
    for parts in itertools.product(*solutions.values()):
        q = np.array(q_start)
        for side, part in zip(solutions, parts, strict=True):
            q[arms[side].joints] = part
        combinations.append(q)
    combinations.sort(key=lambda q: float(np.linalg.norm(q - q_start)))
    return combinations
