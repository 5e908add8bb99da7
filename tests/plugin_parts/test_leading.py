"""Leaders read as named targets: of the arms of this process, or of arms that stand at home."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Self

import numpy as np
import pytest

from minidual.demos.leader import LEADERS, Features, Feedback, Leader, LeaderSample, LeaderSetup
from minidual.demos.station import Button
from minidual.errors import UsageError
from minidual.plugin_parts.arms import ArmsSettings, SimulatedArms
from minidual.plugin_parts.leading import Lead, LeadSettings
from minidual.robot.pair import DUAL_PANDA


class Person(Leader):
    """Leads the first joint, 1 mrad a reading, and ends the episode when it is told to."""

    features = Features(realtime=True)
    ends = False

    @classmethod
    def connect(cls, setup: LeaderSetup) -> Self:
        leader = cls()
        leader.rate_hz = setup.config.rate_hz
        return leader

    def align(self, trial, q_follower) -> None:
        self.q = np.array(q_follower)
        self.states: list[Feedback] = []

    def read(self, now_s: float) -> LeaderSample | None:
        self.q[0] += 0.001
        pressed = (Button.SUCCESS,) if Person.ends else ()
        return LeaderSample(np.ones(2), q=self.q.copy(), pressed=pressed)

    def feedback(self, feedback: Feedback) -> None:
        self.states.append(feedback)


@pytest.fixture
def person(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LEADERS._rows, "person", Person)
    monkeypatch.setattr(Person, "ends", False)


@pytest.fixture
def arms() -> Iterator[SimulatedArms]:
    made = SimulatedArms(ArmsSettings(views=(), rate_hz=30.0))
    made.connect()
    yield made
    made.close()


def test_a_leader_begins_where_the_arms_are_and_hears_of_them(person, arms: SimulatedArms) -> None:
    lead = Lead(LeadSettings("person"))
    lead.connect()
    action = lead.action()
    assert tuple(action) == arms.names
    assert action["left_panda_joint1.pos"] == pytest.approx(arms.q[0] + 0.001, abs=1e-6)
    assert lead._leader.rate_hz == 30.0
    assert lead._leader.states[0].q == pytest.approx(arms.q)
    lead.close()
    assert not lead.is_connected


def test_a_person_s_button_goes_to_the_next_start(person, arms: SimulatedArms) -> None:
    lead = Lead(LeadSettings("person"))
    lead.connect()
    lead.action()
    Person.ends = True
    action = lead.action()
    assert arms.trial.index == 1
    # The arms do not chase the target of the episode before.
    assert action["left_panda_joint1.pos"] == pytest.approx(arms.q[0], abs=1e-6)


def test_without_arms_in_the_process_a_leader_leads_arms_at_home(person) -> None:
    lead = Lead(LeadSettings("person"))
    lead.connect()
    assert lead.action()["right_panda_joint1.pos"] == pytest.approx(DUAL_PANDA.home[7])


def test_the_script_knows_the_start_of_the_arms(arms: SimulatedArms) -> None:
    """Its plan begins at the arms, and ends in another posture."""
    lead = Lead(LeadSettings())
    lead.connect()
    first = lead.action()
    assert list(first.values())[:14] == pytest.approx(list(arms.q), abs=0.02)
    for tick in range(120):
        arms._time_s = tick / 30.0
        later = lead.action()
    assert max(abs(later[name] - first[name]) for name in arms.names[:14]) > 0.1
    assert later["left_gripper.pos"] == 0.0


def test_leaders_that_need_a_picture_are_refused() -> None:
    with pytest.raises(UsageError, match="the leader 'browser' needs minidual's own view"):
        Lead(LeadSettings("browser"))
    with pytest.raises(UsageError, match=r"(?s)no leader 'scriptd'.*did you mean 'scripted'"):
        Lead(LeadSettings("scriptd"))


def test_a_leader_that_is_not_connected_says_so() -> None:
    with pytest.raises(UsageError, match="not connected"):
        Lead(LeadSettings()).action()
