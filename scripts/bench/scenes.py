"""The two situations in which controllers are timed: arms swing free, and both hands hold the rod.

Physics costs more where fingers press on a rod than in free air, so a controller's share looks larger
free than held. Both are measured; the held one is what a carry spends its time in.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field

import mujoco
import numpy as np

from minidual.config.control import ImpedanceConfig
from minidual.config.scene import SceneConfig
from minidual.control.gripper import Grippers
from minidual.control.impedance import ObjectImpedance, ObjectState
from minidual.control.joint_control import JointLoop
from minidual.errors import MinidualError
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, inverse, pose
from minidual.skills.carry_motions import grasp_posture, held_object
from minidual.skills.object_path import ObjectPath, Waypoint
from minidual.stages.env_check.tracking import sine_reference
from minidual.tasks.task import level_part

_OPEN = np.ones(2)
_CLOSED = np.zeros(2)
_AT_REST = np.zeros(6)
_CLOSE_STEPS = 900
_LIFT_S = 0.6
_LIFT_M = 0.1
_STILL_S = 0.3
_SQUEEZE_RAMP_S = 0.1
_SWING_RAD = 0.1
_SWING_HZ = 0.5
_SWAY_RAD = 0.001
"""Swing of the joints while the rod is held: any more and the arms, a closed chain, would fight."""
_SWAY_M = 0.01
_SWAY_HZ = 0.5
_PERIOD_S = 2.0
TARGET_STEPS = 20
"""Steps for which a joint target of teleoperation or the policy stands: 50 Hz."""

JointSample = tuple[Array, Array, Array]
"""Position, velocity and acceleration."""


class GraspFailedError(MinidualError):
    """The scene could not be set up: the hands do not hold the rod."""


@dataclass
class BenchScene:
    """A world in the situation, and what controllers need to go on from there.

    Attributes:
        name: `free` or `held`.
        world: The plant.
        kinematics: Workspace.
        gripper: Opening command (2,) that keeps the situation.
        law: Object impedance, engaged.
        rest: Pose (4, 4) of the object about which it sways.
        virtual: No hand holds the rod: the object is imagined midway between the hands, at rest.
    """

    name: str
    world: World
    kinematics: Kinematics
    gripper: Array
    law: ObjectImpedance
    rest: Array
    virtual: bool
    q_rest: Array = field(init=False)

    def __post_init__(self) -> None:
        self.q_rest = self.world.q
        self._start = mujoco.MjData(self.world.model)
        mujoco.mj_copyData(self._start, self.world.model, self.world.data)

    def restore(self) -> None:
        """Put the world back to where the situation began."""
        mujoco.mj_copyData(self.world.data, self.world.model, self._start)

    def grippers(self) -> Grippers:
        """Return grippers that keep the situation."""
        grippers = Grippers(self.world)
        if not self.virtual:
            grippers.close(self.world.data.ctrl[self.world.finger_joints.ctrl[::2]])
        return grippers

    def joint_samples(self, joints: slice = slice(None)) -> Iterator[JointSample]:
        """Yield (q, v, a) of `joints` at 1 kHz for ever: a swing, tiny where the rod is held."""
        robot = self.world.robot
        amplitude_rad = _SWING_RAD if self.virtual else _SWAY_RAD
        shift = self.q_rest - sine_reference(robot, amplitude_rad, _SWING_HZ, 0.0)[0]
        swing = [
            sine_reference(robot, amplitude_rad, _SWING_HZ, k * self.world.dt)
            for k in range(round(_PERIOD_S / self.world.dt))
        ]
        while True:
            for q, v, a in swing:
                yield (q + shift)[joints], v[joints], a[joints]

    def joint_targets(self) -> Iterator[Array]:
        """Yield targets (14,) for every step, new at 50 Hz."""
        target = self.q_rest
        for k, (q, _, _) in enumerate(self.joint_samples()):
            if k % TARGET_STEPS == 0:
                target = q
            yield target

    def object_samples(self) -> Iterator[ObjectState]:
        """Yield what the object should do at 1 kHz for ever: a slow sway to one side and back."""
        w = 2.0 * np.pi * _SWAY_HZ
        for k in itertools.count():
            t = k * self.world.dt
            T_world_object = self.rest.copy()
            T_world_object[0, 3] += _SWAY_M * (1.0 - np.cos(w * t))
            twist = np.zeros(6)
            twist[0] = _SWAY_M * w * np.sin(w * t)
            acceleration = np.zeros(6)
            acceleration[0] = _SWAY_M * w**2 * np.cos(w * t)
            yield ObjectState(T_world_object, twist, acceleration)

    def sense(self) -> tuple[ObjectState, float]:
        """Return object and squeeze [N] as the controller senses them.

        Both are read even if the object is imagined: reading is part of a step's cost.
        """
        T_world_object = self.world.object_pose()
        twist = self.world.truth().twist()
        squeeze_n = self.world.truth().internal_force()
        if self.virtual:
            return ObjectState(self.rest, _AT_REST, _AT_REST), squeeze_n
        return ObjectState(T_world_object, twist, _AT_REST), squeeze_n

    @property
    def squeeze_n(self) -> float:
        """Squeeze to ask for [N]."""
        return 0.0 if self.virtual else self.law.gains.internal_force_n


def free_scene(scene: SceneConfig, gains: ImpedanceConfig) -> BenchScene:
    """Return arms near home with open hands, nothing touched."""
    world = World(scene)
    kinematics = Kinematics()
    world.reset(sine_reference(world.robot, _SWING_RAD, _SWING_HZ, 0.0)[0])
    left, right = kinematics.tcp_poses(world.q)
    rest = pose(np.eye(3), 0.5 * (left[:3, 3] + right[:3, 3]))
    law = ObjectImpedance(kinematics, held_object(scene, rest, (left, right)), gains)
    law.engage(world.q)
    return BenchScene("free", world, kinematics, _OPEN, law, rest, virtual=True)


def held_scene(scene: SceneConfig, gains: ImpedanceConfig) -> BenchScene:
    """Return both hands holding the rod in the air under object impedance.

    Raises:
        GraspFailedError: The rod was not lifted.
    """
    world = World(scene)
    kinematics = Kinematics()
    _grasp(world, kinematics)
    T_world_rod = world.object_pose()
    T_world_level = level_part(T_world_rod)
    T_level_rod = inverse(T_world_level) @ T_world_rod
    rod = held_object(scene, T_world_rod, kinematics.tcp_poses(world.q))
    law = ObjectImpedance(kinematics, rod, gains)
    law.engage(world.q)
    path = _lift_path(T_world_level, T_world_rod[:3, 3])
    rest = path.at(_LIFT_S).T_world_object @ T_level_rod
    held = BenchScene("held", world, kinematics, _CLOSED, law, rest, virtual=False)
    _lift(held, path, T_level_rod)
    risen_m = float(world.object_pose()[2, 3] - T_world_rod[2, 3])
    if not risen_m > 0.9 * _LIFT_M:
        raise GraspFailedError(
            f"the rod rose {risen_m:.3f} m of {_LIFT_M} m",
            remedy="see `minidual carry`: pinch, friction and squeeze decide whether the hands "
            "hold it",
        )
    return BenchScene("held", world, kinematics, _CLOSED, law, rest, virtual=False)


def _grasp(world: World, kinematics: Kinematics) -> None:
    """Close both hands on the rod that lies on the table."""
    T_world_level = level_part(world.object_pose())
    q_grasp = grasp_posture(world.scene, world.robot, T_world_level, world.robot.home)
    world.reset(q_grasp)
    loop = JointLoop(world, kinematics)
    for _ in range(_CLOSE_STEPS):
        loop.step(q_grasp, _CLOSED)


def _lift_path(T_world_level: Array, position: Array) -> ObjectPath:
    """Return the path of a rod at `position` (3,) straight up."""
    x, y, z = position
    yaw = float(np.arctan2(T_world_level[1, 0], T_world_level[0, 0]))
    return ObjectPath(Waypoint((x, y, z), yaw, 0.0), [Waypoint((x, y, z + _LIFT_M), yaw, _LIFT_S)])


def _lift(held: BenchScene, path: ObjectPath, T_level_rod: Array) -> None:
    """Follow the path under object impedance, then stand still."""
    world = held.world
    law = held.law
    grippers = held.grippers()
    for k in range(round((_LIFT_S + _STILL_S) / world.dt)):
        t = k * world.dt
        level = path.at(t)
        desired = ObjectState(level.T_world_object @ T_level_rod, level.twist, level.acceleration)
        measured, felt_n = held.sense()
        tau = law.torque(
            world.q,
            world.v,
            measured,
            desired,
            wanted_n=min(1.0, t / _SQUEEZE_RAMP_S) * law.gains.internal_force_n,
            felt_n=felt_n,
        )
        world.command(tau, grippers.step(_CLOSED, world.fingers, world.grip))
        world.step()
