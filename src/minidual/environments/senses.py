"""Readings of N worlds without the truth; the method that runs a policy fills the same rows."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from minidual.config.control import SensingConfig
from minidual.environments.kernels import place_hands
from minidual.robot.pair import Array, Indices


class Sensed(NamedTuple):
    """Readings of N worlds at one moment.

    Attributes:
        time_s: Since the trial began (N,).
        q: Joints (N, n) [rad].
        torque: Of the motors (N, n) [Nm].
        gripper: Openings (N, 2), 0 closed to 1 open.
        grip_n: Closing forces (N, 2) [N].
        wrench: Of the surroundings on each hand (N, 2, 6) [N, Nm], world axes, estimated from
            torques that nothing explains.
        hands: Tcp poses (N, 2, 4, 4), from the joints.
        objects: Sensed poses (N, k, 4, 4) of the task's objects, with noise, offset and delay.
        first: The first of these readings.
        highest_m: Largest sensed rise of the first object (N,).
        goal: Of the first object (N, 3), x, y [m] and yaw [rad].
    """

    time_s: Array
    q: Array
    torque: Array
    gripper: Array
    grip_n: Array
    wrench: Array
    hands: Array
    objects: Array
    first: Array
    highest_m: Array
    goal: Array


class JointReadings(NamedTuple):
    """Readings of the arms alone, named as in `Sensed`."""

    time_s: Array
    q: Array
    torque: Array
    gripper: Array
    grip_n: Array
    wrench: Array


class Senses:
    """Derives further readings from the present ones and earlier ones.

    Args:
        frames: (2, n / 2 + 1, 4, 4), see `ArmIK.frames`.
    """

    def __init__(self, frames: Array, worlds_n: int, objects_n: int = 1) -> None:
        self._frames = frames
        self._hands = np.zeros((worlds_n, 2, 4, 4))
        self._first = np.zeros((worlds_n, objects_n, 4, 4))
        self._highest_m = np.zeros(worlds_n)
        self._goal = np.zeros((worlds_n, 3))

    def reset(self, worlds: Indices, objects: Array, goals: Array) -> None:
        """Begin trials with first sensed poses (m, k, 4, 4) and goals (m, 3)."""
        self._first[worlds] = objects
        self._highest_m[worlds] = 0.0
        self._goal[worlds] = goals

    def read(self, arms: JointReadings, objects: Array) -> Sensed:
        """Return the readings of this moment, with sensed poses (N, k, 4, 4)."""
        place_hands(self._frames, arms.q, self._hands)
        risen_m = objects[:, 0, 2, 3] - self._first[:, 0, 2, 3]
        np.maximum(self._highest_m, risen_m, out=self._highest_m)
        return Sensed(
            *arms,
            hands=self._hands.copy(),
            objects=objects,
            first=self._first.copy(),
            highest_m=self._highest_m.copy(),
            goal=self._goal.copy(),
        )


class PoseSensors:
    """The pose sensors of N worlds: `plant.sensing.Sensors`, with a random stream a world.

    The offset is that of the trial with the same stream. White noise is drawn when it is read.
    """

    def __init__(self, config: SensingConfig, worlds_n: int, dt_s: float) -> None:
        self._config = config
        self._every = max(1, round(1.0 / (config.pose_rate_hz * dt_s)))
        self._late_n = round(config.delay_s / dt_s / self._every)
        self._samples: deque[Array] = deque(maxlen=self._late_n + 1)
        self._steps = 0
        self._offset = np.zeros((worlds_n, 6))
        self._rngs: dict[int, np.random.Generator] = {}
        self._latest = np.tile(np.eye(4), (worlds_n, 1, 1))

    def reset(self, world: int, rng: np.random.Generator) -> None:
        """Draw the offset of a new trial."""
        config = self._config
        offset = rng.standard_normal(6)
        offset[:3] *= config.pose_bias_m
        offset[3:] *= config.pose_bias_rad
        self._offset[world] = offset
        self._rngs[world] = rng

    def begin(self, worlds: Indices, poses: Array) -> None:
        """Forget samples of earlier trials; the first true poses (N, 4, 4) stand for them."""
        if not self._samples:
            self._samples.extend(poses.copy() for _ in range(self._late_n + 1))
        for sample in self._samples:
            sample[worlds] = poses[worlds]

    def note(self, R: Array, p: Array) -> None:
        """Take the true orientation (N, 3, 3) and position (N, 3) of a physics step."""
        self._steps += 1
        if self._steps % self._every:
            return
        oldest = self._samples.popleft()
        oldest[:, :3, :3] = R
        oldest[:, :3, 3] = p
        self._samples.append(oldest)

    @property
    def offset(self) -> Array:
        """Constant errors (N, 6) [m, rad] of the present trials."""
        return self._offset.copy()

    def read(self, worlds: Indices) -> Array:
        """Read anew in some worlds; return the latest sensed poses (N, 4, 4) of all."""
        error = self._offset[worlds]
        scale = np.repeat([self._config.pose_noise_m, self._config.pose_noise_rad], 3)
        for row, world in enumerate(worlds.tolist()):
            error[row] += scale * self._rngs[world].standard_normal(6)
        Ts = self._samples[0][worlds]
        Ts[:, :3, 3] += error[:, :3]
        Ts[:, :3, :3] = rotations(error[:, 3:]) @ Ts[:, :3, :3]
        self._latest[worlds] = Ts
        return self._latest.copy()


def rotations(vectors: Array) -> Array:
    """Return the rotations (N, 3, 3) of rotation vectors (N, 3) [rad], by Rodrigues' formula."""
    angle = np.linalg.norm(vectors, axis=1)
    safe = np.maximum(angle, 1e-12)
    K = np.zeros((len(vectors), 3, 3))
    x, y, z = (vectors / safe[:, None]).T
    K[:, 0, 1] = -z
    K[:, 0, 2] = y
    K[:, 1, 0] = z
    K[:, 1, 2] = -x
    K[:, 2, 0] = -y
    K[:, 2, 1] = x
    sine = np.sin(angle)[:, None, None]
    cosine = np.cos(angle)[:, None, None]
    return np.eye(3) + sine * K + (1.0 - cosine) * (K @ K)


def yaw_of(Ts: Array) -> Array:
    """Return the yaws (...) [rad] of the y axes of poses (..., 4, 4), as `placement` does."""
    return np.arctan2(-Ts[..., 0, 1], Ts[..., 1, 1])


def hand_yaw(Ts: Array) -> Array:
    """Return the yaws (...) [rad] of hands that point down, of poses Rz(yaw) Rx(pi)."""
    return np.arctan2(Ts[..., 1, 0], Ts[..., 0, 0])


def nearest_turn(angle: Array, symmetry: int = 1) -> Array:
    """Return angles [rad] less the nearest multiple of a turn, or of 1 / `symmetry` of it."""
    period = 2.0 * np.pi / symmetry
    return angle - period * np.round(angle / period)
