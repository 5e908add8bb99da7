"""Simulated object sensors with noise and delay.

    pose      at the camera's rate:  p + b_p + n_p,  exp(b_R + n_R) R
    force     every control step:  f + n_f;  pinch:  max(0, F + n_F)

n is white Gaussian noise, b a bias drawn once per trial; samples arrive `delay_s` late.
"""

from collections import deque

import numpy as np
import pinocchio as pin

from minidual.config.control import SensingConfig
from minidual.plant.protocol import PoseSample, Reading
from minidual.plant.world import World
from minidual.robot.pair import Array

_BLOCK = 512
_FORCES = 8  # three components of two hands, then two pinches


class Sensors:
    """Samples the world and delivers late; until then, the first sample.

    Smaller noise is the same noise scaled.
    """

    def __init__(self, world: World, config: SensingConfig, rng: np.random.Generator, name: str | None = None) -> None:
        self._world, self._config, self._rng, self._object = world, config, rng, world.truth(name)
        self.delay_ticks = round(config.delay_s / world.dt)
        period = 1.0 / (config.pose_rate_hz * world.dt) if config.pose_rate_hz > 0.0 else 1.0
        self._period_ticks = max(1, round(period))
        bias = rng.standard_normal(6)
        self._bias = np.r_[config.pose_bias_m * bias[:3], config.pose_bias_rad * bias[3:]]
        self._scale = np.r_[[config.pose_noise_m] * 3, [config.pose_noise_rad] * 3]
        self._tick, self._begin_s = 0, world.time
        self._late: deque[tuple[Array | None, Array]] = deque()

    def sense(self) -> Reading:
        """See `ObjectSensors`."""
        tick = self._tick
        forces = self._sample_forces()
        pose = self._sample_pose() if tick % self._period_ticks == 0 else None
        if tick == 0:
            self._late.extend([(None, forces)] * self.delay_ticks)
        self._late.append((pose, forces))
        arrived, forces = self._late.popleft()
        if tick == 0:
            arrived = pose  # at rest before the trial
        self._tick += 1
        sample = None if arrived is None else PoseSample(arrived, self.delay_ticks)
        stamp_s = max(0, tick - self.delay_ticks) * self._world.dt + self._begin_s
        return Reading(sample, forces[:6].reshape(2, 3), forces[6:], stamp_s)

    def _sample_forces(self) -> Array:
        """Return noisy forces and pinches (8,)."""
        row = self._tick % _BLOCK
        if row == 0:
            self._force_noise = self._config.force_noise_n * self._rng.standard_normal((_BLOCK, _FORCES))
        forces: Array = self._object.look()[6:14] + self._force_noise[row]
        pinch = forces[6:]
        np.maximum(pinch, 0.0, pinch)
        return forces

    def _sample_pose(self) -> Array:
        T = self._object.pose()
        error = self._bias + self._scale * self._rng.standard_normal(6)
        T[:3, 3] += error[:3]
        T[:3, :3] = pin.exp3(error[3:]) @ T[:3, :3]
        return T
