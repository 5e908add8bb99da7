"""A leader behind a link: late, complete, and stopped when the link makes energy."""

from __future__ import annotations

from typing import ClassVar, Self

import numpy as np
import pytest

from minidual.config.root import Config
from minidual.control.tick_check import Violation
from minidual.demos.leader import Features, Feedback, Leader, LeaderSample, LeaderSetup
from minidual.demos.link.linked_leader import LinkedLeader, linked
from minidual.demos.station import Button
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Array
from minidual.tasks.catalogue import make_task
from tests.support.panda import HOME

DT_S = 0.02


class Hand(Leader):
    """Moves the first joint of each arm, and keeps what it feels."""

    def __init__(self) -> None:
        self.moved_rad = 0.0
        self.clutch = False
        self.pressed: tuple[Button, ...] = ()
        self.felt_nm: list[Array] = []

    @classmethod
    def connect(cls, setup: LeaderSetup) -> Self:
        return cls()

    def read(self, now_s: float) -> LeaderSample | None:
        q = HOME.copy()
        q[[0, 7]] += self.moved_rad
        sample = LeaderSample(np.array([0.0, 1.0]), q=q, pressed=self.pressed, clutch=self.clutch)
        self.pressed = ()
        return sample

    def feedback(self, feedback: Feedback) -> None:
        self.felt_nm.append(feedback.external_nm)


class Poses(Hand):
    """Gives poses of the hands: both away along x."""

    features: ClassVar[Features] = Features(targets="poses")

    def read(self, now_s: float) -> LeaderSample | None:
        Ts = [np.array(T) for T in Kinematics().tcp_poses(HOME)]
        for T in Ts:
            T[0, 3] += self.moved_rad
        return LeaderSample(np.ones(2), Ts_world_tcp=Ts)


def setup_of(network: str, **link: object) -> LeaderSetup:
    """Return the setup of a recording over a network."""
    config = Config.model_validate({"teleop": {"link": {"network": network, **link}}})
    return LeaderSetup(DUAL_PANDA, make_task(config), config.teleop, seed=1)


def behind(network: str, leader: Hand | None = None, **link: object) -> tuple[Hand, LinkedLeader]:
    """Return a leader, and itself behind a network."""
    hand = Hand() if leader is None else leader
    setup = setup_of(network, **link)
    return hand, LinkedLeader(hand, setup)


def tick(link: LinkedLeader, met_nm: Array | None = None) -> LeaderSample:
    """Run one tick whose arms meet torques (n,)."""
    sample = link.read(0.0)
    assert sample is not None
    met = np.zeros(14) if met_nm is None else met_nm
    link.feedback(Feedback(0.0, HOME, np.ones(2), np.zeros(14), met))
    return sample


def test_without_a_network_a_leader_stays_as_it_is() -> None:
    hand = Hand()
    assert linked(hand, setup_of("")) is hand
    assert isinstance(linked(hand, setup_of("delay=10ms")), LinkedLeader)


def test_targets_and_grips_arrive_after_half_of_the_round_trip() -> None:
    hand, link = behind("delay=200ms")
    hand.moved_rad = 0.05
    samples = [tick(link) for _ in range(8)]
    moved = [float(sample.q[0] - HOME[0]) for sample in samples if sample.q is not None]
    assert moved == pytest.approx([0.0] * 5 + [0.05] * 3)
    assert [float(sample.openings[0]) for sample in samples] == [1.0] * 5 + [0.0] * 3


def test_hands_keep_their_openings_when_the_leader_leads_on() -> None:
    _, link = behind("delay=200ms")
    before = [tick(link) for _ in range(8)][-1]
    link.resume(HOME)
    after = [tick(link) for _ in range(8)]
    assert [float(sample.openings[0]) for sample in (before, *after)] == [0.0] * 9
    link.align(make_task(Config()).trial(1, "test", 0), HOME)
    assert float(tick(link).openings[0]) == 1.0, "a new trial begins with open hands"


def test_a_button_arrives_late_and_is_never_lost() -> None:
    hand, link = behind("delay=100ms,jitter=20ms,loss=50%")
    hand.pressed = (Button.SUCCESS,)
    pressed = [tick(link).pressed for _ in range(10)]
    assert pressed == [()] * 3 + [(Button.SUCCESS,)] + [()] * 6


def test_what_the_arms_meet_is_felt_after_a_round_trip() -> None:
    hand, link = behind("delay=200ms")
    met = np.zeros(14)
    met[0] = -6.0
    for _ in range(20):
        tick(link, met)
    felt = [float(torque[0]) for torque in hand.felt_nm]
    assert felt[0] == 0.0
    assert felt[-1] == pytest.approx(-4.0, abs=0.01), "less what may be noise"


def test_a_held_clutch_moves_no_arm() -> None:
    hand, link = behind("delay=0ms")
    tick(link)
    hand.clutch = True
    hand.moved_rad = 0.3
    sample = tick(link)
    assert sample.clutch
    assert sample.q == pytest.approx(HOME)
    hand.clutch = False
    hand.moved_rad = 0.35
    sample = tick(link)
    assert sample.q is not None
    assert sample.q[0] - HOME[0] == pytest.approx(0.05)


def test_poses_travel_too() -> None:
    hand, link = behind("delay=80ms", Poses())
    hand.moved_rad = 0.04
    samples = [tick(link) for _ in range(4)]
    start = Kinematics().tcp_poses(HOME)[0][0, 3]
    moved: list[float] = []
    for sample in samples:
        assert sample.Ts_world_tcp is not None
        moved.append(float(sample.Ts_world_tcp[0][0, 3] - start))
    assert moved == pytest.approx([0.0, 0.0, 0.04, 0.04])


def test_a_trial_has_the_same_network_each_time() -> None:
    _, link = behind("delay=100ms,jitter=80ms,loss=20%")
    trial = make_task(Config()).trial(0, "demonstrations", 3)

    def played() -> list[float]:
        link.align(trial, HOME)
        places: list[float] = []
        for k in range(50):
            link.leader.moved_rad = 0.001 * k  # type: ignore[attr-defined]
            q = tick(link).q
            assert q is not None
            places.append(float(q[0]))
        return places

    assert played() == played()


def pulled(link: LinkedLeader, hand: Hand) -> None:
    """Let a spring of the arms' side be wound up by a leader that feels it too late."""
    for k in range(200):
        hand.moved_rad = 0.1 * np.sin(0.15 * k)
        link_q = tick_reference(link)
        met = np.zeros(14)
        met[0] = -100.0 * (link_q - HOME[0])
        link.feedback(Feedback(0.0, HOME, np.ones(2), np.zeros(14), met))


def tick_reference(link: LinkedLeader) -> float:
    sample = link.read(0.0)
    assert sample is not None
    assert sample.q is not None
    return float(sample.q[0])


def test_energy_that_the_link_makes_is_a_violation() -> None:
    hand, link = behind("delay=200ms", passive=False)
    pulled(link, hand)
    violation = link.violation
    assert isinstance(violation, Violation)
    assert violation.name == "passivity"
    assert violation.where == "left arm for 0.5 s"
    assert violation.value < -0.5


def test_a_passive_link_makes_none_and_tells_what_it_did() -> None:
    hand, link = behind("delay=200ms")
    pulled(link, hand)
    assert link.violation is None
    measures = link.measures()
    assert measures["link_energy_min_j"] > -0.5
    assert measures["link_active_share"] > 0.1
    assert measures["link_drift_max"] > 0.01
    rows = link.rows()
    assert len(rows) == 200
    assert {"left arm leader_j", "right arm drift"} < set(rows[0])


def test_what_a_leader_moves_while_time_stands_still_costs_nothing_and_is_no_tick() -> None:
    hand, link = behind("delay=0ms")
    met = np.zeros(14)
    met[0] = -20.0
    for k in range(20):
        hand.moved_rad = 0.001 * k
        tick(link, met)
    before = link.rows()[-1]
    for k in range(50):  # a pause
        hand.moved_rad = 0.02 + 0.002 * k
        assert link.read(0.4) is not None
    tick(link)
    rows = link.rows()
    assert len(rows) == 21
    assert rows[-1]["left arm arms_j"] >= before["left arm arms_j"] - 0.05
    assert rows[-1]["left arm drift"] == pytest.approx(0.0, abs=1e-3)
