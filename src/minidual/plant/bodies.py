"""True state of an object, and its contacts with the hands."""

import math
from collections.abc import Sequence

import mujoco
import numpy as np
from numba.core import types

from minidual.config.scene import PartConfig
from minidual.robot.compiled import ROWS, VECTOR, bound, kernel
from minidual.robot.pair import Array, Robot, pose

type Vector = tuple[float, float, float]
ObjectPose = Array | tuple[float, float, float]
"""(4, 4), or (x, y, yaw) [m, m, rad] resting on the table."""


def contact_sensor(name: str, side: str, finger_link: str) -> str:
    """Return the name of a finger's contact sensor."""
    return f"{name}_{side}_{finger_link}"


@kernel(types.void(ROWS, ROWS, VECTOR, *[types.float64[:]] * 2, VECTOR))
def look(pads: Array, R: Array, p: Array, left: Array, right: Array, seen: Array) -> None:
    """Fill `seen` (16,); see `NamedObject.look`.

    pads: (4, 3), forces of the fingers, two of each hand [N]. left, right: (3,), finger axes.
    """
    for i in range(3):
        seen[i], seen[3 + i] = p[i], R[2, i]
    # The left finger (+y) pushes along -y, the right one along +y.
    for hand, axis in enumerate((left, right)):
        a = pads[2 * hand]
        b = pads[2 * hand + 1]
        along_a = a[0] * axis[0] + a[1] * axis[1] + a[2] * axis[2]
        along_b = b[0] * axis[0] + b[1] * axis[1] + b[2] * axis[2]
        seen[12 + hand] = max(0.0, min(-along_a, along_b))
        for i in range(3):
            seen[6 + 3 * hand + i] = a[i] + b[i]
    inward_left = inward_right = 0.0
    for i in range(3):
        inward_left -= seen[6 + i] * R[i, 1]
        inward_right += seen[9 + i] * R[i, 1]
    seen[14], seen[15] = min(inward_left, inward_right), math.atan2(-R[0, 1], R[1, 1])


@kernel(types.UniTuple(types.float64, 2)(VECTOR, ROWS, types.boolean))
def lie(seen: Array, solids: Array, upright: bool) -> tuple[float, float]:
    """Return the tilt [rad] of the long axis and the height [m] of the lowest point; see `ObjectTruth`.

    seen: (16,), see `NamedObject.look`. solids: (k, 8), place, half extents, whether it is round, and its axis.
    """
    lowest = math.inf
    for part in solids:
        down = 0.0
        low = 0.0
        axis = int(part[-1])
        for i in range(3):
            down = down + abs(seen[3 + i]) * part[3 + i]
            low = low + seen[3 + i] * part[i]
        if part[6]:
            along = min(1.0, abs(seen[3 + axis]))
            down = part[3 + axis] * along + part[3] * math.sqrt(1.0 - along**2)
        if not low - down >= lowest:  # true for NaN
            lowest = low - down
    along = min(1.0, abs(seen[5 if upright else 4]))  # vertical share of the long axis
    return (math.acos(along) if upright else math.asin(along)), seen[2] + lowest


@kernel(types.boolean(types.Array(types.int32, 2, "A"), types.int32[::1], types.int64, types.int64))
def touching(geoms: Array, body_of: Array, a: int, b: int) -> bool:
    """Return whether contacts, pairs of geoms (k, 2), join two bodies."""
    for pair in geoms:
        first = body_of[pair[0]]
        second = body_of[pair[1]]
        if (first == a and second == b) or (first == b and second == a):
            return True
    return False


@kernel(types.void(VECTOR, types.int64[::1], types.float64, VECTOR))
def halves(values: Array, rows: Array, scale: float, sums: Array) -> None:
    """Fill each hand's sum (2,), scaled."""  # to return an array takes as long again
    for hand in range(2):
        sums[hand] = scale * (values[rows[2 * hand]] + values[rows[2 * hand + 1]])


class NamedObject:
    """Reads one object through cached views."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, name: str, robot: Robot) -> None:
        self.body = int(model.body(name).id)
        joint = int(model.body_jntadr[self.body])
        position = int(model.jnt_qposadr[joint])
        velocity = int(model.jnt_dofadr[joint])
        self.qpos = data.qpos[position : position + 7]
        self.qvel = data.qvel[velocity : velocity + 6]
        self._omega = self.qvel[3:]
        self._model = model
        self._first = int(model.body_geomadr[self.body])
        self._rest_height_m = float(model.qpos0[position + 2])
        self.frame = self._R, self._p = data.xmat[self.body].reshape(3, 3), data.xpos[self.body]
        first = int(
            model.sensor(contact_sensor(name, robot.sides[0], robot.hand.finger_links[0])).adr[0],
        )
        pads = data.sensordata[first : first + 12].reshape(4, 3)
        palms = [int(model.body(palm).id) for palm in robot.both(robot.hand.palm_link)]
        axes = [data.xmat[palm].reshape(3, 3)[:, 1] for palm in palms]
        self._seen = np.zeros(16)
        self._look = bound(look, pads, self._R, self._p, *axes, self._seen)

    def solids(self, parts: Sequence[PartConfig]) -> list[tuple[Vector, Vector]]:
        """Return place and half extents (3,) [m] of its parts as they are now, in its frame."""
        found = list[tuple[Vector, Vector]]()
        for geom, part in enumerate(parts, self._first):
            (x, y, z) = self._model.geom_pos[geom].tolist()
            (a, b, c) = part.half_m
            scale = float(self._model.geom_size[geom, 0]) / a
            found.append(((x, y, z), (scale * a, scale * b, scale * c)))
        return found

    def pose(self) -> Array:
        """Return the pose (4, 4) in the world."""
        return pose(self._R, self._p)

    def twist(self) -> Array:
        """Return the twist (6,) at the centre of mass, world axes."""
        twist = self.qvel.copy()
        self._R.dot(self._omega, twist[3:])  # MuJoCo: v in world axes, w in the body's
        return twist

    def put(self, where: ObjectPose) -> None:
        """Write a pose; the velocity is kept."""
        if isinstance(where, tuple):
            x, y, yaw = where
            self.qpos[:3] = (x, y, self._rest_height_m)
            self.qpos[3:] = (np.cos(yaw / 2.0), 0.0, 0.0, np.sin(yaw / 2.0))
        else:
            self.qpos[:3] = where[:3, 3]
            mujoco.mju_mat2Quat(self.qpos[3:], np.ascontiguousarray(where[:3, :3]).ravel())

    def look(self) -> Array:
        """Return p (3), the third row of R (3), forces (6), pinches (2), internal force and yaw; overwritten by the next."""
        self._look()
        return self._seen

    def forces(self) -> Array:
        """Return each hand's net force (2, 3) [N] on the object, world axes."""
        return self.look()[6:12].reshape(2, 3).copy()

    def pinch(self) -> Array:
        """Return pinches (2,) [N]: normal force of each hand's weaker finger."""
        return self.look()[12:14].copy()

    def internal_force(self) -> float:
        """Return the internal force along y [N]; the left hand is at the +y end.

        The smaller of the hands' axial forces towards each other: negative under tension, at most zero with one hand.
        """
        return float(self.look()[14])
