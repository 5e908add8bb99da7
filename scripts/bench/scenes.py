"""The two situations in which controllers are timed: arms swinging free, and both hands holding the rod.

Physics costs more where fingers press on a rod than in free air, so a controller's share looks larger free than
held. Both are measured; the held one is what a carry spends its time in.
"""

from __future__ import annotations

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

    def joint_samples(self) -> Iterator[JointSample]:
        """Yield (q, v, a), each (14,), at 1 kHz for ever: a swing of all joints, tiny where the rod is held."""
        amplitude = _SWING_RAD if self.virtual else _SWAY_RAD
        shift = self.q_rest - sine_reference(self.world.robot, amplitude, _SWING_HZ, 0.0)[0]
        swing = [
            sine_reference(self.world.robot, amplitude, _SWING_HZ, k * self.world.dt)
            for k in range(round(_PERIOD_S / self.world.dt))
        ]
        while True:
            for q, v, a in swing:
                yield q + shift, v, a

    def joint_targets(self) -> Iterator[Array]:
        """Yield targets (14,) for every step, new at 50 Hz."""
        for k, (q, _, _) in enumerate(self.joint_samples()):
            if k % TARGET_STEPS == 0:
                target = q
            yield target

    def object_samples(self) -> Iterator[ObjectState]:
        """Yield what the object should do at 1 kHz for ever: a slow sway to one side and back."""
        w = 2.0 * np.pi * _SWAY_HZ
        k = 0
        while True:
            t = k * self.world.dt
            T = self.rest.copy()
            twist = np.zeros(6)
            acceleration = np.zeros(6)
            T[0, 3] += _SWAY_M * (1.0 - np.cos(w * t))
            twist[0] = _SWAY_M * w * np.sin(w * t)
            acceleration[0] = _SWAY_M * w**2 * np.cos(w * t)
            yield ObjectState(T, twist, acceleration)
            k += 1

    def sense(self) -> tuple[ObjectState, float]:
        """Return object and squeeze [N] as the controller senses them: both are read, even if one is imagined."""
        T = self.world.object_pose()
        twist = self.world.truth().twist()
        squeeze = self.world.truth().internal_force()
        if self.virtual:
            T = self.rest
            twist = _AT_REST
        return ObjectState(T, twist, _AT_REST), squeeze

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
    q_grasp = grasp_posture(scene, world.robot, level_part(world.object_pose()), world.robot.home)
    world.reset(q_grasp)
    loop = JointLoop(world, kinematics)
    for _ in range(_CLOSE_STEPS):
        loop.step(q_grasp, _CLOSED)

    T_world_rod = world.object_pose()
    level = level_part(world.object_pose())
    law = ObjectImpedance(
        kinematics,
        held_object(scene, T_world_rod, kinematics.tcp_poses(world.q)),
        gains,
    )
    law.engage(world.q)
    x, y, z = T_world_rod[:3, 3]
    yaw = float(np.arctan2(level[1, 0], level[0, 0]))
    path = ObjectPath(Waypoint((x, y, z), yaw, 0.0), [Waypoint((x, y, z + _LIFT_M), yaw, _LIFT_S)])
    T_level_rod = inverse(level) @ T_world_rod
    rest = path.at(_LIFT_S).T_world_object @ T_level_rod
    held = BenchScene("held", world, kinematics, _CLOSED, law, rest, virtual=False)
    grippers = held.grippers()
    for k in range(round((_LIFT_S + _STILL_S) / world.dt)):
        state = path.at(k * world.dt)
        desired = ObjectState(state.T_world_object @ T_level_rod, state.twist, state.acceleration)
        measured, squeeze = held.sense()
        tau = law.torque(
            world.q,
            world.v,
            measured,
            desired,
            wanted_n=min(1.0, k * world.dt / 0.1) * gains.internal_force_n,
            felt_n=squeeze,
        )
        world.command(tau, grippers.step(_CLOSED))
        world.step()
    lifted = float(world.object_pose()[2, 3] - z)
    if not lifted > 0.9 * _LIFT_M:
        raise GraspFailedError(
            f"the rod rose {lifted:.3f} m of {_LIFT_M} m",
            remedy="see `minidual carry`: pinch, friction and squeeze decide whether the hands hold it",
        )
    return BenchScene("held", world, kinematics, _CLOSED, law, rest, virtual=False)
