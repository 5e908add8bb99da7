"""The two situations in which controllers are timed: arms swinging free, and both hands holding the rod.

Physics costs several times more where fingers press on a rod than in free air, so a controller's share looks larger
free than held. Both are measured; the held one is what a carry spends its time in.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from minidual.config.scene import SceneConfig
from minidual.control.gripper import Grippers
from minidual.control.loop import JOINT_PINCH_N, JointLoop
from minidual.control.object_impedance import HeldObject, ImpedanceGains, ObjectImpedance, ObjectState
from minidual.control.object_path import ObjectPath, Waypoint
from minidual.errors import MinidualError
from minidual.evaluation.joint_tracking import sine_reference
from minidual.robot.constants import Array
from minidual.robot.kinematics import Kinematics
from minidual.robot.poses import inverse, pose
from minidual.sim.world import World
from minidual.tasks.reach import approach_postures
from minidual.tasks.rod_carry import level_part

_REST = np.zeros(6)
OPEN, CLOSED = np.ones(2), np.zeros(2)
_CLOSE_STEPS = 900
_LIFT_S, _LIFT_M = 0.6, 0.1
_SWAY_M, _SWAY_HZ = 0.01, 0.5


class GraspFailedError(MinidualError):
    """The scene could not be set up: the hands do not hold the rod."""


@dataclass
class BenchScene:
    """A world in the situation, and what controllers need to go on from there.

    Attributes:
        world: The plant.
        kinematics: Workspace.
        gripper: Opening command (2,) that keeps the situation.
        law: Object impedance, engaged.
        rest: Pose (4, 4) of the object about which it sways.
        virtual: No hand holds the rod: the object is imagined midway between the hands.
    """

    world: World
    kinematics: Kinematics
    gripper: Array
    law: ObjectImpedance
    rest: Array
    virtual: bool

    def __post_init__(self) -> None:
        self._q_rest = self.world.q

    def joint_samples(self) -> Iterator[tuple[Array, Array, Array]]:
        """Yield (q, v, a), each (14,), at 1 kHz for ever: a swing of all joints, small where the rod is held."""
        amplitude = 0.1 if self.virtual else 0.0
        swing = [sine_reference(0.1, 0.5, k * self.world.dt) for k in range(round(2.0 / self.world.dt))]
        while True:
            for q, v, a in swing:
                yield (q, v, a) if amplitude else (self._q_rest, 0.0 * v, 0.0 * a)

    def object_samples(self) -> Iterator[ObjectState]:
        """Yield what the object should do at 1 kHz for ever: a slow sway to both sides."""
        w = 2.0 * np.pi * _SWAY_HZ
        t = 0.0
        while True:
            T, twist, acceleration = self.rest.copy(), np.zeros(6), np.zeros(6)
            T[0, 3] += _SWAY_M * (1.0 - np.cos(w * t))
            twist[0] = _SWAY_M * w * np.sin(w * t)
            acceleration[0] = _SWAY_M * w**2 * np.cos(w * t)
            yield ObjectState(T, twist, acceleration)
            t += self.world.dt

    def measured(self) -> ObjectState:
        """Return the object as the controller senses it."""
        T, twist = self.world.T_world_rod, self.world.rod_twist
        return ObjectState(self.rest, _REST, _REST) if self.virtual else ObjectState(T, twist, _REST)


def free_scene(scene: SceneConfig, gains: ImpedanceGains) -> BenchScene:
    """Return arms at home with open hands, nothing touched."""
    world, kinematics = World(scene), Kinematics()
    left, right = kinematics.tcp_poses(world.q)
    rest = pose(np.eye(3), 0.5 * (left[:3, 3] + right[:3, 3]))
    law = ObjectImpedance(kinematics, held_rod(scene, rest, (left, right)), gains)
    law.engage(world.q)
    return BenchScene(world, kinematics, OPEN, law, rest, virtual=True)


def held_scene(scene: SceneConfig, gains: ImpedanceGains) -> BenchScene:
    """Return both hands holding the rod in the air under object impedance.

    Raises:
        GraspFailedError: The rod was not lifted.
    """
    world, kinematics = World(scene), Kinematics()
    _, q_grasp = approach_postures(scene, level_part(world.T_world_rod))
    world.reset(q_grasp)
    loop = JointLoop(world, kinematics)
    for _ in range(_CLOSE_STEPS):
        loop.step(q_grasp, CLOSED)
    T_world_rod = world.T_world_rod
    law = ObjectImpedance(kinematics, held_rod(scene, T_world_rod, kinematics.tcp_poses(world.q)), gains)
    law.engage(world.q)
    x, y, z = T_world_rod[:3, 3]
    level = level_part(T_world_rod)
    yaw = float(np.arctan2(level[1, 0], level[0, 0]))
    path = ObjectPath(Waypoint((x, y, z), yaw, 0.0), [Waypoint((x, y, z + _LIFT_M), yaw, _LIFT_S)])
    T_level_rod = inverse(level) @ T_world_rod
    grippers = Grippers(scene, world.dt, pinch_force_n=JOINT_PINCH_N)
    grippers.close()
    for k in range(round((_LIFT_S + 0.3) / world.dt)):
        state = path.at(k * world.dt)
        desired = ObjectState(state.T_world_object @ T_level_rod, state.twist, state.acceleration)
        tau = law.torque(
            world.q, world.v, ObjectState(world.T_world_rod, world.rod_twist), desired,
            internal_force_n=min(1.0, k * world.dt / 0.1) * gains.internal_force_n,
            measured_internal_force_n=world.internal_force(),
        )  # fmt: skip
        world.command(tau, grippers.step(CLOSED))
        world.step()
    lifted = float(world.T_world_rod[2, 3] - z)
    if not lifted > 0.9 * _LIFT_M:
        raise GraspFailedError(
            f"the rod rose {lifted:.3f} m of {_LIFT_M} m",
            remedy="see `minidual carry`: pinch, friction and squeeze decide whether the hands hold it",
        )
    return BenchScene(world, kinematics, CLOSED, law, desired.T_world_object, virtual=False)


def held_rod(scene: SceneConfig, T_world_rod: Array, tcps: tuple[Array, Array]) -> HeldObject:
    """Return the rod as the law must know it, in the hands at the poses `tcps`."""
    rod = scene.rod
    across = rod.mass_kg * (3 * rod.radius_m**2 + rod.length_m**2) / 12.0
    along = 0.5 * rod.mass_kg * rod.radius_m**2
    to_rod = inverse(T_world_rod)
    return HeldObject(
        rod.mass_kg, np.diag([across, along, across]), (to_rod @ tcps[0], to_rod @ tcps[1]),
        np.array([0.0, 1.0, 0.0]),
    )  # fmt: skip
