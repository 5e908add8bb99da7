"""Joint control: smooth references, computed torque, and a loop of both.

Targets arriving at 50 to 100 Hz become references at 1 kHz:

    a = clip(2 w (v_want(e) - v_ref), +-a_max),  e = target - q_ref
    v_want(e) = w e / 2                         for |e| <= d = 4 b / w^2
                sign(e) sqrt(2 b (|e| - d / 2)) beyond, braking with b < a_max

w is the bandwidth. A changed target is approached evenly over 20 ms, one period of 50 Hz. Recording and deployment must
use the same numbers. Motor torques: docs/force-control.md.
"""

import numpy as np

from minidual.control.gripper import Grippers
from minidual.control.kernels import add_loads, follow_target, servo
from minidual.plant.protocol import Plant
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot

_BRAKE_SHARE = 0.9  # b / a_max; the rest serves to track the curve
RAMP_S = 0.02
"""A changed target is approached evenly over this time."""
REFERENCE_RAD_S = 30.0
"""Bandwidth of the reference filter."""
SERVO_RAD_S = 20.0
"""Natural frequency of the tracking."""


def reference_bounds(robot: Robot, bandwidth_rad_s: float = REFERENCE_RAD_S) -> Array:
    """Return the bounds (5, n) of `kernels.follow_target`."""
    a_max = 0.8 * robot.a_max
    near = 4.0 * _BRAKE_SHARE * a_max / bandwidth_rad_s**2
    return np.array([a_max, 0.95 * robot.v_max, near, robot.q_lower, robot.q_upper])


class ReferenceFilter:
    """Second-order tracking of joint targets, with lag 2 / w after the ramp."""

    def __init__(
        self,
        dt_s: float,
        robot: Robot,
        *,
        bandwidth_rad_s: float = REFERENCE_RAD_S,
    ) -> None:
        self._w = bandwidth_rad_s
        self._dt = dt_s
        self._bounds = reference_bounds(robot, bandwidth_rad_s)
        self._v_max = self._v_allowed = self._bounds[1].copy()
        self._state = np.zeros((6, robot.dof))
        self._slewing = False
        self._fresh = True

    def limit_speed(self, share: float) -> None:
        """Follow targets at most at this share of full speed."""
        self._v_allowed = share * self._v_max
        self._slewing = True
        if self._fresh:  # as after a reset: nothing moved faster
            self._bounds[1] = np.maximum(self._v_allowed, np.abs(self._state[1]))
            self._fresh = False

    def reset(self, q: Array, v: Array | None = None, joints: slice = slice(None)) -> None:
        """Start some joints from posture q (n,) [rad], by default all, at rest."""
        still = np.zeros_like(q)
        self._state[:, joints] = np.array([q, still if v is None else v, still, q, q, still])[
            :,
            joints,
        ]
        self._bounds[1] = np.maximum(self._bounds[1], np.abs(self._state[1]))
        self._slewing = True
        self._fresh = True

    def step(self, target: Array) -> tuple[Array, Array, Array]:
        """Advance towards target (n,); return new (q_ref, v_ref, a_ref).

        With s = min(1, d/|e|), a = w^2 e sqrt(s (2 - s)) - 2 w v.
        """
        if self._slewing:  # no faster than the joints can brake
            v_max = self._bounds[1]
            brake = _BRAKE_SHARE * self._bounds[0] * self._dt
            v_max += np.clip(self._v_allowed - v_max, -brake, brake)
            self._slewing = bool((v_max != self._v_allowed).any())
        follow_target(target, self._state, self._bounds, self._w, self._dt, RAMP_S)
        q, v, self.a = self._state[:3].copy()
        return q, v, self.a


def towards_torque(tau: Array, goal: Array, step: float) -> Array:
    """Return the torques (n,) [Nm] nearest to `goal` that differ from tau by at most `step`."""
    return tau + np.clip(goal - tau, -step, step)


def motor_torque(
    kinematics: Kinematics,
    q: Array,
    v: Array,
    a: Array,
    load: Array | None = None,
) -> Array:
    """Return torques (n,) [Nm] for accelerations a (n,) and load (n,), clipped to the limits; NaN stays NaN."""
    # rnea(q, v, a) = M a + h in O(n), with rotor inertia from model.armature.
    tau = kinematics.rnea(q, v, a)
    robot = kinematics.robot
    load = np.zeros(robot.dof) if load is None else load
    add_loads(tau, load, v, robot.arm.damping, robot.arm.friction, robot.tau_max)
    return tau


class ComputedTorque:
    """Tracks joint references, critically damped."""

    def __init__(
        self, kinematics: Kinematics, *, natural_frequency_rad_s: float = SERVO_RAD_S
    ) -> None:
        self._kinematics = kinematics
        self._w = natural_frequency_rad_s
        self._a = np.zeros(kinematics.robot.dof)

    def torque(
        self,
        q: Array,
        v: Array,
        q_ref: Array,
        v_ref: Array,
        a_ref: Array,
        load: Array | None = None,
    ) -> Array:
        """Return motor torques (n,) [Nm], clipped to the limits; load (n,) as in `motor_torque`."""
        servo(q, v, q_ref, v_ref, a_ref, self._w, self._a)
        return motor_torque(self._kinematics, q, v, self._a, load)


class JointLoop[P: Plant]:
    """Drives a world from joint and gripper targets."""

    def __init__(self, world: P, kinematics: Kinematics) -> None:
        self.world = world
        self.controller = ComputedTorque(kinematics)
        self.reference = ReferenceFilter(world.dt, kinematics.robot)
        self.grippers = Grippers(world)
        self.reset()

    def reset(self) -> None:
        """Start at the measured posture, hands open."""
        self.reference.reset(self.world.q)
        self.grippers.reset(self.world.fingers, self.world.grip)

    def step(self, q_target: Array, gripper: Array) -> None:
        """Run one control and physics step."""
        self.follow(*self.reference.step(q_target), gripper)

    def follow(self, q_ref: Array, v_ref: Array, a_ref: Array, gripper: Array) -> None:
        """Run one step on a smooth reference."""
        world = self.world
        world.command(
            self.controller.torque(world.q, world.v, q_ref, v_ref, a_ref),
            self.grippers.step(gripper, world.fingers, world.grip),
        )
        world.step()
