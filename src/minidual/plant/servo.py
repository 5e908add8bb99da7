"""Servos inside a plant that takes joint targets and widths: simulated drives, not our controllers."""

import math

import numpy as np

from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot

_STIFFNESS_RAD_S = 60.0
"""Natural frequency of the joints about their targets, critically damped."""
_SERVO_N_PER_M = 5000.0
"""Stiffness of the simulated finger drives."""
FINGER_SPEED_M_PER_S = 0.05
GRIP_N = 40.0


class JointServo:
    """Stiff joints: computed torque about a target, inside the motors' limits.

    Args:
        robot: The arms.
        frequency_rad_s: Natural frequency of each joint about its target.
    """

    def __init__(self, robot: Robot, frequency_rad_s: float = _STIFFNESS_RAD_S) -> None:
        self._kinematics = Kinematics(robot)
        self._robot = robot
        self._w = frequency_rad_s

    def torque(
        self,
        q: Array,
        v: Array,
        q_target: Array,
        v_target: Array,
        a_target: Array | float = 0.0,
    ) -> Array:
        """Return motor torques (n,) [Nm]."""
        a = a_target + self._w**2 * (q_target - q) + 2.0 * self._w * (v_target - v)
        friction = self._robot.arm.damping * v
        tau = self._kinematics.rnea(q, v, a) + friction
        return np.clip(tau, -self._robot.tau_max, self._robot.tau_max)

    def gravity(self, q: Array) -> Array:
        """Return the torques (n,) [Nm] that hold a posture."""
        return np.array(self._kinematics.gravity(q))


class HandServo:
    """Moves the fingers of one hand to a width at a speed, or closes them with a force."""

    def __init__(self, arm: int, world: World) -> None:
        self._arm = arm
        self._world = world
        self._travel_m = world.robot.hand.travel_m
        self.reset()

    def reset(self) -> None:
        """Stay where the fingers are."""
        self._target_m = float(self._world.fingers[self._arm])
        self.goal_m = self._target_m
        self.speed_m_per_s = FINGER_SPEED_M_PER_S
        self.force_n = GRIP_N
        self._opening = math.nan

    def open_to(self, opening: float) -> None:
        """Open (1), close (0) or stay (NaN); the same again changes nothing."""
        if math.isnan(opening) or opening == self._opening:
            return
        self._opening = opening
        self.move(opening * self._travel_m, FINGER_SPEED_M_PER_S, GRIP_N)

    def move(self, goal_m: float, speed_m_per_s: float, force_n: float) -> None:
        """Go to a distance of each finger from the middle, pressing with no more than a force."""
        self.goal_m = min(max(goal_m, 0.0), self._travel_m)
        self.speed_m_per_s = speed_m_per_s
        self.force_n = force_n

    def target(self) -> float:
        """Advance by one step of the world; return the drives' target [m]."""
        step = self.speed_m_per_s * self._world.dt
        change = min(max(self.goal_m - self._target_m, -step), step)
        target = self._target_m + change
        measured = float(self._world.fingers[self._arm])
        pressed_m = self.force_n / _SERVO_N_PER_M
        self._target_m = max(target, measured - pressed_m)
        return self._target_m
