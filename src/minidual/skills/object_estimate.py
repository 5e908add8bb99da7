"""Estimates of an object's pose from delayed, noisy samples and the joint encoders.

At rest it is the mean of all samples. When held, its pose X in a frame H of the hands is estimated:
origin midway between the tool centre points, y from right to left, x along the mean finger
direction. Samples z correct X:

    X <- X + g (T_H(t - delay)^-1 z - X),  g = max(1 / n, sample period / memory)
"""

import math
from collections import deque

import numpy as np

from minidual.control.impedance import STILL, ObjectState, towards
from minidual.robot.kinematics import Hands, Kinematics
from minidual.robot.pair import Array, inverse
from minidual.skills.object_kernels import follow


class RestingEstimate:
    """Mean pose of a resting object.

    Attributes:
        innovation: (distance [m], angle [rad]) of the last sample from the previous mean.
    """

    def __init__(self, T_world_object: Array) -> None:
        self.T_world_object = T_world_object.copy()
        self.samples_n = 1
        self.innovation = (0.0, 0.0)

    def add(self, T_world_object: Array, least_gain: float = 0.0) -> None:
        """Add a sample (4, 4) to the mean, which a least gain makes forget."""
        self.samples_n += 1
        gain = max(1.0 / self.samples_n, least_gain)
        self.T_world_object, self.innovation = towards(self.T_world_object, T_world_object, gain)


_ODD_M = 0.03
_ODD_RAD = 0.2
"""A single frame that is off by more is dropped: one marker was taken for another."""


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
        self,
        kinematics: Kinematics,
        q: Array,
        T_world_object: Array,
        *,
        delay_ticks: int,
        least_gain: float,
    ) -> None:
        self._hands = Hands(kinematics)
        self._least_gain = least_gain
        self._samples_n = 5
        self._history: deque[Array] = deque(maxlen=delay_ticks + 1)
        self.innovation = (0.0, 0.0)
        self._odd = False
        self.spread_m = 0.0
        self.moved_m = 0.0
        self._T_hands_object = np.eye(4)
        T_world_hands = self._follow(q, np.zeros_like(q))[0]
        self._T_hands_object = inverse(T_world_hands) @ T_world_object
        self._sampled_m = T_world_hands[:3, 3]
        self.state = ObjectState(T_world_object)

    def update(
        self,
        q: Array,
        v: Array,
        sample: Array | None = None,
        age_ticks: int = 0,
    ) -> ObjectState:
        """Return the object's state at joints q, v (n,).

        Samples (4, 4) older than `delay_ticks` are ignored, and a single one that is far off.
        """
        T_world_hands, T, twist = self._follow(q, v)
        self._history.append(T_world_hands)
        if sample is not None and age_ticks < len(self._history):
            self._samples_n += 1
            gain = max(1.0 / self._samples_n, self._least_gain)
            T_then = self._history[-1 - age_ticks]
            way_m = T_then[:3, 3] - self._sampled_m
            self._sampled_m = T_then[:3, 3]
            self.moved_m = math.sqrt(way_m @ way_m)
            moved, self.innovation = towards(self._T_hands_object, inverse(T_then) @ sample, gain)
            was_odd = self._odd
            distance_m, angle_rad = self.innovation
            self._odd = distance_m > _ODD_M or angle_rad > _ODD_RAD
            if was_odd or not self._odd:
                self._T_hands_object = moved
            _, T, twist = self._follow(q, v)
        # ObjectState(...) takes three times as long.
        self.state = tuple.__new__(ObjectState, (T, twist, STILL))
        return self.state

    def _follow(self, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return T_world_hands (4, 4), the object's pose (4, 4) and twist (6,); set `spread_m`."""
        hands = self._hands
        hands.update(q)
        T_hands = np.empty((4, 4))
        T = np.empty((4, 4))
        twist = np.empty(6)
        self.spread_m = follow(hands.views, v, self._T_hands_object, T_hands, T, twist)
        return T_hands, T, twist
