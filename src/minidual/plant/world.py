"""The simulated world."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Protocol

import mujoco
import numpy as np

from minidual.config.scene import SceneConfig
from minidual.errors import UsageError, unknown_name
from minidual.plant.addresses import map_joints
from minidual.plant.bodies import (
    NamedObject,
    ObjectPose,
    bodies_below,
    halves,
    touching,
    touching_any,
)
from minidual.plant.brakes import JointBrakes
from minidual.plant.divergence import DivergenceWatch
from minidual.plant.marks import GOAL_MARK
from minidual.plant.model import build_model
from minidual.plant.protocol import PlantEndedError
from minidual.robot.compiled import bound
from minidual.robot.limits import clipped, joint_text, outside_limits
from minidual.robot.pair import DUAL_PANDA, Array, Robot


class StepRecorder(Protocol):
    """Records a world's steps; see `plant.recorder`."""

    def before_step(self) -> None:
        """Note the state and the commands of the next step."""
        ...

    def dump(self, name: str, reason: str) -> Path | None:
        """Write the last second, if there is a folder; return its file."""
        ...


class SimulationDivergedError(PlantEndedError):
    """A state or command is not finite."""


class World:
    """Two arms, a table and named objects; `command`, then `step`.

    Object name None means the only one. Rendering needs `visuals`; `model` reuses one from
    `build_model`.

    Attributes:
        joints: Addresses of the arms' joints.
        finger_joints: Addresses of the four finger joints.
        objects: Names of the objects, the carried one first.
        recorder: Records steps for replays, or None.
        observer: The viewer's callback after each step, which must only read, or None.
    """

    def __init__(
        self,
        scene: SceneConfig,
        robot: Robot = DUAL_PANDA,
        *,
        visuals: bool = False,
        model: mujoco.MjModel | None = None,
    ) -> None:
        self.scene = scene
        self.robot = robot
        self.grip_max_n = scene.physics.finger_force_max_n
        self.health = ""  # divergence raises in `step`
        self.model = build_model(scene, robot, visuals=visuals) if model is None else model
        self.data = mujoco.MjData(self.model)
        self.dt = float(self.model.opt.timestep)
        self.joints = map_joints(self.model, robot.joint_names, torque=True)
        self.finger_joints = map_joints(self.model, robot.finger_joint_names, torque=False)
        self.objects = tuple(scene.objects)
        self._objects: dict[str | None, NamedObject] = {
            name: NamedObject(self.model, self.data, name, robot) for name in self.objects
        }
        if len(self.objects) == 1:
            self._objects[None] = self._objects[self.objects[0]]
        self.recorder: StepRecorder | None = None
        self.observer: Callable[[World], None] | None = None
        self._divergence = DivergenceWatch(self.data)
        self._brakes = JointBrakes(self.data, self.joints.qvel, robot)
        self._cache_views()
        self.reset()

    def _cache_views(self) -> None:
        """Keep views: a lookup in MjData costs as much as reading three numbers."""
        data = self.data
        self._table = self.model.body("table").id
        self._arm_bodies = bodies_below(self.model, self.robot.joint_names)
        self._qpos = data.qpos
        self._qvel = data.qvel
        self._ctrl = data.ctrl
        self._force = data.actuator_force
        self._fingers = np.zeros(2)
        self._grip = np.zeros(2)
        self._halve_places = bound(halves, self._qpos, self.finger_joints.qpos, 0.5, self._fingers)
        self._halve_forces = bound(halves, self._force, self.finger_joints.ctrl, -0.5, self._grip)
        # One index array for the first finger of both hands, one for the second. Contiguous:
        # strided ones are slow.
        first, second = self.finger_joints.ctrl.reshape(2, 2).T
        self._first_fingers = np.ascontiguousarray(first)
        self._second_fingers = np.ascontiguousarray(second)

    # Measurements ------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.data.time

    stamp_s = time

    @property
    def q(self) -> Array:
        """See `Plant`."""
        return self._qpos[self.joints.qpos]

    @property
    def v(self) -> Array:
        """See `Plant`."""
        return self._qvel[self.joints.qvel]

    @property
    def tau(self) -> Array:
        """Motor torques (n,) [Nm] of the last step."""
        return self._force[self.joints.ctrl]

    @property
    def fingers(self) -> Array:
        """See `Plant`."""
        self._halve_places()
        return self._fingers.copy()

    @property
    def gaps_m(self) -> tuple[float, float]:
        """Distance between each hand's fingers [m]."""
        self._halve_places()
        left, right = self._fingers.tolist()
        return 2.0 * left, 2.0 * right

    @property
    def grip(self) -> Array:
        """Closing force (2,) [N] of the last step."""
        self._halve_forces()
        return self._grip.copy()

    @property
    def gripper(self) -> Array:
        """Openings (2,), 0 closed to 1 open."""
        return self.fingers / self.robot.hand.travel_m

    # Truth -------------------------------------------------------------------------------------

    def truth(self, name: str | None = None) -> NamedObject:
        """Return an object's true state.

        Raises:
            UsageError: The object is unknown or ambiguous.
        """
        named_object = self._objects.get(name)
        if named_object is not None:
            return named_object
        if name is not None:
            raise unknown_name("object", name, self.objects)
        raise UsageError(
            f"the scene holds {len(self.objects)} objects ({', '.join(self.objects)}); name one",
        )

    def object_pose(self, name: str | None = None) -> Array:
        """Return an object's true pose (4, 4)."""
        return self.truth(name).pose()

    def contact_pairs(self) -> list[tuple[str, str, float]]:
        """Return (body, body, distance [m]) of each contact."""

        def body_name(geom: int) -> str:
            return self.model.body(int(self.model.geom_bodyid[geom])).name

        contacts = self.data.contact[: self.data.ncon]
        return [(body_name(c.geom1), body_name(c.geom2), float(c.dist)) for c in contacts]

    def touches(self, geom: str) -> bool:
        """Return whether a geom has contacts."""
        geoms = self.data.contact.geom[: self.data.ncon]
        return bool((geoms == self.model.geom(geom).id).any())

    def on_table(self, name: str | None = None) -> bool:
        """Return whether an object touches the table."""
        geoms = self.data.contact.geom[: self.data.ncon]
        body = self.truth(name).body
        return touching(geoms, self.model.geom_bodyid, self._table, body)

    def at_an_arm(self, name: str | None = None) -> bool:
        """Return whether an object touches any part of an arm."""
        geoms = self.data.contact.geom[: self.data.ncon]
        body = self.truth(name).body
        return touching_any(geoms, self.model.geom_bodyid, self._arm_bodies, body)

    # Changes -----------------------------------------------------------------------------------

    def mark_goal(self, x_m: float, y_m: float, yaw_rad: float) -> None:
        """Move the goal's mark, if the scene has no others; it has no contacts."""
        if self.scene.marks:
            return
        mark = self.model.geom(GOAL_MARK)
        mark.pos[:2] = (x_m, y_m)
        mark.quat[:] = (np.cos(yaw_rad / 2.0), 0.0, 0.0, np.sin(yaw_rad / 2.0))
        self.model.geom_sameframe[mark.id] = 0  # otherwise MuJoCo does not read the quaternion

    def reset(
        self,
        q: Array | None = None,
        *,
        poses: Mapping[str, ObjectPose] | None = None,
    ) -> None:
        """Put the arms at q (n,) (default: home), hands open, objects at `poses` (default: start).

        Raises:
            UsageError: Invalid q or unknown object.
        """
        q = self.robot.home if q is None else np.asarray(q, dtype=float)
        self._check_posture(q)
        q = clipped(q, self.robot)
        new_poses = {self.truth(name): pose for name, pose in (poses or {}).items()}
        self.brake(())
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self.joints.qpos] = q
        self.data.qpos[self.finger_joints.qpos] = self.robot.hand.travel_m
        self.data.ctrl[self.finger_joints.ctrl] = self.robot.hand.travel_m
        for named_object, pose in new_poses.items():
            named_object.put(pose)
        mujoco.mj_forward(self.model, self.data)

    def _check_posture(self, q: Array) -> None:
        """Raise UsageError unless q (n,) is inside the joint limits; NaN is not."""
        robot = self.robot
        if q.shape != (robot.dof,):
            raise UsageError(f"q has shape {q.shape}; it must be ({robot.dof},)")
        outside = outside_limits(q, robot)
        if outside.any():
            i = int(np.argmax(outside))
            value = joint_text(q[i])
            lower = joint_text(robot.q_lower[i])
            upper = joint_text(robot.q_upper[i])
            raise UsageError(f"{robot.joint_names[i]} = {value} rad; {lower} <= value <= {upper}")

    def command(self, tau: Array, fingers: Array) -> None:
        """See `Plant`; torques are clipped at the motor limits."""
        if self._brakes.engaged:
            tau = self._brakes.applied(tau)
        self._ctrl[self.joints.ctrl] = tau
        self._ctrl[self._first_fingers] = fingers
        self._ctrl[self._second_fingers] = fingers

    def brake(self, arms: tuple[int, ...]) -> None:
        """See `Plant`."""
        self._brakes.engage(arms)

    def step(self) -> None:
        """Advance by `dt`.

        Raises:
            SimulationDivergedError: MuJoCo reset the state or zeroed commands.
        """
        before_s = self.data.time
        if self.recorder is not None:
            self.recorder.before_step()
        mujoco.mj_step(self.model, self.data)
        not_finite = self._divergence.kinds()
        if not_finite:
            raise self._diverged(before_s, not_finite)
        if self.observer is not None:
            self.observer(self)

    def _diverged(self, before_s: float, kinds: Sequence[str]) -> SimulationDivergedError:
        """Return the error of a step that began at `before_s`, and write the last second."""
        message = f"the simulation diverged at t = {before_s:.3f} s ({', '.join(kinds)} not finite)"
        remedy = "check the commanded torques, the inertias and the time step"
        if self.recorder is not None:
            dump = self.recorder.dump("diverged", message)
            if dump is not None:
                remedy += f"; minidual replay {dump} says what came first"
        return SimulationDivergedError(message, remedy=remedy)
