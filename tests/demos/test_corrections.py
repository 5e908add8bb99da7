"""A policy drives, a leader takes over and hands back; ticks say who drove."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import pytest

from minidual.config.learning import TeleopConfig
from minidual.config.root import Config
from minidual.demos.corrections import Corrections
from minidual.demos.episode import read_episode
from minidual.demos.leader import LEADERS, Features, Feedback, Leader, LeaderSample, LeaderSetup
from minidual.demos.leaders.corrector import CORRECTIONS_MAX, STRAY_RAD, ScriptedCorrector
from minidual.demos.mirror import Mirror
from minidual.demos.rig import Job, Rig
from minidual.demos.signals import ARBITER_STATES, DRIVERS, Driver
from minidual.demos.station import Button
from minidual.errors import DataError, UsageError
from minidual.plant.render import Image
from minidual.robot.pair import DUAL_PANDA, Array
from minidual.skills.operator import Demonstration
from minidual.stages.config_checks import check_leader
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Trial

HOME = DUAL_PANDA.home
OPEN = np.ones(2)
CONFIG = Config()
TELEOP = TeleopConfig()


class Pushing:
    """A policy that adds a step to the posture in every tick.

    Attributes:
        resets_n: How often it began anew.
    """

    cameras: Mapping[str, tuple[int, int]] = {}
    inputs: Mapping[str, int] = {}

    def __init__(self, step_rad: Array | float = 0.0, openings: Array = OPEN) -> None:
        self._step_rad = step_rad
        self._openings = openings
        self.resets_n = 0

    def reset(self) -> None:
        self.resets_n += 1

    def act(self, images: Mapping[str, Image], state: Array) -> Array:
        return np.concatenate([state[:14] + self._step_rad, self._openings])


class Feeling(Pushing):
    """A policy that reads joint torques, too."""

    inputs: Mapping[str, int] = {"joint_torques": 14}

    def act(self, images: Mapping[str, Image], state: Array) -> Array:
        assert state.shape == (30,)
        assert np.abs(state[16:]).max() > 1.0, "torques hold the arms up"
        return super().act(images, state)


class Broken(Pushing):
    """A policy that cannot drive."""

    def act(self, images: Mapping[str, Image], state: Array) -> Array:
        raise DataError("the policy emits nonsense")


class Told(Leader):
    """Gives the sample that a test sets.

    Attributes:
        resumed: Joints from which it was told to lead on.
    """

    features: ClassVar[Features] = Features(clutch=True)

    def __init__(self) -> None:
        self.sample = LeaderSample(OPEN, q=HOME)
        self.resumed: list[Array] = []

    @classmethod
    def connect(cls, setup: LeaderSetup) -> Self:
        return cls()

    def resume(self, q_follower: Array) -> None:
        self.resumed.append(q_follower)

    def read(self, now_s: float) -> LeaderSample | None:
        return self.sample


class Wheel:
    """Leader, policy and arms that stand where they were sent."""

    def __init__(self, policy: Pushing, leader: Leader | None = None) -> None:
        self.leader = leader or Told()
        self.mirror = Mirror(self.leader, DUAL_PANDA, TELEOP)
        self.mirror.begin(HOME)
        self.corrections = Corrections(policy, self.mirror)
        self.corrections.begin(HOME, OPEN)
        self.q = HOME.copy()
        self.openings = OPEN.copy()
        self.now_s = 0.0
        self.has_ended = False

    def tick(self, *pressed: Button) -> Driver:
        """Run one tick; return who drove."""
        read = self.mirror.read if self.corrections.drives else self.mirror.poll
        reading = read(self.now_s)
        buttons = pressed if reading is None else (*pressed, *reading.pressed)
        self.has_ended = Button.SUCCESS in buttons
        state = np.concatenate([self.q, self.openings])
        wanted = self.corrections.command(reading, buttons, {}, state)
        if wanted is not None:
            self.q = wanted.target
            self.openings = wanted.openings
        self.now_s += 0.02
        return self.corrections.driver


def test_the_button_takes_the_arms_over_and_hands_them_back() -> None:
    policy = Pushing(0.01)
    wheel = Wheel(policy)
    leader = wheel.leader
    assert isinstance(leader, Told)
    assert [wheel.tick() for _ in range(5)] == [Driver.POLICY] * 5
    assert wheel.q == pytest.approx(HOME + 0.05)
    assert wheel.tick(Button.CORRECT) is Driver.CORRECTION
    assert wheel.q == pytest.approx(HOME + 0.05), "the arms go on from where they are"
    assert leader.resumed[0] == pytest.approx(HOME + 0.05)
    leader.sample = LeaderSample(OPEN, q=HOME + 0.1)
    wheel.tick()
    assert wheel.q == pytest.approx(HOME + 0.1)
    assert policy.resets_n == 1
    assert wheel.tick(Button.CORRECT) is Driver.POLICY
    assert policy.resets_n == 2
    assert wheel.q == pytest.approx(HOME + 0.11)


def test_arms_hold_until_a_leader_that_took_over_stands_where_they_are() -> None:
    wheel = Wheel(Pushing())
    leader = wheel.leader
    assert isinstance(leader, Told)
    leader.sample = LeaderSample(OPEN, q=HOME + 0.5)
    wheel.tick(Button.CORRECT)
    for _ in range(5):
        wheel.tick()
    assert wheel.q == pytest.approx(HOME)
    assert "rad" in wheel.mirror.gate.held


def test_the_clutch_takes_over_and_arms_follow_once_it_is_released() -> None:
    wheel = Wheel(Pushing())
    leader = wheel.leader
    assert isinstance(leader, Told)
    leader.sample = LeaderSample(OPEN, q=HOME + 0.5, clutch=True)
    assert wheel.tick() is Driver.CORRECTION
    wheel.tick()
    assert wheel.q == pytest.approx(HOME)
    leader.sample = LeaderSample(OPEN, q=HOME + 0.5)
    wheel.tick()
    leader.sample = LeaderSample(OPEN, q=HOME + 0.52)
    assert wheel.tick() is Driver.CORRECTION
    assert wheel.q == pytest.approx(HOME + 0.02)


def test_a_hand_keeps_its_opening_until_the_leaders_comes_near() -> None:
    """A take-over must not drop what the policy holds."""
    wheel = Wheel(Pushing(openings=np.array([0.2, 0.2])))
    leader = wheel.leader
    assert isinstance(leader, Told)
    wheel.tick()
    wheel.tick(Button.CORRECT)
    wheel.tick()
    assert wheel.openings == pytest.approx([0.2, 0.2])
    leader.sample = LeaderSample(np.array([0.3, 1.0]), q=HOME)
    wheel.tick()
    leader.sample = LeaderSample(OPEN, q=HOME)
    wheel.tick()
    assert wheel.openings == pytest.approx([1.0, 0.2]), "the left hand was taken over"


def test_a_policy_that_cannot_drive_leaves_the_arms_to_the_leader() -> None:
    wheel = Wheel(Broken())
    assert wheel.tick() is Driver.CORRECTION
    assert wheel.corrections.refusal == "the policy emits nonsense"
    assert wheel.tick(Button.CORRECT) is Driver.CORRECTION, "it is not handed back to"


def swing_plan() -> Demonstration:
    """Return 4 s in which the second joints swing, hands open."""
    t = np.arange(200) / 50.0
    q = np.tile(HOME, (200, 1))
    q[:, [1, 8]] += 0.3 * (1.0 - np.cos(np.pi * t / 4.0))[:, None]
    return Demonstration(50.0, q, np.ones((200, 2)))


def corrected(policy: Pushing, ticks_max: int) -> tuple[list[Driver], ScriptedCorrector, Wheel]:
    corrector = ScriptedCorrector()
    corrector.demonstration = swing_plan()
    corrector.begin(HOME)
    wheel = Wheel(policy, corrector)
    drivers: list[Driver] = []
    while len(drivers) < ticks_max and not wheel.has_ended:
        drivers.append(wheel.tick())
        corrector.feedback(Feedback(wheel.now_s, wheel.q, wheel.openings, np.zeros(14)))
    return drivers, corrector, wheel


def test_the_scripted_corrector_takes_over_from_a_policy_that_strays() -> None:
    drift = np.zeros(14)
    drift[3] = 0.02
    drivers, corrector, wheel = corrected(Pushing(drift), 600)
    assert Driver.POLICY in drivers
    assert Driver.CORRECTION in drivers
    assert 1 <= corrector.corrections_n <= CORRECTIONS_MAX
    assert len(drivers) < 600, "it ends with success"
    assert np.abs(wheel.q - swing_plan().q[-1]).max() < STRAY_RAD


def test_the_scripted_corrector_takes_over_from_a_policy_that_stands_still() -> None:
    drivers, corrector, _ = corrected(Pushing(), 600)
    assert drivers[0] is Driver.POLICY
    assert corrector.corrections_n >= 1
    assert len(drivers) < 600


class Sways(Leader):
    """A person who corrects for half a second."""

    features: ClassVar[Features] = Features(realtime=True)

    @classmethod
    def connect(cls, setup: LeaderSetup) -> Self:
        return cls()

    def align(self, trial: Trial, q_follower: Array) -> None:
        self._waiting = [(0.4, Button.CORRECT), (0.9, Button.CORRECT), (1.3, Button.FAILURE)]
        self._q = q_follower

    def resume(self, q_follower: Array) -> None:
        self._q = q_follower

    def read(self, now_s: float) -> LeaderSample | None:
        pressed: tuple[Button, ...] = ()
        if self._waiting and now_s >= self._waiting[0][0]:
            pressed = (self._waiting.pop(0)[1],)
        return LeaderSample(OPEN, q=self._q + 0.02 * np.sin(8.0 * now_s), pressed=pressed)


@pytest.fixture
def sways() -> Iterator[None]:
    LEADERS.add("sways", Sways)
    yield
    LEADERS._rows.pop("sways")


def sways_rig(folder: Path, policy: Pushing, **teleop: Any) -> Rig:
    settings = {
        "leader": "sways",
        "person": {"wait_for_start": False},
        "correct": "checkpoint",
        **teleop,
    }
    config = TeleopConfig.model_validate(settings).model_copy(update={"cameras": ()})
    job = Job(folder, make_task(CONFIG), config, CONFIG.arbiter, 1, policy=lambda: policy)
    return Rig(job, cameras=())


def test_an_episode_holds_who_drove_and_the_signals_that_were_chosen(
    tmp_path: Path, sways: None
) -> None:
    swing = np.zeros(14)
    swing[1] = 0.004
    forces = ["joint_torques", "external_torques", "hand_wrench", "internal_force"]
    signals = [*forces, "arbiter_state", "reflex", "late_s"]
    rig = sways_rig(tmp_path, Feeling(swing), signals=signals)
    attempt = rig.record(0)
    rig.close()
    assert attempt.path is not None
    episode = read_episode(attempt.path)
    ticks = len(episode)
    driver = episode.signals["driver"]
    drove = [DRIVERS[int(code)] for code in driver]
    assert drove[0] is Driver.POLICY
    assert drove[-1] is Driver.POLICY
    assert 15 <= drove.count(Driver.CORRECTION) <= 35
    assert np.count_nonzero(np.diff(driver)) == 2
    assert episode.effort is not None
    assert episode.effort.shape == (ticks, 14)
    np.testing.assert_array_equal(episode.signals["joint_torques"], episode.effort)
    assert episode.signals["external_torques"].shape == (ticks, 14)
    assert np.abs(episode.signals["external_torques"]).max() > 0.0
    assert episode.signals["hand_wrench"].shape == (ticks, 2, 6)
    assert (episode.signals["internal_force"] >= 0.0).all()
    states = {ARBITER_STATES[int(code)] for code in episode.signals["arbiter_state"]}
    assert "active" in states
    assert not episode.signals["reflex"].any()
    assert episode.signals["signal_timestamps"] == pytest.approx(episode.timestamps)
    assert episode.meta.extra["corrects"] == "checkpoint"


def test_a_policy_must_look_through_what_is_recorded(tmp_path: Path, sways: None) -> None:
    class Looking(Pushing):
        cameras: Mapping[str, tuple[int, int]] = {"left": (96, 128)}

    with pytest.raises(UsageError, match="looks through camera 'left'; recorded are none"):
        sways_rig(tmp_path, Looking())


def test_a_leader_that_plays_an_episode_from_its_start_cannot_correct() -> None:
    teleop = CONFIG.teleop.model_copy(update={"correct": "checkpoint"})
    with pytest.raises(UsageError, match="'scripted' plays an episode from its start") as caught:
        check_leader(CONFIG.model_copy(update={"teleop": teleop}))
    assert "teleop.leader=corrector" in (caught.value.remedy or "")
    able = teleop.model_copy(update={"leader": "corrector"})
    check_leader(CONFIG.model_copy(update={"teleop": able}))
