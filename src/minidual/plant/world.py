"""The simulated world: one step of physics, and what its sensors say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from minidual.config.scene import SceneConfig
from minidual.errors import MinidualError, UsageError
from minidual.plant.addresses import map_joints
from minidual.plant.model import build_model
from minidual.robot.arms import DUAL_PANDA
from minidual.robot.pair import Array, Robot
from minidual.robot.poses import quat_from_yaw

if TYPE_CHECKING:
    from collections.abc import Callable

    from minidual.plant.recorder import Recorder


class SimulationDivergedError(MinidualError):
    """The state or a command stopped being finite."""


_NOT_FINITE: tuple[tuple[mujoco.mjtWarning, str], ...] = (
    (mujoco.mjtWarning.mjWARN_BADQPOS, "positions"),
    (mujoco.mjtWarning.mjWARN_BADQVEL, "velocities"),
    (mujoco.mjtWarning.mjWARN_BADQACC, "accelerations"),
    (mujoco.mjtWarning.mjWARN_BADCTRL, "commands"),
)
"""MuJoCo only counts these: it resets the state, or sets bad commands to zero, and carries on."""


@dataclass(frozen=True)
class ContactWrench:
    """Net contact of the two fingers of one hand on the rod, world axes.

    Attributes:
        force: (3,) [N], of the hand on the rod.
        torque: (3,) [Nm], about the rod's centre of mass.
        pinch: Normal force of the weaker finger [N]; zero unless both touch.
    """

    force: Array
    torque: Array
    pinch: float


class World:
    """Two arms, two grippers, a rod and a table at 1 kHz.

    Write torques and finger targets with `command`, then `step`. Readings are copies.

    Args:
        scene: Physics, rod and task.
        robot: The two arms.
        visuals: Compile the visual meshes; needed only to render.
        model: Reuse a compiled model (it must come from `build_model`).
    """

    def __init__(
        self,
        scene: SceneConfig,
        robot: Robot = DUAL_PANDA,
        *,
        visuals: bool = False,
        model: mujoco.MjModel | None = None,
    ) -> None:
        self.scene, self.robot = scene, robot
        self.model = build_model(scene, robot, visuals=visuals) if model is None else model
        self.data = mujoco.MjData(self.model)
        self._warnings = self.data.warning.number  # a view: counts by kind of warning
        self._no_warnings = bytes(self._warnings.nbytes)
        self.dt = float(self.model.opt.timestep)
        self.joints = map_joints(self.model, robot.joint_names, torque=True)
        self.fingers = map_joints(self.model, robot.finger_joint_names, torque=False)
        self._rod_body = self.model.body("rod").id
        free = self.model.joint("rod_free")
        self._rod_qpos, self._rod_qvel = int(free.qposadr[0]), int(free.dofadr[0])
        self._hand_bodies = [self.model.body(name).id for name in robot.palm_names]
        start = int(self.model.sensor(f"{robot.sides[0]}_{robot.hand.finger_links[0]}_contact").adr[0])
        self._contacts = self.data.sensordata[start : start + 36].reshape(2, 2, 9)  # a view: arm, finger, field
        # Views, made once: a field of MjData costs as much to look up as three of its numbers to read.
        data, rod = self.data, self._rod_body
        self._qpos, self._qvel, self._ctrl, self._force = data.qpos, data.qvel, data.ctrl, data.actuator_force
        self._rod_R, self._rod_p = data.xmat[rod].reshape(3, 3), data.xpos[rod]
        self._rod_axis = self._rod_R[:, 1]
        self._twist = np.zeros(6)
        self._twist_v, self._twist_w = self._twist[:3], self._twist[3:]
        self._T = np.eye(4)
        self._T_rotation, self._T_position = self._T[:3, :3], self._T[:3, 3]
        self._rod_v, self._rod_w = np.split(self._qvel[self._rod_qvel : self._rod_qvel + 6], 2)
        self._contact_forces = self._contacts[:, :, :3]
        self._readings, self._along = self._contacts.reshape(4, 9), np.zeros(9)
        self._hand_axes = [data.xmat[body].reshape(3, 3)[:, 1] for body in self._hand_bodies]
        self._finger_ctrl = tuple(np.ascontiguousarray(self.fingers.ctrl.reshape(2, 2).T))  # a strided index is slow
        self.recorder: Recorder | None = None
        """Keeps what a replay needs, where one is wanted (see minidual.plant.recorder)."""
        self.observer: Callable[[World], None] | None = None
        """Called after every step, where somebody watches (see minidual.show.watch); it only reads."""
        self.reset()

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return float(self.data.time)

    @property
    def q(self) -> Array:
        """Joint positions (n,) [rad]."""
        return self._qpos[self.joints.qpos]

    @property
    def v(self) -> Array:
        """Joint velocities (n,) [rad/s]."""
        return self._qvel[self.joints.qvel]

    @property
    def tau(self) -> Array:
        """Torques (n,) [Nm] that the motors applied in the last step."""
        return self._force[self.joints.ctrl]

    @property
    def gripper(self) -> Array:
        """Opening of each hand (2,), 0 closed to 1 open."""
        fingers = self._qpos[self.fingers.qpos]
        return (fingers[0::2] + fingers[1::2]) / (2.0 * self.robot.hand.travel_m)

    @property
    def T_world_rod(self) -> Array:
        """Pose (4, 4) of the rod; its y axis is the long axis."""
        self._T_rotation[:] = self._rod_R
        self._T_position[:] = self._rod_p
        return self._T.copy()

    @property
    def rod_twist(self) -> Array:
        """Twist (6,) of the rod at its centre of mass, world axes."""
        self._twist_v[:] = self._rod_v
        self._rod_R.dot(self._rod_w, self._twist_w)  # MuJoCo keeps a free joint's angular velocity in the body frame
        return self._twist.copy()

    @property
    def contact_count(self) -> int:
        """Number of contacts."""
        return int(self.data.ncon)

    def contact_pairs(self) -> list[tuple[str, str, float]]:
        """Return (body, body, distance [m]) of every contact."""
        body = self.model.geom_bodyid
        return [
            (self.model.body(int(body[c.geom1])).name, self.model.body(int(body[c.geom2])).name, float(c.dist))
            for c in self.data.contact[: self.data.ncon]
        ]

    def pinch_forces(self) -> Array:
        """Return the pinch force of each hand on the rod (2,) [N]: normal force of its weaker finger."""
        forces = self._contact_forces
        pinches = []
        for arm, axis in enumerate(self._hand_axes):  # fingers move along the hand's y
            left, right = forces[arm].dot(axis).tolist()
            # The left finger (+y) pushes towards -y, the right one towards +y.
            pinches.append(max(0.0, min(-left, right)))
        return np.array(pinches)

    def hand_forces(self) -> Array:
        """Return the net force of each hand on the rod (2, 3) [N], world axes, left then right."""
        return self._contact_forces[:, 0] + self._contact_forces[:, 1]

    def touches(self, geom: str) -> bool:
        """Return whether anything touches a geom, by its name."""
        index = self.model.geom(geom).id
        return bool((self.data.contact.geom[: self.data.ncon] == index).any())

    def contact_wrenches(self) -> tuple[ContactWrench, ContactWrench]:
        """Return the net wrench of each hand on the rod."""
        centre = self.data.xpos[self._rod_body]
        pinch = self.pinch_forces()
        result = []
        for arm in range(2):
            force = self._contacts[arm, :, :3].sum(axis=0)
            torque = np.zeros(3)
            for f in range(2):
                reading = self._contacts[arm, f]
                torque += reading[3:6] + np.cross(reading[6:9] - centre, reading[:3])
            result.append(ContactWrench(force, torque, float(pinch[arm])))
        return result[0], result[1]

    def internal_force(self) -> float:
        """Return the squeeze along the rod [N]: the smaller of the two hands' axial forces towards each other.

        Positive when the hands press towards each other, negative when they pull. One hand alone gives at most
        zero: the internal force is what both carry.
        """
        self._along[:3] = self._rod_axis  # picks the forces out of the four fingers' readings in one product
        a, b, c, d = self._readings.dot(self._along).tolist()
        return min(-a - b, c + d)  # the left hand holds the +y end

    def rod_on_table(self) -> bool:
        """Return whether the rod touches the table."""
        body = self.model.geom_bodyid
        table = self.model.body("table").id
        contacts = self.data.contact[: self.data.ncon]
        return any({int(body[c.geom1]), int(body[c.geom2])} == {table, self._rod_body} for c in contacts)

    def reset(self, q: Array | None = None, *, rod_xy_yaw: tuple[float, float, float] | None = None) -> None:
        """Put the arms at q (n,) (home by default), hands open, the rod at (x, y, yaw) on the table.

        Raises:
            UsageError: q has another shape, is not finite or leaves the joint limits.
        """
        robot = self.robot
        q = robot.home if q is None else np.asarray(q, dtype=float)
        if q.shape != (robot.dof,):
            raise UsageError(f"q has shape {q.shape}; it must be ({robot.dof},)")
        bad = ~((q >= robot.q_lower - 1e-9) & (q <= robot.q_upper + 1e-9))
        if bad.any():
            i = int(np.argmax(bad))
            lower, upper = robot.q_lower[i], robot.q_upper[i]
            raise UsageError(f"{robot.joint_names[i]} = {q[i]:.4f} rad; {lower:.4f} <= value <= {upper:.4f}")
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self.joints.qpos] = q
        self.data.qpos[self.fingers.qpos] = self.robot.hand.travel_m
        self.data.ctrl[self.fingers.ctrl] = self.robot.hand.travel_m
        x, y, yaw = (*self.scene.task.start_xy_m, 0.0) if rod_xy_yaw is None else rod_xy_yaw
        address = self._rod_qpos
        self.data.qpos[address : address + 3] = (x, y, self.scene.rod.rest_height_m)
        self.data.qpos[address + 3 : address + 7] = quat_from_yaw(yaw)
        mujoco.mj_forward(self.model, self.data)

    def command(self, tau: Array, finger_targets_m: Array) -> None:
        """Set the motors' torques (n,) [Nm] and each hand's finger target (2,) [m] (same for both fingers).

        Torques beyond the motors' limits are clipped by the actuators, as the real drives do.
        """
        self._ctrl[self.joints.ctrl] = tau
        left, right = self._finger_ctrl
        self._ctrl[left] = self._ctrl[right] = finger_targets_m

    def step(self) -> None:
        """Advance by one time step.

        Raises:
            SimulationDivergedError: The state or a command is not finite. MuJoCo has then reset the state.
        """
        before = self.data.time
        if self.recorder is not None:
            self.recorder.before_step()
        mujoco.mj_step(self.model, self.data)
        if self._warnings.tobytes() != self._no_warnings:  # a tenth of the time of `any`
            bad = [what for kind, what in _NOT_FINITE if self._warnings[int(kind)]]
            if bad:
                message = f"the simulation diverged at t = {before:.3f} s ({', '.join(bad)} not finite)"
                remedy = "check the commanded torques, the inertias and the time step"
                dump = None if self.recorder is None else self.recorder.dump("diverged", message)
                if dump is not None:
                    remedy += f"; minidual replay {dump} says what came first"
                raise SimulationDivergedError(message, remedy=remedy)
        if self.observer is not None:
            self.observer(self)
