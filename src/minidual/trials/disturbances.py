"""Disturbances of conditions: they act on the world while a trial runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from minidual.robot.pair import Array
from minidual.tasks.task import Task

if TYPE_CHECKING:  # the table must be readable without importing MuJoCo
    from minidual.plant.simulation import Simulation

_RISEN_M = 0.05  # before a push
_DELAY_S = (0.2, 1.2)  # from rise to push
_ALOFT_M = 0.01  # lower, the table may take up part of the push
_MOVED_AT_S = 0.5  # the hands have left home and are not yet near


class Push:
    """One ramped force on the carried object's centre of mass, at a random time after its rise.

    Without a ramp 20 N on 0.2 kg throws a rigid object off the pads.
    """

    duration_s = 0.2
    ramp_s = 0.02
    delays_s = _DELAY_S

    def __init__(self, task: Task, rng: np.random.Generator, *, force_n: Sequence[float]) -> None:
        self._force = np.array(force_n, dtype=float)
        self._name = task.carried
        self._delay_s = float(rng.uniform(*self.delays_s))
        self.length_s = self.duration_s + 2.0 * self.ramp_s
        self._rest_m: float | None = None
        self._risen_s = np.inf
        self._stayed_aloft = True
        self.took_place = False

    def at(self, t_s: float) -> Array:
        """Return the force (3,) [N] at a time since its start."""
        share = np.clip(min(t_s, self.length_s - t_s) / self.ramp_s, 0.0, 1.0)
        return share * self._force

    def __call__(self, world: Simulation) -> None:
        """Act or wait."""
        body = world.truth(self._name).body
        height_m = float(world.data.xpos[body, 2])
        if self._rest_m is None:
            self._rest_m = height_m
        risen_m = height_m - self._rest_m
        if risen_m > _RISEN_M:
            self._risen_s = min(self._risen_s, world.time)
        since_s = world.time - self._risen_s - self._delay_s
        world.data.xfrc_applied[body, :3] = self.at(since_s)
        if 0.0 <= since_s < self.length_s:
            self._stayed_aloft = self._stayed_aloft and risen_m > _ALOFT_M
        elif since_s >= self.length_s:
            self.took_place = self._stayed_aloft


class Move:
    """Shifts the carried object once along the table, in a random direction."""

    def __init__(self, task: Task, rng: np.random.Generator, *, distance_m: float) -> None:
        direction = float(rng.uniform(0.0, 2.0 * np.pi))
        self._shift = distance_m * np.array([np.cos(direction), np.sin(direction)])
        self._name = task.carried
        self.took_place = False

    def __call__(self, world: Simulation) -> None:
        """Act or wait."""
        if not self.took_place and world.time >= _MOVED_AT_S:
            world.truth(self._name).qpos[:2] += self._shift
            self.took_place = True
