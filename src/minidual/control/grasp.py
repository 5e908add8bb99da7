"""The grasp matrix: object motion and internal force as two orthogonal parts.

Two hands at p_L and p_R act on an object at p with wrenches f_i = [force; torque], all in world-aligned axes.
The object feels

    w = G f,      G = [ I      0   I      0 ]      r_i = p_i - p,   f = [f_L; f_R]  (12,)
                      [ [r_L]x I   [r_R]x I ]

and every f splits into the part that moves the object and the part that only squeezes it:

    f = G^+ w + (I - G^+ G) f_int,      G^+ = G^T (G G^T)^-1

The null space of G holds the internal forces: equal and opposite wrenches that do no work on a rigid object.
Source: Siciliano, Khatib, Springer Handbook of Robotics, 2nd ed., ch. 38 (grasping), sec. 38.2.
"""

from __future__ import annotations

import numpy as np

from minidual.robot.constants import Array


def skew(p: Array) -> Array:
    """Return the (3, 3) matrix of the cross product with p, so that its product with f is p x f."""
    return np.array([[0.0, -p[2], p[1]], [p[2], 0.0, -p[0]], [-p[1], p[0], 0.0]])


class GraspMap:
    """Grasp matrix of two hands.

    Args:
        r_left: (3,) from the object's centre of mass to the left hand's contact, world axes [m].
        r_right: (3,) likewise for the right hand.
    """

    def __init__(self, r_left: Array, r_right: Array) -> None:
        G = np.zeros((6, 12))
        G[0:3, 0:3] = G[0:3, 6:9] = G[3:6, 3:6] = G[3:6, 9:12] = np.eye(3)
        G[3:6, 0:3] = skew(r_left)
        G[3:6, 6:9] = skew(r_right)
        self.G = G
        self._gram = G @ G.T  # positive definite for any two points: each hand can apply a full wrench

    def motion_part(self, w: Array) -> Array:
        """Return G^+ w, (12,): the least hand wrenches that put wrench w (6,) on the object."""
        return self.G.T @ np.linalg.solve(self._gram, w)

    def internal_part(self, f: Array) -> Array:
        """Return (I - G^+ G) f, (12,): what of f (12,) only squeezes."""
        return f - self.G.T @ np.linalg.solve(self._gram, self.G @ f)

    def distribute(self, w: Array, f_int: Array) -> Array:
        """Return hand wrenches (12,): object wrench w (6,) plus the internal part of f_int (12,).

        G^+ w + (I - G^+ G) f_int = f_int + G^+ (w - G f_int), one solve instead of two.
        """
        return f_int + self.G.T @ np.linalg.solve(self._gram, w - self.G @ f_int)


def squeeze_reference(axis: Array, force_n: float) -> Array:
    """Return f_int (12,) [N]: both hands press towards each other along the object's axis.

    Args:
        axis: (3,) unit vector from the right to the left hand, world axes; it turns with the object.
        force_n: Squeeze.
    """
    f = np.zeros(12)
    f[0:3] = -force_n * axis
    f[6:9] = force_n * axis
    return f
