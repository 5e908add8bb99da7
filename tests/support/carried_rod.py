"""A rod that both hands have lifted by object impedance."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from minidual.control.commands import JointCommand, ObjectCommand
from minidual.control.impedance import HeldObject, ObjectState
from minidual.control.reflexes import ReflexError
from minidual.control.stack import OBJECT_CONTROLLERS
from minidual.control.supervisor import Supervisor
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import inverse
from minidual.skills.object_path import ObjectPath, Waypoint
from minidual.tasks.task import level_pose
from tests.support.arm_scripts import grasp_posture
from tests.support.control_plant import TrueObject
from tests.support.stacks import CLOSED, hand_over, stack_on

KINEMATICS = Kinematics()


class Sensor(TrueObject):
    """The object's true state, unless it fails."""

    failing = False
    off_m = (0.0, 0.0, 0.0)
    twist_off = (0.0,) * 6
    felt_off_n = 0.0

    def read(self) -> tuple[ObjectState, float]:
        if self.failing:
            raise OSError("the camera is gone")
        state, felt_n = super().read()
        state.T_world_object[:3, 3] += self.off_m
        return state._replace(twist=state.twist + self.twist_off), felt_n + self.felt_off_n


class Carried:
    """Both hands have lifted the rod by object impedance and hold it."""

    def __init__(self, world: World, mass_kg: float | None = None) -> None:
        self.world = world
        scene = world.scene
        body = world.model.body("rod")
        self.names: list[str] = []
        self.fastest = 0.0
        self.sequence = 0
        if mass_kg is not None:
            world.model.body_inertia[body.id] *= mass_kg / world.model.body_mass[body.id]
            world.model.body_mass[body.id] = mass_kg
            mujoco.mj_setConst(world.model, mujoco.MjData(world.model))
        q = grasp_posture(
            scene,
            KINEMATICS,
            level_pose(*scene.task.start_xy_m, scene.object.radius_m, 0.0),
        )
        world.reset(q)
        self.sensor = Sensor(world)
        stack = self.stack = stack_on(
            world,
            supervisor=Supervisor(dt_s=world.dt),
            sensor=self.sensor,
        )
        hand_over(stack, "moveit")
        self.hold(900)
        lying = world.object_pose()
        tips = KINEMATICS.tcp_poses(world.q)
        axis = lying[:3, :3].T @ (tips[0] - tips[1])[:3, 3]
        grasps = inverse(lying) @ tips[0], inverse(lying) @ tips[1]
        inertia = world.model.body_inertia[body.id]
        mass = float(world.model.body_mass[body.id])
        stack.impedance.configure(
            HeldObject(mass, np.diag(inertia), grasps, axis / np.linalg.norm(axis)),
        )
        stack.switch_controllers(OBJECT_CONTROLLERS)
        self.carry((0.0, 0.0, 0.15), 2.0)
        self.run(2500)
        assert self.names == []
        assert self.height_m > 0.14

    @property
    def height_m(self) -> float:
        return float(self.world.object_pose()[2, 3])

    def carry(self, by_m: tuple[float, float, float], duration_s: float) -> None:
        """Request an object path from where the rod is, with a squeeze of 40 N."""
        T = self.world.object_pose()
        yaw = float(np.arctan2(T[1, 0], T[0, 0]))
        start = Waypoint(tuple(T[:3, 3].tolist()), yaw, 0.0)
        path = ObjectPath(
            start,
            [
                Waypoint(start.xyz_m, yaw, 0.4),
                Waypoint(tuple((T[:3, 3] + by_m).tolist()), yaw, duration_s),
            ],
        )
        self.sequence += 1
        squeeze = lambda t: 40.0 * min(1.0, t / 0.3)  # noqa: E731
        assert (
            self.stack.propose(
                "moveit",
                ObjectCommand(path, squeeze, CLOSED, self.world.time, self.sequence),
            )
            is None
        )

    def run(self, ticks: int, each: Callable[[], None] = lambda: None) -> None:
        """Step, and note reflexes, and the largest speed of a joint."""
        for _ in range(ticks):
            each()
            try:
                self.stack.step()
            except ReflexError as error:
                self.names.append(error.reflex.label)
            self.fastest = max(self.fastest, float(np.abs(self.world.v).max()))

    def hold(self, ticks: int) -> None:
        """Stream the posture of now, hands closed."""
        q = self.world.q
        stack = self.stack

        def stream() -> None:
            if stack.tick_next:
                self.sequence += 1
                stack.propose("moveit", JointCommand(q, CLOSED, self.world.time, self.sequence))

        self.run(ticks, stream)

    def stop(self) -> None:
        """Press the emergency stop, and wait for rest."""
        self.stack.supervisor.estop()
        self.run(1000)
        assert self.names == ["emergency_stop"]

    def lose(self) -> None:
        """Take the rod out of both hands at once."""
        first = self.world.model.jnt_qposadr[self.world.model.body("rod").jntadr[0]]
        self.world.data.qpos[first : first + 3] = 0.5, 0.9, 0.02
