"""True state of an object, and its contacts with the hands."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt
from numba.core import types

from minidual.config.scene import PartConfig
from minidual.robot.compiled import ROWS, VECTOR, bound, kernel
from minidual.robot.pair import Array, Robot, pose

type Vector = tuple[float, float, float]
ObjectPose = Array | tuple[float, float, float]
"""(4, 4), or (x, y, yaw) [m, m, rad] resting on the table."""

# Layout of what `NamedObject.look` returns.
POSITION = 0
"""First of three: position of the frame [m]."""
VERTICAL = 3
"""First of three: third row of R, the world's vertical in the object's frame."""
HAND_FORCES = 6
"""First of six: force of each hand on the object (2, 3) [N], world axes."""
PINCHES = 12
"""First of two: normal force of each hand's weaker finger [N]."""
INTERNAL_FORCE = 14
YAW = 15
_LOOK_N = 16

# Layout of a row that describes one solid; see `lie`.
_CENTRE = 0
_HALF = 3
_IS_ROUND = 6
_AXIS = 7


def contact_sensor(name: str, side: str, finger_link: str) -> str:
    """Return the name of a finger's contact sensor."""
    return f"{name}_{side}_{finger_link}"


@kernel(types.void(ROWS, ROWS, VECTOR, *[types.float64[:]] * 2, VECTOR))
def look(pads: Array, R: Array, p: Array, left: Array, right: Array, seen: Array) -> None:
    """Fill `seen`, laid out as above.

    Args:
        pads: (4, 3), forces of the fingers, two of each hand [N].
        R: (3, 3), orientation of the object.
        p: (3,), its position [m].
        left: (3,), axis of the left hand along which its fingers move.
        right: (3,), the same of the right hand.
        seen: (16,), overwritten.
    """
    for i in range(3):
        seen[POSITION + i] = p[i]
        seen[VERTICAL + i] = R[2, i]
    # The left finger (+y) pushes along -y, the right one along +y.
    for hand, axis in enumerate((left, right)):
        a = pads[2 * hand]
        b = pads[2 * hand + 1]
        along_a = a[0] * axis[0] + a[1] * axis[1] + a[2] * axis[2]
        along_b = b[0] * axis[0] + b[1] * axis[1] + b[2] * axis[2]
        seen[PINCHES + hand] = max(0.0, min(-along_a, along_b))
        for i in range(3):
            seen[HAND_FORCES + 3 * hand + i] = a[i] + b[i]
    inward_left = 0.0
    inward_right = 0.0
    for i in range(3):
        inward_left -= seen[HAND_FORCES + i] * R[i, 1]
        inward_right += seen[HAND_FORCES + 3 + i] * R[i, 1]
    seen[INTERNAL_FORCE] = min(inward_left, inward_right)
    seen[YAW] = math.atan2(-R[0, 1], R[1, 1])


@kernel(types.UniTuple(types.float64, 2)(VECTOR, ROWS, types.boolean))
def lie(seen: Array, solids: Array, upright: bool) -> tuple[float, float]:
    """Return the tilt [rad] of the long axis and the height [m] of the lowest point.

    See `ObjectTruth`.

    Args:
        seen: (16,), see `NamedObject.look`.
        solids: (k, 8), centre (3,) [m], half extents (3,) [m], whether it is round, its axis.
        upright: Whether the long axis is z, else y.
    """
    lowest = math.inf
    for solid in solids:
        down = 0.0
        low = 0.0
        for i in range(3):
            down = down + abs(seen[VERTICAL + i]) * solid[_HALF + i]
            low = low + seen[VERTICAL + i] * solid[_CENTRE + i]
        if solid[_IS_ROUND]:
            axis = int(solid[_AXIS])
            along = min(1.0, abs(seen[VERTICAL + axis]))
            radius = solid[_HALF]
            down = solid[_HALF + axis] * along + radius * math.sqrt(1.0 - along**2)
        if not low - down >= lowest:  # true for NaN
            lowest = low - down
    long_axis = 2 if upright else 1
    along = min(1.0, abs(seen[VERTICAL + long_axis]))  # vertical share of the long axis
    tilt = math.acos(along) if upright else math.asin(along)
    return tilt, seen[POSITION + 2] + lowest


@kernel(types.boolean(types.Array(types.int32, 2, "A"), types.int32[::1], types.int64, types.int64))
def touching(geoms: Array, body_of: Array, a: int, b: int) -> bool:
    """Return whether contacts, pairs of geoms (k, 2), join bodies a and b."""
    for pair in geoms:
        first = body_of[pair[0]]
        second = body_of[pair[1]]
        if (first == a and second == b) or (first == b and second == a):
            return True
    return False


@kernel(
    types.boolean(
        types.Array(types.int32, 2, "A"), types.int32[::1], types.boolean[::1], types.int64
    )
)
def touching_any(
    geoms: npt.NDArray[np.int32],
    body_of: npt.NDArray[np.int32],
    members: npt.NDArray[np.bool_],
    body: int,
) -> bool:
    """Return whether contacts, pairs of geoms (k, 2), join a body with one of the members (nbody,)."""
    for pair in geoms:
        first = body_of[pair[0]]
        second = body_of[pair[1]]
        if (first == body and members[second]) or (second == body and members[first]):
            return True
    return False


def bodies_below(model: mujoco.MjModel, joint_names: Sequence[str]) -> npt.NDArray[np.bool_]:
    """Return which bodies (nbody,) any of these joints moves."""
    moved = np.zeros(model.nbody, dtype=bool)
    for name in joint_names:
        moved[model.joint(name).bodyid] = True
    for body, parent in enumerate(model.body_parentid):  # parents come first
        moved[body] |= moved[parent]
    return moved


@kernel(types.void(VECTOR, types.int64[::1], types.float64, VECTOR))
def halves(values: Array, rows: Array, scale: float, sums: Array) -> None:
    """Fill `sums` (2,) with each hand's sum of two values, scaled.

    Returning an array would double the time.
    """
    for hand in range(2):
        sums[hand] = scale * (values[rows[2 * hand]] + values[rows[2 * hand + 1]])


class ObjectFrame(NamedTuple):
    """Orientation R (3, 3) and position p (3,) [m] in the world, views of MuJoCo's memory."""

    R: Array
    p: Array


class NamedObject:
    """Reads one object through cached views.

    Attributes:
        body: Id of the body.
        qpos: View (7,): position [m] and quaternion.
        qvel: View (6,): velocity in world axes, angular velocity in the body's.
        frame: Present pose.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, name: str, robot: Robot) -> None:
        self.body = int(model.body(name).id)
        joint = int(model.body_jntadr[self.body])
        position = int(model.jnt_qposadr[joint])
        velocity = int(model.jnt_dofadr[joint])
        self.qpos = data.qpos[position : position + 7]
        self.qvel = data.qvel[velocity : velocity + 6]
        self._omega = self.qvel[3:]
        self._model = model
        self._first_geom = int(model.body_geomadr[self.body])
        self._rest_height_m = float(model.qpos0[position + 2])
        self.frame = ObjectFrame(data.xmat[self.body].reshape(3, 3), data.xpos[self.body])
        first_sensor = contact_sensor(name, robot.sides[0], robot.hand.finger_links[0])
        first = int(model.sensor(first_sensor).adr[0])
        pads = data.sensordata[first : first + 12].reshape(4, 3)
        palms = [int(model.body(palm).id) for palm in robot.both(robot.hand.palm_link)]
        left, right = (data.xmat[palm].reshape(3, 3)[:, 1] for palm in palms)
        self._seen = np.zeros(_LOOK_N)
        self._look = bound(look, pads, self.frame.R, self.frame.p, left, right, self._seen)

    def solids(self, parts: Sequence[PartConfig]) -> list[tuple[Vector, Vector]]:
        """Return centre and half extents (3,) [m] of its parts as compiled, in its frame."""
        solids: list[tuple[Vector, Vector]] = []
        for geom, part in enumerate(parts, self._first_geom):
            x, y, z = self._model.geom_pos[geom].tolist()
            a, b, c = part.half_m
            scale = float(self._model.geom_size[geom, 0]) / a
            solids.append(((x, y, z), (scale * a, scale * b, scale * c)))
        return solids

    def pose(self) -> Array:
        """Return the pose (4, 4) in the world."""
        return pose(self.frame.R, self.frame.p)

    def twist(self) -> Array:
        """Return the twist (6,) at the centre of mass, world axes."""
        twist = self.qvel.copy()
        self.frame.R.dot(self._omega, twist[3:])  # MuJoCo: v in world axes, omega in the body's
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
        """Return all that the success tests read, (16,), overwritten by the next call.

        POSITION, VERTICAL, HAND_FORCES, PINCHES, INTERNAL_FORCE and YAW are its indices.
        """
        self._look()
        return self._seen

    def forces(self) -> Array:
        """Return each hand's net force (2, 3) [N] on the object, world axes."""
        return self.look()[HAND_FORCES:PINCHES].reshape(2, 3).copy()

    def pinch(self) -> Array:
        """Return pinches (2,) [N]: normal force of each hand's weaker finger."""
        return self.look()[PINCHES:INTERNAL_FORCE].copy()

    def internal_force(self) -> float:
        """Return the internal force along y [N]; the left hand is at the +y end.

        The smaller of the hands' axial forces towards each other: negative under tension, at most
        zero with one hand.
        """
        return float(self.look()[INTERNAL_FORCE])
