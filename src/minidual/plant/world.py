"""The simulated world."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol

import mujoco
import numpy as np

from minidual.config.scene import SceneConfig
from minidual.errors import UsageError, unknown_name
from minidual.plant.bodies import NamedObject, ObjectPose, halves, touching
from minidual.plant.model import GOAL_MARK, build_model, map_joints
from minidual.plant.protocol import PlantEndedError
from minidual.robot.compiled import bound
from minidual.robot.pair import DUAL_PANDA, Array, Robot


class StepRecorder(Protocol):
    """What records a world's steps; see `plant.recorder`."""

    def before_step(self) -> None:
        """Note the state and the commands of the next step."""
        ...

    def dump(self, name: str, reason: str) -> Path | None:
        """Write the last second, if there is a folder; return its file."""
        ...


class SimulationDivergedError(PlantEndedError):
    """A state or command is not finite."""


_BAD = {"QPOS": "positions", "QVEL": "velocities", "QACC": "accelerations", "CTRL": "commands"}
_NOT_FINITE = {
    int(getattr(mujoco.mjtWarning, f"mjWARN_BAD{kind}")): what for kind, what in _BAD.items()
}
"""MuJoCo only counts these and resets the state or zeroes the commands."""


class World:
    """Two arms, a table and named objects; `command`, then `step`.

    Object name None means the only one. Rendering needs `visuals`; `model` reuses one from `build_model`.
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
        self.grip_max_n = scene.physics.finger_force_max_n  # divergence raises in `step`
        self.health = ""
        self.model = build_model(scene, robot, visuals=visuals) if model is None else model
        self.data = mujoco.MjData(self.model)
        self._warnings = self.data.warning.number  # view: counts by kind
        self._no_warnings = bytes(self._warnings.nbytes)
        self._table = self.model.body("table").id
        self.dt = float(self.model.opt.timestep)
        self.joints = map_joints(self.model, robot.joint_names, torque=True)
        self.finger_joints = map_joints(self.model, robot.finger_joint_names, torque=False)
        self.objects = tuple(scene.objects)
        self._objects: dict[str | None, NamedObject] = {
            name: NamedObject(self.model, self.data, name, robot) for name in self.objects
        }
        if len(self.objects) == 1:
            self._objects[None] = self._objects[self.objects[0]]
        data = self.data  # cached views: a lookup in MjData costs as much as reading three numbers
        self._qpos = data.qpos
        self._qvel = data.qvel
        self._ctrl = data.ctrl
        self._force = data.actuator_force
        self._fingers, self._grip = np.zeros((2, 2))
        self._halve_places = bound(halves, self._qpos, self.finger_joints.qpos, 0.5, self._fingers)
        self._halve_forces = bound(halves, self._force, self.finger_joints.ctrl, -0.5, self._grip)
        self._finger_ctrl = tuple(
            np.ascontiguousarray(self.finger_joints.ctrl.reshape(2, 2).T),
        )  # strided is slow
        self.recorder: StepRecorder | None = None
        """For replays."""
        self.observer: Callable[[World], None] | None = None
        """Viewer callback after each step; must only read."""
        self.reset()

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
        """Motor torques (n,) [Nm], last step."""
        return self._force[self.joints.ctrl]

    @property
    def fingers(self) -> Array:
        """See `Plant`."""
        self._halve_places()
        return self._fingers.copy()

    @property
    def gaps_m(self) -> tuple[float, float]:
        """Between each hand's fingers [m]."""
        self._halve_places()
        left, right = self._fingers.tolist()
        return 2.0 * left, 2.0 * right

    @property
    def grip(self) -> Array:
        """Closing force (2,) [N], last step."""
        self._halve_forces()
        return self._grip.copy()

    @property
    def gripper(self) -> Array:
        """Openings (2,), 0..1 open."""
        return self.fingers / self.robot.hand.travel_m

    def truth(self, name: str | None = None) -> NamedObject:
        """Return an object's true state.

        Raises:
            UsageError: The object is unknown or ambiguous.
        """
        if (found := self._objects.get(name)) is None:
            if name is None:
                raise UsageError(
                    f"the scene holds {len(self.objects)} objects ({', '.join(self.objects)}); name one",
                )
            raise unknown_name("object", name, self.objects)
        return found

    def object_pose(self, name: str | None = None) -> Array:
        """Return the true pose (4, 4)."""
        return self.truth(name).pose()

    def mark_goal(self, x_m: float, y_m: float, yaw_rad: float) -> None:
        """Move the goal's mark, if the scene has no others; it touches nothing."""
        if self.scene.marks:
            return
        mark = self.model.geom(GOAL_MARK)
        mark.pos[:2] = x_m, y_m
        mark.quat[:] = np.cos(yaw_rad / 2.0), 0.0, 0.0, np.sin(yaw_rad / 2.0)
        self.model.geom_sameframe[mark.id] = 0  # otherwise its direction is not read

    def contact_pairs(self) -> list[tuple[str, str, float]]:
        """Return (body, body, distance [m]) per contact."""
        body = self.model.geom_bodyid
        return [
            (
                self.model.body(int(body[c.geom1])).name,
                self.model.body(int(body[c.geom2])).name,
                float(c.dist),
            )
            for c in self.data.contact[: self.data.ncon]
        ]

    def touches(self, geom: str) -> bool:
        """Return whether a geom has contacts."""
        return bool((self.data.contact.geom[: self.data.ncon] == self.model.geom(geom).id).any())

    def on_table(self, name: str | None = None) -> bool:
        """Return whether an object touches the table."""
        geoms = self.data.contact.geom[: self.data.ncon]
        body = self.truth(name).body
        return touching(geoms, self.model.geom_bodyid, self._table, body)

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
        robot = self.robot
        q = robot.home if q is None else np.asarray(q, dtype=float)
        if q.shape != (robot.dof,):
            raise UsageError(f"q has shape {q.shape}; it must be ({robot.dof},)")
        bad = ~((q >= robot.q_lower - 1e-9) & (q <= robot.q_upper + 1e-9))
        if bad.any():
            i = int(np.argmax(bad))
            low = robot.q_lower[i]
            high = robot.q_upper[i]
            raise UsageError(
                f"{robot.joint_names[i]} = {q[i]:.4f} rad; {low:.4f} <= value <= {high:.4f}",
            )
        put = {self.truth(name): pose for name, pose in (poses or {}).items()}
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self.joints.qpos] = q
        self.data.qpos[self.finger_joints.qpos] = robot.hand.travel_m
        self.data.ctrl[self.finger_joints.ctrl] = robot.hand.travel_m
        for found, pose in put.items():
            found.put(pose)
        mujoco.mj_forward(self.model, self.data)

    def command(self, tau: Array, fingers: Array) -> None:
        """See `Plant`; torques are clipped at the motor limits."""
        self._ctrl[self.joints.ctrl] = tau
        left, right = self._finger_ctrl
        self._ctrl[left] = self._ctrl[right] = fingers

    def step(self) -> None:
        """Advance by `dt`.

        Raises:
            SimulationDivergedError: MuJoCo reset the state or zeroed commands.
        """
        before = self.data.time
        if self.recorder is not None:
            self.recorder.before_step()
        mujoco.mj_step(self.model, self.data)
        if self._warnings.tobytes() != self._no_warnings:  # 10x faster than `any`
            bad = [what for kind, what in _NOT_FINITE.items() if self._warnings[kind]]
            if bad:
                message = (
                    f"the simulation diverged at t = {before:.3f} s ({', '.join(bad)} not finite)"
                )
                remedy = "check the commanded torques, the inertias and the time step"
                dump = None if self.recorder is None else self.recorder.dump("diverged", message)
                if dump is not None:
                    remedy += f"; minidual replay {dump} says what came first"
                raise SimulationDivergedError(message, remedy=remedy)
        if self.observer is not None:
            self.observer(self)
