"""True state of an object, and its contacts with the hands."""

from __future__ import annotations

import mujoco
import numpy as np

from minidual.robot.pair import Array, Robot

ObjectPose = Array | tuple[float, float, float]
"""(4, 4), or (x, y, yaw) [m, m, rad] resting on the table."""


def contact_sensor(name: str, side: str, finger_link: str) -> str:
    """Return the name of a finger's contact sensor."""
    return f"{name}_{side}_{finger_link}"


_IDENTITY = np.eye(4)


class NamedObject:
    """Reads one object through cached views."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, name: str, robot: Robot) -> None:
        self.body = int(model.body(name).id)
        joint = int(model.body_jntadr[self.body])
        position, velocity = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        self.qpos, self.qvel = data.qpos[position : position + 7], data.qvel[velocity : velocity + 6]
        self._omega = self.qvel[3:]
        self._rest_height_m = float(model.qpos0[position + 2])
        self._R, self._p = data.xmat[self.body].reshape(3, 3), data.xpos[self.body]
        self._axis = self._R[:, 1]
        hand = robot.hand
        first = int(model.sensor(contact_sensor(name, robot.sides[0], hand.finger_links[0])).adr[0])
        self._readings = data.sensordata[first : first + 12].reshape(4, 3)
        self._forces = self._readings.reshape(2, 2, 3)  # arm, finger, force
        palms = [int(model.body(palm).id) for palm in robot.both(robot.hand.palm_link)]
        self._hand_axes = [data.xmat[palm].reshape(3, 3)[:, 1] for palm in palms]  # finger axes

    def pose(self) -> Array:
        """Return the pose (4, 4) in the world."""
        T = _IDENTITY.copy()  # `np.eye` takes five times as long
        T[:3, :3], T[:3, 3] = self._R, self._p
        return T

    def twist(self) -> Array:
        """Return the twist (6,) at the centre of mass, world axes."""
        twist = self.qvel.copy()
        self._R.dot(self._omega, twist[3:])  # MuJoCo: v in world axes, w in the body's
        return twist

    def put(self, pose: ObjectPose) -> None:
        """Write a pose; the velocity is kept."""
        if isinstance(pose, tuple):
            x, y, yaw = pose
            self.qpos[:3] = (x, y, self._rest_height_m)
            self.qpos[3:] = (np.cos(yaw / 2.0), 0.0, 0.0, np.sin(yaw / 2.0))
        else:
            self.qpos[:3] = pose[:3, 3]
            mujoco.mju_mat2Quat(self.qpos[3:], np.ascontiguousarray(pose[:3, :3]).ravel())

    def forces(self) -> Array:
        """Return each hand's net force (2, 3) [N] on the object, world axes."""
        return self._forces[:, 0] + self._forces[:, 1]

    def pinch(self) -> Array:
        """Return pinches (2,) [N]: normal force of each hand's weaker finger."""
        # The left finger (+y) pushes along -y, the right one along +y.
        along = (self._forces[arm].dot(axis).tolist() for arm, axis in enumerate(self._hand_axes))
        return np.array([max(0.0, min(-left, right)) for left, right in along])

    def internal_force(self) -> float:
        """Return the internal force along y [N]; the left hand is at the +y end.

        The smaller of the hands' axial forces towards each other: negative under tension, at most zero with one hand.
        """
        a, b, c, d = self._readings.dot(self._axis).tolist()
        return min(-a - b, c + d)
