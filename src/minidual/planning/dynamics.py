"""Inverse dynamics of many states in one call."""

from __future__ import annotations

import functools

import numpy as np
import pinocchio as pin

from minidual.robot.constants import ARMS, GROUPS, JOINT_NAMES, Array
from minidual.robot.kinematics import Kinematics


@functools.cache
def _pool(arm: str) -> pin.ModelPool:
    """Return the workspace of one arm alone: the two share no moving part, so each has its own dynamics."""
    full = Kinematics().model
    others = [full.getJointId(name) for name in JOINT_NAMES if not name.startswith(f"{arm}_")]
    model = pin.buildReducedModel(full, others, pin.neutral(full))
    model.armature = full.armature[GROUPS[f"{arm}_arm"]].copy()
    return pin.ModelPool(model, 1)


def torques(q: Array, v: Array, a: Array) -> Array:
    """Return the torques (n, 14) [Nm] for n states; the same numbers as `Kinematics.rnea` state by state.

    An arm that is held throughout is computed once.

    Args:
        q: (n, 14) [rad].
        v: (n, 14) [rad/s].
        a: (n, 14) [rad/s^2].
    """
    out = np.empty_like(q)
    for arm in ARMS:
        joints = GROUPS[f"{arm}_arm"]
        states = q[:, joints], v[:, joints], a[:, joints]
        if len(q) > 1 and not (states[1].any() or states[2].any() or np.ptp(states[0], axis=0).any()):
            states = tuple(x[:1] for x in states)
        if len(q):
            columns = (np.asfortranarray(x.T) for x in states)
            out[:, joints] = np.asarray(pin.rneaInParallel(1, _pool(arm), *columns)).T
    return out
