"""Object-centred segments of a demonstration in which both hands hold one object.

Each hand has a segment of its own: its approach, from near the grasp on, belongs to the object where
it starts. From the last grasp to the first release both hands belong to the object that they carry
(coordination), and nothing of that begins before the last hand holds it (order). What follows
belongs to the object where it ends. The segments are those of Jiang et al., DexMimicGen, 2025.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from minidual.demos.episode import Episode, episode_paths, read_episode
from minidual.demos.quality import grip_changes
from minidual.errors import DataError, UsageError, shortened
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array
from minidual.tasks.task import Placement

START = "start_x_y_yaw"
GOAL = "goal_x_y_yaw"
"""Facts of an episode: where what is carried stood, and where it was to go."""
_PLACES = ("", "episodes", "teleop-record/episodes")
_APPROACH_TICKS_MIN = 10
"""A hand that is at its grasp sooner has no way over which its motion can be moved."""


@dataclass(frozen=True)
class SourceDemo:
    """A demonstration: T ticks.

    Attributes:
        q: Joint targets (T, n) [rad].
        gripper: Opening targets (T, 2).
        hands: T_world_tcp (T, 2, 4, 4) of the targets.
        start, goal: Of the object.
        near: Tick of each hand at which its object-centred segment begins.
        held: First tick at which both hands are closed.
        released: First tick after it at which a hand opens.
    """

    name: str
    rate_hz: float
    q: Array
    gripper: Array
    hands: Array
    start: Placement
    goal: Placement
    near: tuple[int, int]
    held: int
    released: int


def source_demo(
    episode: Episode,
    name: str,
    kinematics: Kinematics,
    near_m: float,
) -> SourceDemo:
    """Return the segments of an episode.

    Raises:
        DataError: It has no place of the object, or another order of grasps and releases.
    """
    start = _placement(episode, START, name)
    goal = _placement(episode, GOAL, name)
    switches = [grip_changes(episode.action_gripper[:, hand]) for hand in range(len(SIDES))]
    for side, of_hand in zip(SIDES, switches, strict=True):
        if len(of_hand) != 2:
            raise DataError(
                f"{name}: the {side} hand closes and opens {len(of_hand)} times in all; "
                "a carry has one grasp and one release of each hand",
            )
    closes = [of_hand[0] for of_hand in switches]
    opens = [of_hand[1] for of_hand in switches]
    if max(closes) >= min(opens):
        raise DataError(f"{name}: a hand opens before the other one has closed")
    hands = np.array([np.stack(kinematics.tcp_poses(row)) for row in episode.action])
    near = tuple(_near_tick(hands[:, k, :3, 3], closes[k], near_m) for k in range(len(SIDES)))
    if min(near) < _APPROACH_TICKS_MIN:
        raise DataError(f"{name}: a hand begins within {near_m:g} m of its grasp")
    return SourceDemo(
        name=name,
        rate_hz=episode.meta.fps,
        q=episode.action,
        gripper=episode.action_gripper,
        hands=hands,
        start=start,
        goal=goal,
        near=(near[0], near[1]),
        held=max(closes),
        released=min(opens),
    )


def read_sources(
    text: str,
    kinematics: Kinematics,
    near_m: float,
    demonstrations_n: int,
) -> tuple[list[SourceDemo], list[str]]:
    """Return the usable demonstrations at a path, and why others are not.

    Args:
        text: A recording, a run, or a folder of HDF5 episodes.
        kinematics: Of the arms.
        near_m: Distance from its grasp at which a hand's segment begins.
        demonstrations_n: At most so many are read; 0: all.

    Raises:
        UsageError: There are none.
    """
    paths = source_paths(text)
    if not paths:
        raise UsageError(
            f"there are no HDF5 episodes at '{text}'",
            remedy="name a run, a recording, or a folder of episodes: minidual teleop-record",
        )
    if demonstrations_n:
        paths = paths[:demonstrations_n]
    sources: list[SourceDemo] = []
    refused: list[str] = []
    for path in paths:
        try:
            episode = read_episode(path, cameras=())
            sources.append(source_demo(episode, path.name, kinematics, near_m))
        except DataError as error:
            refused.append(error.message)
    if not sources:
        raise UsageError(
            f"none of {len(paths)} episodes at '{text}' can be moved: {shortened(refused, 2, '; ')}",
            remedy="record a carry: minidual teleop-record --task rod_carry",
        )
    return sources, refused


def source_paths(text: str) -> list[Path]:
    """Return the episodes at a path: a recording, a run, or a folder of them."""
    for inner in _PLACES:
        paths = episode_paths(Path(text) / inner)
        if paths:
            return paths
    return []


def _placement(episode: Episode, fact: str, name: str) -> Placement:
    values = episode.meta.extra.get(fact)
    if not isinstance(values, list) or len(values) != 3:
        raise DataError(f"{name}: it does not say '{fact}', where the object was")
    x, y, yaw = (float(value) for value in values)
    return x, y, yaw


def _near_tick(positions: Array, closes: int, near_m: float) -> int:
    """Return the tick after which a hand stays within `near_m` of its grasp until it closes."""
    distances = np.linalg.norm(positions[: closes + 1] - positions[closes], axis=1)
    far = np.flatnonzero(distances > near_m)
    return int(far[-1]) + 1 if len(far) else 0
