"""Inverse dynamics of many states in one call."""

from __future__ import annotations

import functools

import numpy as np

from minidual.proof.rnea import arm_torques, link_table
from minidual.robot.compiled import floats
from minidual.robot.constants import ARMS, DOF, GROUPS, Array
from minidual.robot.kinematics import Kinematics


@functools.cache
def _arm(arm: str) -> tuple[Array, float]:
    """Return the links of one arm and gravity [m/s^2]: the two arms share no moving part, so each is computed alone."""
    model = Kinematics().model
    gravity = model.gravity.linear
    if gravity[0] != 0.0 or gravity[1] != 0.0:
        raise ValueError(f"gravity is {gravity}; it must point along the world's z axis")
    return link_table(model, GROUPS[f"{arm}_arm"]), -float(gravity[2])


def torques(q: Array, v: Array, a: Array) -> Array:
    """Return the torques (n, 14) [Nm] for n states; those of `Kinematics.rnea` state by state, up to rounding.

    Args:
        q: (n, 14) [rad].
        v: (n, 14) [rad/s].
        a: (n, 14) [rad/s^2].

    Raises:
        ValueError: Other shapes.
    """
    q, v, a = (floats(x) for x in (q, v, a))
    if not q.shape == v.shape == a.shape == (len(q), DOF):
        raise ValueError(f"states need q, v, a of shape (n, {DOF}); got {q.shape}, {v.shape}, {a.shape}")
    out = np.empty_like(q)
    for arm in ARMS:
        links, gravity = _arm(arm)
        arm_torques(links, gravity, q, v, a, GROUPS[f"{arm}_arm"].start, out)
    return out
