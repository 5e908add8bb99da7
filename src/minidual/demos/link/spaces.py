"""Spaces of a link: joints or numbers, or poses of hands."""

from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from minidual.robot.pair import Array


class Space(Protocol):
    """Places (..., P) and the motions (..., G, n) between them."""

    groups: tuple[str, ...]

    def between(self, start: Array, end: Array) -> Array:
        """Return the motion from one place to another."""
        ...

    def moved(self, start: Array, motion: Array) -> Array:
        """Return where a motion leads."""
        ...


class Coordinates:
    """Places are G times n coordinates, such as the joints of both arms.

    Args:
        groups: Their names.
        n: Coordinates of a group.
    """

    def __init__(self, groups: tuple[str, ...], n: int) -> None:
        self.groups = groups
        self._shape = (len(groups), n)

    def between(self, start: Array, end: Array) -> Array:
        """See `Space`."""
        return (end - start).reshape(*start.shape[:-1], *self._shape)

    def moved(self, start: Array, motion: Array) -> Array:
        """See `Space`."""
        return start + motion.reshape(start.shape)


class HandPoses:
    """Places are poses (4, 4) of the left and the right hand, flattened (1, 32).

    Translation [m] and rotation [rad] of each hand are groups of their own, in world axes.
    """

    groups: tuple[str, ...] = (
        "left translation",
        "left rotation",
        "right translation",
        "right rotation",
    )

    def between(self, start: Array, end: Array) -> Array:
        """See `Space`."""
        motion = np.empty((1, 4, 3))
        for arm, (T, T_end) in enumerate(zip(_poses(start), _poses(end), strict=True)):
            motion[0, 2 * arm] = T_end[:3, 3] - T[:3, 3]
            turn = Rotation.from_matrix(T_end[:3, :3] @ T[:3, :3].T)
            motion[0, 2 * arm + 1] = turn.as_rotvec()
        return motion

    def moved(self, start: Array, motion: Array) -> Array:
        """See `Space`."""
        poses = _poses(start).copy()
        for arm, T in enumerate(poses):
            T[:3, 3] += motion[0, 2 * arm]
            T[:3, :3] = Rotation.from_rotvec(motion[0, 2 * arm + 1]).as_matrix() @ T[:3, :3]
        return poses.reshape(1, 32)


def _poses(place: Array) -> Array:
    return place.reshape(2, 4, 4)
