"""Estimate the object's pose from delayed, noisy samples and the joint encoders.

At rest it is the mean of all samples. When held, its pose X in a frame H of the hands is estimated: origin midway
between the tool centre points, y from right to left, x along the mean finger direction. Samples z correct X:

    X <- X + g (T_H(t - delay)^-1 z - X),  g = max(1 / n, sample period / memory)

y comes from positions because an object can pivot between two pads.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
import pinocchio as pin

from minidual.control.object_impedance import ObjectState
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.robot.poses import inverse, pose, rotation_log
from minidual.robot.vectors import Vector, cross, inner, minus, plus, times

_WORLD_ALIGNED = pin.LOCAL_WORLD_ALIGNED


class RestingEstimate:
    """Mean pose of a resting object.

    Attributes:
        innovation: (distance [m], angle [rad]) of the last sample from the previous mean.
    """

    def __init__(self, T_world_object: Array) -> None:
        self.T_world_object = T_world_object.copy()
        self.samples_n = 1
        self.innovation = (0.0, 0.0)

    def add(self, T_world_object: Array) -> None:
        """Add a sample (4, 4) to the mean."""
        self.samples_n += 1
        self.T_world_object, self.innovation = _towards(self.T_world_object, T_world_object, 1.0 / self.samples_n)


class HeldEstimate:
    """Pose and twist of an object in both hands.

    Args:
        q: Joints (n,) after closing.
        T_world_object: Pose (4, 4), weighted as five samples.
        delay_ticks: Largest sample age.
        least_gain: Smallest g.

    Attributes:
        innovation: (distance [m], angle [rad]) of the last sample.
        spread_m: Distance between the hands.
        moved_m: Distance that they moved between the last two samples.
    """

    def __init__(
        self, kinematics: Kinematics, q: Array, T_world_object: Array, *, delay_ticks: int, least_gain: float
    ) -> None:
        self._model, self._data = kinematics.model, kinematics.data
        self._left, self._right = kinematics.tcp_ids
        frames = [self._data.oMf[i] for i in kinematics.tcp_ids]
        self._p = [frame.translation for frame in frames]  # views of Pinocchio's memory
        self._fingers = [frame.rotation[:, 1] for frame in frames]
        self._least_gain, self._samples_n = least_gain, 5
        self._history: deque[Array] = deque(maxlen=delay_ticks + 1)
        self.innovation = (0.0, 0.0)
        self.spread_m = self.moved_m = 0.0
        T_world_hands, _, _ = self._hands(q, np.zeros_like(q))
        self._T_hands_object, self._sampled_m = inverse(T_world_hands) @ T_world_object, T_world_hands[:3, 3]
        self.state = ObjectState(T_world_object)

    def update(self, q: Array, v: Array, sample: Array | None, age_ticks: int = 0) -> ObjectState:
        """Return the object's state at joints q, v (n,).

        Samples (4, 4) older than `delay_ticks` are ignored.
        """
        T_world_hands, velocity, omega = self._hands(q, v)
        self._history.append(T_world_hands)
        if sample is not None and age_ticks < len(self._history):
            self._samples_n += 1
            gain = max(1.0 / self._samples_n, self._least_gain)
            T_then = self._history[-1 - age_ticks]
            self.moved_m, self._sampled_m = float(np.linalg.norm(T_then[:3, 3] - self._sampled_m)), T_then[:3, 3]
            seen = inverse(T_then) @ sample
            self._T_hands_object, self.innovation = _towards(self._T_hands_object, seen, gain)
        T = T_world_hands.dot(self._T_hands_object)
        lever = minus(T[:3, 3].tolist(), T_world_hands[:3, 3].tolist())
        self.state = ObjectState(T, np.array([*plus(velocity, cross(omega, lever)), *omega]))
        return self.state

    def _hands(self, q: Array, v: Array) -> tuple[Array, Vector, Vector]:
        """Return T_world_hands (4, 4), velocity, angular velocity; set `spread_m`."""
        model, data = self._model, self._data
        pin.forwardKinematics(model, data, q, v)
        pin.updateFramePlacement(model, data, self._left)
        pin.updateFramePlacement(model, data, self._right)
        left, right = self._p[0].tolist(), self._p[1].tolist()
        apart = minus(left, right)
        distance = math.sqrt(inner(apart, apart))
        self.spread_m = distance
        y = times(1.0 / distance, apart)
        x = plus(self._fingers[0].tolist(), self._fingers[1].tolist())
        x = minus(x, times(inner(x, y), y))
        x = times(1.0 / math.sqrt(inner(x, x)), x)
        z, p = cross(x, y), times(0.5, plus(left, right))
        T = np.array(
            [[x[0], y[0], z[0], p[0]], [x[1], y[1], z[1], p[1]], [x[2], y[2], z[2], p[2]], [0.0, 0.0, 0.0, 1.0]]
        )
        v_left = pin.getFrameVelocity(model, data, self._left, _WORLD_ALIGNED).vector.tolist()
        v_right = pin.getFrameVelocity(model, data, self._right, _WORLD_ALIGNED).vector.tolist()
        # Rotation about x and z follows from the two points, about y only from the hands' angular velocities.
        about_y = 0.5 * inner(plus(v_left[3:], v_right[3:]), y)
        swing = times(1.0 / distance, cross(y, minus(v_left[:3], v_right[:3])))
        return T, times(0.5, plus(v_left[:3], v_right[:3])), plus(swing, times(about_y, y))


def _towards(T: Array, sample: Array, gain: float) -> tuple[Array, tuple[float, float]]:
    """Return T moved towards the sample, and their innovation."""
    offset = sample[:3, 3] - T[:3, 3]
    turn = rotation_log(T[:3, :3].T @ sample[:3, :3])
    moved = pose(T[:3, :3] @ pin.exp3(gain * turn), T[:3, 3] + gain * offset)
    return moved, (math.sqrt(offset @ offset), math.sqrt(turn @ turn))
