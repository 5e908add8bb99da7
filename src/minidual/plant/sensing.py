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
from minidual.plant.bodies import HAND_FORCES
from minidual.plant.protocol import PoseSample, Reading
from minidual.plant.render import Camera, StampedImage
from minidual.plant.world import World
from minidual.robot.compiled import ROWS, VECTOR, kernel
from minidual.robot.pair import Array

_BLOCK = 512
"""Control steps whose noise is drawn at once."""
_PINCHES = 6
"""Column of the first of two pinches, after three force components of each hand."""
_FORCES_N = 8


@kernel(types.void(ROWS, types.int64, VECTOR))
def add_forces(samples: Array, row: int, seen: Array) -> None:
    """Add true forces to a row of noise.

    Args:
        samples: (T, 8) [N], three force components of two hands, then two pinches.
        row: Row to change.
        seen: (16,), see `NamedObject.look`.
    """
    for i in range(_FORCES_N):
        value = samples[row, i] + seen[HAND_FORCES + i]
        samples[row, i] = 0.0 if i >= _PINCHES and value < 0.0 else value


class Sensors:
    """Samples the world and delivers late; until then, the first sample.

    With the same seed, smaller noise is the same noise scaled. `name` None means the only object;
    `dt_s` is the control period, by default the world's.
    """

    def __init__(
        self,
        world: World,
        config: SensingConfig,
        rng: np.random.Generator,
        name: str | None = None,
        dt_s: float | None = None,
    ) -> None:
        dt_s = world.dt if dt_s is None else dt_s
        self._world = world
        self._config = config
        self._rng = rng
        self._object = world.truth(name)
        self.delay_ticks = round(config.delay_s / dt_s)
        self._period_ticks = max(1, round(1.0 / (config.pose_rate_hz * dt_s)))
        bias = rng.standard_normal(6)
        self._bias = np.r_[config.pose_bias_m * bias[:3], config.pose_bias_rad * bias[3:]]
        self._scale = np.r_[[config.pose_noise_m] * 3, [config.pose_noise_rad] * 3]
        self._tick = 0
        self._begin_s = world.time
        self._dt = dt_s
        self._late = deque[Reading]()

    def sense(self) -> Reading:
        """See `ObjectSensors`."""
        tick = self._tick
        self._tick = tick + 1
        reading = self._sample(tick)
        self._late.append(reading)
        if tick:
            return self._late.popleft()
        # At rest before the trial: the first sample stands for all that are late.
        self._late.extendleft([reading._replace(pose=None)] * self.delay_ticks)
        self._late.popleft()
        return reading

    def _sample(self, tick: int) -> Reading:
        """Return the readings of this moment."""
        row = tick % _BLOCK
        if row == 0:
            self._draw_noise()
        add_forces(self._samples, row, self._object.look())
        pose = None
        if tick % self._period_ticks == 0:
            pose = PoseSample(self._sample_pose(), self.delay_ticks)
        stamp_s = tick * self._dt + self._begin_s
        # Reading(...) takes three times as long.
        return tuple.__new__(Reading, (pose, self._forces[row], self._pinches[row], stamp_s))

    def _draw_noise(self) -> None:
        """Draw the noise of the next steps, which `add_forces` turns into samples.

        Views are made in one go, because many cost less than one at a time.
        """
        noise = self._rng.standard_normal((_BLOCK, _FORCES_N))
        self._samples = self._config.force_noise_n * noise
        self._forces = list(self._samples[:, :_PINCHES].reshape(_BLOCK, 2, 3))
        self._pinches = list(self._samples[:, _PINCHES:])

    def _sample_pose(self) -> Array:
        T = self._object.pose()
        error = self._bias + self._scale * self._rng.standard_normal(6)
        T[:3, 3] += error[:3]
        T[:3, :3] = pin.exp3(error[3:]) @ T[:3, :3]
        return T


class SimulatedSenses:
    """Sensors and cameras in a simulated world; see `Senses`.

    Args:
        world: The plant's own, or its twin.
        dt_s: Control period.
    """

    def __init__(self, world: World, dt_s: float) -> None:
        self._world = world
        self._dt_s = dt_s
        self._camera: Camera | None = None

    def of_object(
        self,
        config: SensingConfig,
        rng: np.random.Generator,
        name: str | None = None,
    ) -> Sensors:
        """See `Senses`."""
        return Sensors(self._world, config, rng, name, self._dt_s)

    def picture(self, camera: str) -> StampedImage:
        """See `Senses`; the world must have visual meshes."""
        if self._camera is None:  # an OpenGL context is slow to create
            self._camera = Camera.recorded(self._world.model, self._world.scene.camera)
        return self._camera.stamped(self._world.data, camera)
