"""Simulated object sensors with noise and delay.

    pose      at the camera's rate:  p + b_p + n_p,  exp(b_R + n_R) R
    force     every control step:  f + n_f;  pinch:  max(0, F + n_F)

n is white Gaussian noise, b a bias drawn once per trial; samples arrive `delay_s` late.
"""

from collections import deque

import numpy as np
import pinocchio as pin
from numba.core import types

from minidual.config.control import SensingConfig
from minidual.plant.protocol import PoseSample, Reading
from minidual.plant.world import World
from minidual.robot.compiled import ROWS, VECTOR, kernel
from minidual.robot.pair import Array

_BLOCK = 512
_FORCES = 8  # three components of two hands, then two pinches


@kernel(types.void(ROWS, types.int64, VECTOR))
def add_forces(samples: Array, row: int, seen: Array) -> None:
    """Add the forces in `seen` (see `NamedObject.look`) to a row of noise (T, 8)."""
    for i in range(8):
        value = samples[row, i] + seen[6 + i]
        samples[row, i] = 0.0 if i >= 6 and value < 0.0 else value


class Sensors:
    """Samples the world and delivers late; until then, the first sample.

    Smaller noise is the same noise scaled.
    """

    def __init__(
        self,
        world: World,
        config: SensingConfig,
        rng: np.random.Generator,
        name: str | None = None,
    ) -> None:
        self._world = world
        self._config = config
        self._rng = rng
        self._object = world.truth(name)
        self.delay_ticks = round(config.delay_s / world.dt)
        self._period_ticks = max(1, round(1.0 / (config.pose_rate_hz * world.dt)))
        bias = rng.standard_normal(6)
        self._bias = np.r_[config.pose_bias_m * bias[:3], config.pose_bias_rad * bias[3:]]
        self._scale = np.r_[[config.pose_noise_m] * 3, [config.pose_noise_rad] * 3]
        self._tick = 0
        self._begin_s = world.time
        self._dt = world.dt
        self._late = deque[Reading]()

    def sense(self) -> Reading:
        """See `ObjectSensors`."""
        tick = self._tick
        row = self._tick % _BLOCK
        if row == 0:
            # the noise of the next steps, which `add_forces` turns into samples; a view costs less when many are made
            self._samples = self._config.force_noise_n * self._rng.standard_normal(
                (_BLOCK, _FORCES),
            )
            self._forces = list(self._samples[:, :6].reshape(_BLOCK, 2, 3))
            self._pinches = list(self._samples[:, 6:])
        add_forces(self._samples, row, self._object.look())
        pose = (
            None if tick % self._period_ticks else PoseSample(self._sample_pose(), self.delay_ticks)
        )
        # Reading(...) takes three times as long
        reading = tuple.__new__(
            Reading,
            (pose, self._forces[row], self._pinches[row], tick * self._dt + self._begin_s),
        )
        self._late.append(reading)
        self._tick = tick + 1
        if tick:
            return self._late.popleft()
        self._late.extendleft([reading._replace(pose=None)] * self.delay_ticks)
        self._late.popleft()
        return reading  # at rest before the trial

    def _sample_pose(self) -> Array:
        T = self._object.pose()
        error = self._bias + self._scale * self._rng.standard_normal(6)
        T[:3, 3] += error[:3]
        T[:3, :3] = pin.exp3(error[3:]) @ T[:3, :3]
        return T
