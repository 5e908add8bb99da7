"""Ticks that come late are counted as overruns; they stop no arm before they are too late."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.config.scene import SceneConfig
from tests.support.panda import HOME
from tests.support.stacks import Arms, hand_over, move, run, supervised, trajectory


class LateArms(Arms):
    """Arms whose loop comes late in a share of the ticks; the last torque acts meanwhile."""

    def __init__(self, scene: SceneConfig, share: float, late_ticks: tuple[int, int]) -> None:
        super().__init__(scene)
        self._rng = np.random.default_rng(1)
        self._share = share
        self._late_ticks = late_ticks
        self.late_n = 0

    def step(self) -> None:
        ticks = 1
        if self._rng.random() < self._share:
            ticks = int(self._rng.integers(*self._late_ticks))
            self.late_n += 1
        for _ in range(ticks):
            super().step()


@pytest.mark.parametrize("share", [0.02, 0.2])
def test_a_loop_that_is_2_to_10_ms_late_now_and_then_drives_on(
    scene: SceneConfig,
    share: float,
) -> None:
    plant = LateArms(scene, share, (2, 11))
    stack = supervised(plant)
    hand_over(stack, "moveit")
    late_before = plant.late_n
    counted_before = stack.overruns_n
    goal = HOME + 0.3
    assert stack.propose("moveit", trajectory(stack, move(plant.q, goal, 1.0))) is None
    assert run(stack, 1500) == []
    assert np.abs(plant.q - goal).max() < 0.02
    assert abs((stack.overruns_n - counted_before) - (plant.late_n - late_before)) <= 1
    assert plant.late_n > 10


def test_a_loop_that_stands_still_stops_the_arms(scene: SceneConfig) -> None:
    plant = LateArms(scene, 0.0, (200, 201))
    stack = supervised(plant)
    hand_over(stack, "moveit")
    plant._share = 1.0
    assert run(stack, 2) == ["stale_command"]
