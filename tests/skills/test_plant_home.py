"""Any plant's arms come home by planned motions, one arm after the other."""

from __future__ import annotations

import numpy as np

from minidual.config.root import Config
from minidual.motion.api import Planner
from minidual.plant.lifecycle import Connection
from minidual.robot.pair import DUAL_PANDA
from minidual.skills.plant_home import bring_home
from tests.support.position_plant import Follower, gentle


def test_arms_that_are_elsewhere_come_home_with_open_hands() -> None:
    plant = gentle(DUAL_PANDA)
    plant._q = plant._last = plant._target = DUAL_PANDA.home + 0.25
    plant.targets = [plant._q.copy()]
    plant.faults[0] = ("joint_reflex",)
    link = Connection("tests:arms", plant).open()
    bring_home(link, Config(), Planner(), 1)
    assert np.abs(plant.q - DUAL_PANDA.home).max() < 0.01
    assert (plant.openings == 1.0).all()
    assert "recover" in plant.calls
    way = np.abs(np.diff(plant.targets, axis=0))
    left_moves = way[:, :7].max(axis=1) > 2e-3
    right_moves = way[:, 7:].max(axis=1) > 2e-3
    assert not (left_moves & right_moves).any()
    assert left_moves.any()
    assert right_moves.any()


def test_arms_at_home_only_open_their_hands() -> None:
    plant = Follower()
    bring_home(Connection("tests:arms", plant).open(), Config(), Planner(), 1)
    assert np.abs(np.array(plant.targets) - DUAL_PANDA.home).max() < 1e-3
