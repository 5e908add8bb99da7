"""Inverse dynamics of many states in one call."""

from __future__ import annotations

import functools

import numpy as np
import pinocchio as pin

from minidual.robot.constants import Array
from minidual.robot.kinematics import Kinematics


@functools.cache
def _pool() -> pin.ModelPool:
    return pin.ModelPool(Kinematics().model, 1)


def torques(q: Array, v: Array, a: Array) -> Array:
    """Return the torques (n, 14) [Nm] for n states; the same numbers as `Kinematics.rnea` state by state.

    Args:
        q: (n, 14) [rad].
        v: (n, 14) [rad/s].
        a: (n, 14) [rad/s^2].
    """
    if len(q) == 0:
        return np.zeros_like(q)
    return np.array(pin.rneaInParallel(1, _pool(), *(np.asfortranarray(x.T) for x in (q, v, a)))).T
