"""Any plant's arms come home by planned motions, one arm after the other."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.config.root import Config
from minidual.motion.api import Planner
from minidual.plant.lifecycle import Connection
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA
from minidual.skills.plant_drive import DriveError, PlantDrive
from minidual.skills.plant_home import bring_home, lifted
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


class Coasting(Follower):
    """Arms that go on as something else drove them, until the brakes hold them."""

    def __init__(self, speed_rad_s: float, *, brakes_work: bool = True) -> None:
        super().__init__(gentle(DUAL_PANDA).robot)
        self.braking_share = 0.3
        self._coasting = np.full(DUAL_PANDA.dof, speed_rad_s)
        self._brakes_work = brakes_work

    def step(self) -> None:
        if self.targets[1:]:
            super().step()
            return
        if self.braked == (0, 1) and self._brakes_work:
            self._coasting *= 0.5
        self._last = self._q.copy()
        self._q = self._q + self._coasting * self.dt
        self._ticks += 1


def test_arms_that_still_move_are_braked_before_they_are_led_home() -> None:
    plant = Coasting(0.3)
    for _ in range(2):
        plant.step()
    bring_home(Connection("tests:arms", plant).open(), Config(), Planner(), 1)
    assert plant.braked == ()
    assert np.abs(plant.q - DUAL_PANDA.home).max() < 0.01


def test_arms_that_do_not_come_to_rest_are_not_led() -> None:
    plant = Coasting(-0.05, brakes_work=False)
    plant.step()
    with pytest.raises(DriveError, match=r"left_panda_joint1 still moves at 0\.050 rad/s"):
        bring_home(Connection("tests:arms", plant).open(), Config(), Planner(), 1)
    assert plant.targets[1:] == []


def test_a_drive_settles_where_its_last_target_is() -> None:
    plant = gentle(DUAL_PANDA)
    drive = PlantDrive(Connection("tests:arms", plant).open(), Config())
    drive.begin()
    target = drive.q.copy()
    for _ in range(10):
        target = target + 0.004
        drive.step(target)
    assert np.abs(plant.v).max() > 0.1
    drive.settle()
    assert np.abs(plant.v).max() < 0.02
    assert plant.q == pytest.approx(target, abs=1e-3)


def test_hands_at_the_table_go_straight_up_first() -> None:
    kinematics = Kinematics()
    low = np.concatenate(DUAL_PANDA.arm.postures["ready"])
    for _ in range(30):
        for arm in range(2):
            own = DUAL_PANDA.joints_of(arm)
            J = kinematics.tcp_jacobians(low)[arm][:, own]
            low[own] += np.linalg.pinv(J) @ [0.0, 0.0, -0.008, 0.0, 0.0, 0.0]
    before = kinematics.tcp_poses(low)
    assert before[0][2, 3] < 0.05
    after = kinematics.tcp_poses(lifted(kinematics, low))
    for T, T_up in zip(before, after, strict=True):
        assert T_up[2, 3] > 0.18
        assert T_up[:2, 3] == pytest.approx(T[:2, 3], abs=5e-3)
        assert T_up[:3, :3] == pytest.approx(T[:3, :3], abs=0.02)


def test_hands_that_are_high_stay() -> None:
    kinematics = Kinematics()
    assert np.array_equal(lifted(kinematics, DUAL_PANDA.home), DUAL_PANDA.home)
