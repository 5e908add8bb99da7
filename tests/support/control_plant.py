"""A quick plant for tests of the control stack: the arms alone, by Pinocchio's forward dynamics, no contacts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from minidual.config.scene import SceneConfig
from minidual.control.impedance import HeldObject, ObjectState
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Array, inverse, pose
from tests.support.panda import HOME, JOINT_DAMPING


class ArmsPlant:
    """Fourteen joints at 1 kHz, semi-implicit Euler; keeps every torque it was given."""

    def __init__(self, scene: SceneConfig) -> None:
        self.scene = scene
        self.robot = DUAL_PANDA
        self.dt = 1e-3
        self.health = ""
        self.age_s = 0.0
        """How old the measurements claim to be."""
        self.grip_max_n = 70.0
        self.fingers = np.full(2, DUAL_PANDA.hand.travel_m)
        self.grip = np.zeros(2)
        self.tau = np.zeros(14)
        self._kinematics = Kinematics()
        self.torques: list[Array] = []
        self.commands = 0
        self.reset()

    def reset(self, q: Array | None = None) -> None:
        self.q = np.array(HOME if q is None else q, dtype=float)
        self.v = np.zeros(14)
        self.steps = 0
        self.brake(())
        self.torques.clear()

    @property
    def time(self) -> float:
        return self.steps * self.dt

    @property
    def stamp_s(self) -> float:
        return self.time - self.age_s

    def command(self, tau: Array, fingers: Array) -> None:
        self.fingers = fingers.copy()
        self.tau = np.array(tau, dtype=float)
        self.torques.append(self.tau)

    def brake(self, arms: tuple[int, ...]) -> None:
        self.braked = np.repeat([arm in arms for arm in (0, 1)], 7)

    def step(self) -> None:
        model = self._kinematics.model
        data = self._kinematics.data
        tau = self.tau - JOINT_DAMPING * self.v
        if self.braked.any():
            gravity = pin.computeGeneralizedGravity(model, data, self.q)
            tau = np.where(self.braked, gravity - 50.0 * self.v, tau)
        a = pin.aba(model, data, self.q, self.v, tau)
        self.v = self.v + self.dt * np.array(a)
        self.q = self.q + self.dt * self.v
        self.steps += 1


class TrueObject:
    """Reads the only object of a simulated world as an ideal sensor would."""

    grip_limit_n = float("inf")

    def __init__(self, world: World) -> None:
        self._world = world

    def read(self) -> tuple[ObjectState, float]:
        world = self._world
        return ObjectState(
            world.object_pose(),
            world.truth().twist(),
        ), world.truth().internal_force()


class HandsObject:
    """An object that is wherever the hands are: level between them, weightless."""

    def __init__(self, plant: ArmsPlant) -> None:
        self._plant = plant
        self._kinematics = Kinematics()

    grip_limit_n = float("inf")

    def pose(self) -> Array:
        left, right = self._kinematics.tcp_poses(self._plant.q)
        return pose(np.eye(3), 0.5 * (left[:3, 3] + right[:3, 3]))

    def read(self) -> tuple[ObjectState, float]:
        J = self._kinematics.tcp_jacobians(self._plant.q)
        twist = 0.5 * (J[0] + J[1]) @ self._plant.v
        return ObjectState(self.pose(), np.r_[twist[:3], np.zeros(3)]), 0.0

    def held(self) -> HeldObject:
        T = self.pose()
        grasps: Any = tuple(inverse(T) @ hand for hand in self._kinematics.tcp_poses(self._plant.q))
        return HeldObject(0.2, np.diag([1e-3, 1e-4, 1e-3]), grasps, np.array([0.0, 1.0, 0.0]))
