"""Close and open the hands without slamming: a target inside the object sets the pinch force."""

from __future__ import annotations

import numpy as np

from minidual.config.scene import SceneConfig
from minidual.robot.pair import Array, Robot

CLOSE_BELOW, OPEN_ABOVE = 0.4, 0.6
"""Hysteresis on an opening command in 0..1, so that a wavering policy does not flutter."""


class Grippers:
    """Turns opening commands (0 closed, 1 open) into ramped finger targets [m].

    A finger servo of stiffness kp whose target lies `F / kp` inside the object's surface presses with F.

    Args:
        scene: Holds the finger servo's stiffness and the object's width.
        dt_s: Step of the control loop.
        pinch_force_n: Force to close with.
        speed_m_per_s: Slew rate of each finger.
    """

    def __init__(
        self, scene: SceneConfig, robot: Robot, dt_s: float, *, pinch_force_n: float, speed_m_per_s: float = 0.08
    ) -> None:
        self._travel_m = robot.hand.travel_m
        pinch_force_n = min(pinch_force_n, scene.physics.finger_force_max_n)
        self._closed_m = scene.rod.half_width_m - pinch_force_n / scene.physics.finger_kp_n_per_m
        self._step_m = speed_m_per_s * dt_s
        self.reset()

    def reset(self) -> None:
        """Open both hands at once."""
        self._start(is_open=True)

    def close(self) -> None:
        """Start with both hands closed, as when an object is already held."""
        self._start(is_open=False)

    @property
    def is_open(self) -> Array:
        """Commanded state of each hand (2,), 1 open or 0 closed."""
        return np.array(self._is_open, dtype=float)

    def step(self, command: Array) -> Array:
        """Advance one step towards command (2,) in 0..1; return the finger targets (2,) [m].

        Plain floats: on two numbers they take a fifth of the time of array operations.
        """
        asked = command.tobytes()
        if asked == self._reached:  # the usual case: hands open or shut, and nobody asks for a change
            return self.targets_m
        targets, moved = self._targets, False
        for hand, wanted in enumerate(command.tolist()):
            if wanted > OPEN_ABOVE:
                self._is_open[hand] = True
            elif wanted < CLOSE_BELOW:
                self._is_open[hand] = False
            way = (self._travel_m if self._is_open[hand] else self._closed_m) - targets[hand]
            if way != 0.0:
                targets[hand] += min(self._step_m, max(-self._step_m, way))
                moved = True
        self._reached = b"" if moved else asked
        self.targets_m = np.array(targets)
        return self.targets_m

    def _start(self, *, is_open: bool) -> None:
        self._is_open = [is_open, is_open]
        self._reached = b""
        self._targets = [self._travel_m if is_open else self._closed_m] * 2
        self.targets_m = np.array(self._targets)
