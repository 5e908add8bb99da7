"""A leader of hand poses is followed smoothly, within limits, by the one inverse kinematics."""

from __future__ import annotations

from typing import Self

import numpy as np
import pytest

from minidual.config.learning import TeleopConfig
from minidual.demos.leader import Features, Leader, LeaderSample, LeaderSetup
from minidual.demos.mirror import Mirror, Mirrored
from minidual.demos.quality import rms_jerk
from minidual.errors import UsageError
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Array, rot_z

HOME = DUAL_PANDA.home
CONFIG = TeleopConfig()
RATE_HZ = CONFIG.rate_hz


class Hands(Leader):
    """Holds its hands where it is told."""

    features = Features(targets="poses", realtime=True)

    def __init__(self) -> None:
        self.Ts = [T.copy() for T in Kinematics().tcp_poses(HOME)]
        self.clutch = False

    @classmethod
    def connect(cls, setup: LeaderSetup) -> Self:
        return cls()

    def read(self, now_s: float) -> LeaderSample | None:
        return LeaderSample(np.ones(2), Ts_world_tcp=self.Ts, clutch=self.clutch)


@pytest.fixture
def leader() -> Hands:
    return Hands()


@pytest.fixture
def mirror(leader: Hands) -> Mirror:
    made = Mirror(leader, DUAL_PANDA, CONFIG)
    made.begin(HOME)
    return made


def read(mirror: Mirror) -> Mirrored:
    reading = mirror.read(0.0)
    assert reading is not None
    return reading


def follow(mirror: Mirror, seconds: float) -> Array:
    """Return the targets (T, n) of some seconds."""
    return np.array([read(mirror).target for _ in range(round(seconds * RATE_HZ))])


def test_a_hand_goes_where_the_leader_is_at_bounded_joint_and_hand_speed(
    leader: Hands,
    mirror: Mirror,
) -> None:
    follow(mirror, 0.1)
    leader.Ts[0][:3, 3] += (0.15, -0.05, -0.2)
    leader.Ts[0][:3, :3] = rot_z(0.6) @ leader.Ts[0][:3, :3]
    q = follow(mirror, 3.0)
    np.testing.assert_allclose(Kinematics().tcp_poses(q[-1])[0], leader.Ts[0], atol=1e-4)
    np.testing.assert_allclose(q[-1][7:], HOME[7:], atol=1e-6)
    assert np.all(np.abs(np.diff(q, axis=0)) * RATE_HZ <= 0.71 * DUAL_PANDA.v_max)
    places = np.array([Kinematics().tcp_poses(each)[0][:3, 3] for each in q])
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) * RATE_HZ
    assert speeds.max() <= CONFIG.mirror.hand_speed_max_m_s + 1e-6
    assert rms_jerk(q, RATE_HZ) < CONFIG.jerk_max_rad_s3


def test_the_arms_wait_for_hands_that_begin_elsewhere(leader: Hands, mirror: Mirror) -> None:
    leader.Ts[1][0, 3] += 0.2
    np.testing.assert_array_equal(follow(mirror, 0.2)[-1], HOME)
    assert "from the arms" in mirror.gate.held
    assert "right_panda_joint" in mirror.gate.held
    leader.Ts[1][0, 3] += 3.0
    follow(mirror, 0.1)
    assert mirror.gate.held == "the hands of the leader are out of the arms' reach"
    leader.Ts[1][0, 3] -= 3.2
    follow(mirror, 0.1)
    assert mirror.gate.is_open


def test_with_a_clutch_the_hands_follow_from_where_they_are(leader: Hands, mirror: Mirror) -> None:
    follow(mirror, 0.1)
    leader.clutch = True
    leader.Ts[0][:3, 3] += (0.4, 0.3, 0.2)
    leader.Ts[0][:3, :3] = rot_z(1.0) @ leader.Ts[0][:3, :3]
    np.testing.assert_allclose(follow(mirror, 0.5)[-1], HOME, atol=1e-6)
    leader.clutch = False
    np.testing.assert_allclose(follow(mirror, 0.5)[-1], HOME, atol=1e-5)
    leader.Ts[0][2, 3] -= 0.05
    left = Kinematics().tcp_poses(follow(mirror, 2.0)[-1])[0]
    expected = Kinematics().tcp_poses(HOME)[0].copy()
    expected[2, 3] -= 0.05
    np.testing.assert_allclose(left, expected, atol=1e-4)


def test_a_hand_that_is_pulled_out_of_reach_stays_in_reach_and_the_other_goes_on(
    leader: Hands,
    mirror: Mirror,
) -> None:
    follow(mirror, 0.1)
    leader.Ts[0][0, 3] += 2.0
    leader.Ts[1][2, 3] -= 0.1
    q = follow(mirror, 6.0)
    assert mirror.hint == "left hand: out of reach"
    left, right = Kinematics().tcp_poses(q[-1])
    assert np.all(q <= DUAL_PANDA.q_upper)
    assert np.all(q >= DUAL_PANDA.q_lower)
    assert 0.4 < left[0, 3] < 0.9
    np.testing.assert_allclose(right, leader.Ts[1], atol=1e-4)


def test_a_hand_is_not_led_into_the_table(leader: Hands, mirror: Mirror) -> None:
    follow(mirror, 0.1)
    leader.Ts[0][2, 3] = -0.3
    left = Kinematics().tcp_poses(follow(mirror, 4.0)[-1])[0]
    assert left[2, 3] == pytest.approx(CONFIG.mirror.hand_height_min_m, abs=1e-4)


def test_a_hand_that_is_thrown_gains_and_loses_speed_slowly(leader: Hands, mirror: Mirror) -> None:
    follow(mirror, 0.1)
    leader.Ts[0][1, 3] += 0.15
    q = follow(mirror, 2.0)
    places = np.array([Kinematics().tcp_poses(each)[0][:3, 3] for each in (HOME, *q)])
    np.testing.assert_allclose(places[-1], leader.Ts[0][:3, 3], atol=1e-4)
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) * RATE_HZ
    limits = CONFIG.mirror
    gain_max_m_s2 = limits.hand_speed_max_m_s / limits.hand_ramp_s
    assert np.max(speeds) > 0.25
    assert (
        np.max(np.abs(np.diff(speeds))) * RATE_HZ <= 1.1 * gain_max_m_s2
    )  # places are half a period behind


def test_a_hand_slows_over_the_table_so_that_it_can_stop_there(
    leader: Hands,
    mirror: Mirror,
) -> None:
    follow(mirror, 0.1)
    leader.Ts[0][2, 3] = -0.3
    q = follow(mirror, 4.0)
    heights_m = np.array([Kinematics().tcp_poses(each)[0][2, 3] for each in q])
    room_m = heights_m[1:] - CONFIG.mirror.hand_height_min_m
    speed_m_s = -np.diff(heights_m) * RATE_HZ
    braking_m_s2 = 0.8  # of the soft stop in this posture
    assert np.max(speed_m_s) > 0.3
    assert np.all(speed_m_s**2 / (2.0 * braking_m_s2) <= room_m + 0.004)


def test_a_poll_moves_nothing_and_sees_that_the_hands_were_moved_away(
    leader: Hands,
    mirror: Mirror,
) -> None:
    mirror.poll(0.0)
    assert mirror.gate.is_open
    leader.Ts[0][2, 3] -= 0.2
    reading = mirror.poll(0.0)
    assert reading is not None
    np.testing.assert_array_equal(reading.target, HOME)
    assert not mirror.gate.is_open


def test_a_pose_that_is_no_number_is_left_for_the_arbiter(leader: Hands, mirror: Mirror) -> None:
    follow(mirror, 0.1)
    leader.Ts[0][0, 0] = np.nan
    assert np.isnan(read(mirror).target).all()


def test_a_leader_that_gives_nothing_is_refused(
    mirror: Mirror,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Hands, "read", lambda self, now_s: LeaderSample(np.ones(2)))
    with pytest.raises(UsageError, match="neither joints nor hand poses"):
        mirror.read(0.0)
