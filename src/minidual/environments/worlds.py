"""N simulations of one scene in one process, driven by joint targets as trials are."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from mujoco import batch

from minidual.config.control import SupervisorConfig
from minidual.config.scene import SceneConfig
from minidual.environments.kernels import Addresses, Driven, State, drive
from minidual.environments.laws import control_law
from minidual.environments.loads import Loads
from minidual.environments.touch import FIRST_TOUCH, add_touch_sensors, solids_of
from minidual.environments.transport_kernel import Scene
from minidual.plant.addresses import map_joints
from minidual.plant.bodies import contact_sensor
from minidual.plant.model import build_spec
from minidual.robot.pair import Array, Indices, Robot

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from minidual.tasks.task import Placement

RANDOMISED = (
    "body_mass",
    "body_inertia",
    "geom_friction",
    "dof_damping",
    "dof_frictionloss",
)
"""Fields of the model that may differ between worlds."""
_AT_NEW_STATE = int(mujoco.mjtStage.mjSTAGE_VEL)
_PADS_N = 12


class Worlds:
    """N worlds of a scene with one carried object.

    Each world runs the scene, the reference filter, the computed torque and the grippers of
    `JointLoop`. The inertia comes from MuJoCo instead of Pinocchio, with fingers where they are.

    Attributes:
        model: Of all worlds; `models` differ in RANDOMISED alone.
        time_s: (N,).
        loads: On the arms.

    Args:
        scene: Its first object is carried.
        frames: (2, n / 2 + 1, 4, 4), see `ArmIK.frames`.
        threads: Of the physics; 0 for all cores.
    """

    def __init__(
        self,
        scene: SceneConfig,
        robot: Robot,
        worlds_n: int,
        frames: Array,
        *,
        supervisor: SupervisorConfig | None = None,
        threads: int = 1,
    ) -> None:
        self.scene = scene
        self.robot = robot
        self.worlds_n = worlds_n
        self.name = scene.object.name
        spec = build_spec(scene, robot, visuals=False)
        touches_n = add_touch_sensors(spec, scene, robot)
        self.model = spec.compile()
        self.dt = float(self.model.opt.timestep)
        self._batch = batch.Batch(self.model, worlds_n, threads, persistent=True)
        self._bind(touches_n)
        self._at = self._addresses()
        self._law = control_law(robot, scene.physics.finger_force_max_n, self.dt)
        self.driven = Driven(
            np.zeros((worlds_n, robot.dof)),
            np.ones((worlds_n, 2)),
            np.zeros((worlds_n, 6, robot.dof)),
            np.ones((worlds_n, 4, 2)),
        )
        supervisor = SupervisorConfig() if supervisor is None else supervisor
        self.loads = Loads(robot, frames, supervisor, worlds_n, self.dt)
        self._goal = np.zeros((worlds_n, 3))

    # Building ----------------------------------------------------------------------------------

    def _bind(self, touches_n: int) -> None:
        """Keep views of the batch's memory."""
        bind = self._batch.bind
        self._state = State(
            qpos=bind("qpos"),
            qvel=bind("qvel"),
            ctrl=bind("ctrl"),
            M=bind("M").reshape(self.worlds_n, -1),
            bias=bind("qfrc_bias"),
            force=bind("actuator_force"),
            constraint=bind("qfrc_constraint"),
        )
        self._time = self._batch.bind("time").reshape(self.worlds_n)
        self._xpos = self._batch.bind("xpos")
        self._xmat = self._batch.bind("xmat").reshape(self.worlds_n, -1, 3, 3)
        sensors = self._batch.bind("sensordata")
        model = self.model
        first_finger = contact_sensor(
            self.name, self.robot.sides[0], self.robot.hand.finger_links[0]
        )
        first = int(model.sensor(first_finger).adr[0])
        self._pads = sensors[:, first : first + _PADS_N].reshape(self.worlds_n, 4, 3)
        touch = int(model.sensor(FIRST_TOUCH).adr[0])
        self._touches = np.zeros((self.worlds_n, 4))
        self._touch_data = sensors[:, touch : touch + touches_n]
        self._body = int(model.body(self.name).id)
        self._palms = [int(model.body(name).id) for name in self.robot.both(self._palm_link)]
        joint = int(model.body_jntadr[self._body])
        self._free_q = int(model.jnt_qposadr[joint])
        self._free_v = int(model.jnt_dofadr[joint])
        self._R = np.zeros((self.worlds_n, 3, 3))
        self._p = np.zeros((self.worlds_n, 3))
        self._axes = np.zeros((self.worlds_n, 2, 3))
        self.solids = solids_of(model, self.scene, self._body)

    @property
    def _palm_link(self) -> str:
        return self.robot.hand.palm_link

    def _addresses(self) -> Addresses:
        model = self.model
        joints = map_joints(model, self.robot.joint_names, torque=True)
        fingers = map_joints(model, self.robot.finger_joint_names, torque=False)
        return Addresses(
            joints.qpos,
            joints.qvel,
            joints.ctrl.astype(np.int64),
            fingers.qpos,
            fingers.ctrl.astype(np.int64),
            model.M_rownnz,
            model.M_rowadr,
            model.M_colind,
        )

    # Measurements ------------------------------------------------------------------------------

    @property
    def time_s(self) -> Array:
        """See the class."""
        return self._time.copy()

    @property
    def q(self) -> Array:
        """Joint positions (N, n) [rad]."""
        return self._state.qpos[:, self._at.q]

    @property
    def v(self) -> Array:
        """Joint velocities (N, n) [rad/s]."""
        return self._state.qvel[:, self._at.v]

    @property
    def tau(self) -> Array:
        """Motor torques (N, n) [Nm] of the last step."""
        return self._state.force[:, self._at.motor]

    @property
    def gripper(self) -> Array:
        """Openings (N, 2), 0 closed to 1 open."""
        places = self._state.qpos[:, self._at.finger].reshape(-1, 2, 2)
        return places.mean(axis=2) / self.robot.hand.travel_m

    @property
    def grip_n(self) -> Array:
        """Closing force (N, 2) of the last step."""
        forces = self._state.force[:, self._at.finger_motor].reshape(-1, 2, 2)
        return -forces.mean(axis=2)

    def object_poses(self) -> Array:
        """Return true poses (N, 4, 4) of the object."""
        Ts = np.zeros((self.worlds_n, 4, 4))
        Ts[:, :3, :3] = self._xmat[:, self._body]
        Ts[:, :3, 3] = self._xpos[:, self._body]
        Ts[:, 3, 3] = 1.0
        return Ts

    def object_twists(self) -> Array:
        """Return true twists (N, 6): velocity, world axes, and angular velocity, object axes."""
        return self._state.qvel[:, self._free_v : self._free_v + 6].copy()

    def data(self, world: int) -> mujoco.MjData:
        """Return a copy of one world's data, to render it."""
        return self._batch.get_data(world)

    # Changes -----------------------------------------------------------------------------------

    def differ(self) -> None:
        """Let the worlds have RANDOMISED of their own, see `set_model`."""
        self._own = {name: self._batch.expand(name) for name in RANDOMISED}

    def set_model(self, world: int, model: mujoco.MjModel) -> None:
        """Give a world RANDOMISED of a model with the same parts."""
        for name, values in self._own.items():
            values[world] = getattr(model, name)

    def reset(
        self, worlds: Indices, starts: Sequence[Placement], goals: Sequence[Placement]
    ) -> None:
        """Put arms at home with open hands, and the object at (x, y, yaw) of each world."""
        at = self._at
        self._batch.reset(worlds, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        travel_m = self.robot.hand.travel_m
        rest_m = float(self.model.qpos0[self._free_q + 2])
        for world, (x, y, yaw), goal in zip(worlds.tolist(), starts, goals, strict=True):
            qpos = self._state.qpos[world]
            qpos[at.q] = self.robot.home
            qpos[at.finger] = travel_m
            first = self._free_q
            qpos[first : first + 3] = x, y, rest_m
            qpos[first + 3 : first + 7] = np.cos(yaw / 2.0), 0.0, 0.0, np.sin(yaw / 2.0)
            self._state.ctrl[world, at.finger_motor] = travel_m
            self._goal[world] = goal
        if hasattr(self, "_own"):
            self._batch.set_const(worlds)
        self._batch.forward(worlds)
        self._restart_control(worlds)
        self._keep_poses()

    def _restart_control(self, worlds: Indices) -> None:
        driven = self.driven
        home = self.robot.home
        driven.target[worlds] = home
        driven.opening[worlds] = 1.0
        driven.reference[worlds] = 0.0
        for row in (0, 3, 4):  # position, and both ends of the ramp
            driven.reference[worlds, row] = home
        travel_m = self.robot.hand.travel_m
        rows = [[1.0, 1.0], [travel_m, travel_m], [math.nan, math.nan], [0.0, 0.0]]
        driven.hands[worlds] = np.array(rows)
        self.loads.reset(worlds)

    def advance(
        self, target: Array, opening: Array, steps_n: int, observe: Callable[[Scene], None]
    ) -> None:
        """Run physics steps towards joint targets (N, n) [rad] and openings (N, 2).

        `observe` is called after each; worlds that have diverged are reset by MuJoCo, see `diverged`.
        """
        driven = self.driven
        driven.target[:] = target
        driven.opening[:] = opening
        for _ in range(steps_n):
            drive(self._state, self._at, driven, self._law)
            self._batch.step(stage=_AT_NEW_STATE)
            self._touches[:, : self._touch_data.shape[1]] = self._touch_data
            observe(self._scene())
            self._keep_poses()
            self.loads.update(self._state, self._at, driven)

    def _scene(self) -> Scene:
        velocity = self._state.qvel[:, self._free_v : self._free_v + 3]
        return Scene(
            self.solids,
            self._R,
            self._p,
            self._axes,
            self._pads,
            self._touches,
            velocity,
            self._time,
            self._goal,
        )

    def _keep_poses(self) -> None:
        """Keep poses before the next step: a trial's judge reads them after it."""
        self._R[:] = self._xmat[:, self._body]
        self._p[:] = self._xpos[:, self._body]
        for hand, palm in enumerate(self._palms):
            self._axes[:, hand] = self._xmat[:, palm, :, 1]
