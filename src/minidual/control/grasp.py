"""The grasp matrix: object motion and internal force as two orthogonal parts.

Two hands at p_L and p_R act on an object at p with wrenches f_i = [force; torque], all in world-aligned axes.
The object feels

    w = G f,      G = [ I      0   I      0 ]      r_i = p_i - p,   f = [f_L; f_R]  (12,)
                      [ [r_L]x I   [r_R]x I ]

and every f splits into the part that moves the object and the part that only squeezes it:

    f = G^+ w + (I - G^+ G) f_int,      G^+ = G^T (G G^T)^-1

The null space of G holds the internal forces: equal and opposite wrenches that do no work on a rigid object.
Source: Siciliano, Khatib, Springer Handbook of Robotics, 2nd ed., ch. 38 (grasping), sec. 38.2.

The blocks of G are so plain that G^+ needs no solver. With the middle of the hands m = (r_L + r_R) / 2, half their
span h = (r_L - r_R) / 2 and the moment about the middle n = w_n - m x w_f,

    lambda = (n + h (h . n)) / (2 + 2 h . h)
    G^+ w  = [ w_f / 2 + lambda x h ; lambda ; w_f / 2 - lambda x h ; lambda ]

Each hand takes half the force; of the moment each takes lambda as a torque, and the couple of opposite forces
+-lambda x h, with lever h to either side, takes the rest. docs/force-control.md derives it.
"""

from __future__ import annotations

import numpy as np

from minidual.robot.constants import Array
from minidual.robot.vectors import ZERO, Vector


def skew(p: Array) -> Array:
    """Return the (3, 3) matrix of the cross product with p, so that its product with f is p x f."""
    return np.array([[0.0, -p[2], p[1]], [p[2], 0.0, -p[0]], [-p[1], p[0], 0.0]])


class GraspMap:
    """Grasp matrix of two hands.

    Args:
        r_left: (3,) from the object's centre of mass to the left hand's contact, world axes [m].
        r_right: (3,) likewise for the right hand.
    """

    def __init__(self, r_left: Vector | Array, r_right: Vector | Array) -> None:
        self._r_left, self._r_right = r_left, r_right

    @property
    def G(self) -> Array:
        """The matrix itself (6, 12)."""
        G = np.zeros((6, 12))
        G[0:3, 0:3] = G[0:3, 6:9] = G[3:6, 3:6] = G[3:6, 9:12] = np.eye(3)
        G[3:6, 0:3] = skew(np.asarray(self._r_left))
        G[3:6, 6:9] = skew(np.asarray(self._r_right))
        return G

    def motion_part(self, w: Array) -> Array:
        """Return G^+ w, (12,): the least hand wrenches that put wrench w (6,) on the object."""
        return np.array(self.hand_wrenches(w[:3].tolist(), w[3:].tolist()))

    def internal_part(self, f: Array) -> Array:
        """Return (I - G^+ G) f, (12,): what of f (12,) only squeezes."""
        return f - self.motion_part(self.G @ f)

    def distribute(self, w: Array, f_int: Array) -> Array:
        """Return hand wrenches (12,): object wrench w (6,) plus the internal part of f_int (12,).

        G^+ w + (I - G^+ G) f_int = f_int + G^+ (w - G f_int), one pseudo-inverse instead of two.
        """
        return f_int + self.motion_part(w - self.G @ f_int)

    def hand_wrenches(self, force: Vector, moment: Vector, squeeze: Vector = ZERO) -> list[float]:
        """Return `distribute` for the squeeze f_int = [-squeeze; 0; squeeze; 0], in plain floats, 12 of them.

        Written out by components: it runs at 1 kHz.

        Args:
            force: Three, to put on the object [N].
            moment: Three, about the object's centre of mass [Nm].
            squeeze: Three [N], along the object's axis from the right to the left hand. G f_int is no force and the
                moment -2 h x squeeze: none at all if the hands lie on that axis, taken out again if they do not.
        """
        lx, ly, lz = self._r_left
        rx, ry, rz = self._r_right
        mx, my, mz = 0.5 * (lx + rx), 0.5 * (ly + ry), 0.5 * (lz + rz)
        hx, hy, hz = 0.5 * (lx - rx), 0.5 * (ly - ry), 0.5 * (lz - rz)
        fx, fy, fz = force
        nx, ny, nz = moment
        sx, sy, sz = squeeze
        # n = moment - m x force + 2 h x squeeze
        nx += mz * fy - my * fz + 2.0 * (hy * sz - hz * sy)
        ny += mx * fz - mz * fx + 2.0 * (hz * sx - hx * sz)
        nz += my * fx - mx * fy + 2.0 * (hx * sy - hy * sx)
        # turn = lambda = (n + h (h . n)) / (2 (1 + h . h))
        share = 0.5 / (1.0 + hx * hx + hy * hy + hz * hz)
        along = hx * nx + hy * ny + hz * nz
        tx, ty, tz = share * (nx + along * hx), share * (ny + along * hy), share * (nz + along * hz)
        # press = lambda x h - squeeze: what the left hand adds to its half of the force, and the right hand opposes
        px, py, pz = ty * hz - tz * hy - sx, tz * hx - tx * hz - sy, tx * hy - ty * hx - sz
        ax, ay, az = 0.5 * fx, 0.5 * fy, 0.5 * fz
        return [ax + px, ay + py, az + pz, tx, ty, tz, ax - px, ay - py, az - pz, tx, ty, tz]


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
