"""A person's session: start, pause, endings, limits; the arms hold until leader and arms agree."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import pytest

from minidual.config.learning import TeleopConfig
from minidual.config.root import Config
from minidual.demos import recording
from minidual.demos.leader import LEADERS, Features, Leader, LeaderSample, LeaderSetup
from minidual.demos.rig import Job, Rig
from minidual.demos.seat import for_a_person
from minidual.demos.station import Button, Station, Status
from minidual.demos.terminal_station import LineStation
from minidual.errors import UsageError
from minidual.robot.pair import DUAL_PANDA, Array
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Trial

HOME = DUAL_PANDA.home
CONFIG = Config()


class Person(Leader):
    """Sways the second joints; presses what the test says."""

    features: ClassVar[Features] = Features(realtime=True)
    pressing: ClassVar[Callable[[float], tuple[Button, ...]]]
    offset: ClassVar[Array]
    aligned_n: ClassVar[int]
    resumed: ClassVar[list[Array]]

    @classmethod
    def connect(cls, setup: LeaderSetup) -> Self:
        return cls()

    def align(self, trial: Trial, q_follower: Array) -> None:
        type(self).aligned_n += 1

    def resume(self, q_follower: Array) -> None:
        type(self).resumed.append(np.array(q_follower))

    def read(self, now_s: float) -> LeaderSample | None:
        q = HOME + type(self).offset
        q[[1, 8]] += 0.1 * np.sin(np.pi * now_s) ** 2
        return LeaderSample(np.ones(2), q=q, pressed=type(self).pressing(now_s))


class Recorder(Station):
    """Remembers what was shown."""

    def __init__(self) -> None:
        self.shown: list[Status] = []

    def show(self, status: Status) -> None:
        self.shown.append(status)

    @property
    def states(self) -> list[str]:
        """States in order, each once."""
        names: list[str] = []
        for status in self.shown:
            if not names or names[-1] != status.state:
                names.append(status.state)
        return names


@pytest.fixture(autouse=True)
def person() -> Iterator[None]:
    Person.offset = np.zeros(14)
    Person.aligned_n = 0
    Person.resumed = []
    LEADERS.add("person", Person)
    yield
    LEADERS._rows.pop("person")


def presses(*script: tuple[Button, float]) -> None:
    """Press each button once, when the time of the episode has come."""
    waiting = list(script)

    def pressing(now_s: float) -> tuple[Button, ...]:
        if waiting and now_s >= waiting[0][1]:
            return (waiting.pop(0)[0],)
        return ()

    Person.pressing = staticmethod(pressing)  # type: ignore[assignment]


def rig_of(folder: Path, **person: Any) -> tuple[Rig, Recorder]:
    teleop = TeleopConfig.model_validate({"leader": "person", "person": person})
    teleop = teleop.model_copy(update={"cameras": ()})
    rig = Rig(Job(folder, make_task(CONFIG), teleop, CONFIG.arbiter, 1), cameras=())
    station = Recorder()
    rig.station = station
    return rig, station


def test_an_episode_begins_at_start_stands_still_in_a_pause_and_ends_with_success(
    tmp_path: Path,
) -> None:
    start, pause, success = Button.START, Button.PAUSE, Button.SUCCESS
    presses((start, 0.0), (pause, 1.0), (pause, 1.0), (success, 1.6))
    rig, station = rig_of(tmp_path)
    attempt = rig.record(0)
    rig.close()
    assert station.states == ["press start", "leading", "paused", "leading"] or (
        station.states == ["leading", "paused", "leading"]
    )
    left = [one.time_left_s for one in station.shown if one.time_left_s is not None]
    assert left[0] == pytest.approx(120.0)
    assert np.diff(left).max() <= 0.0
    assert not attempt.kept
    assert attempt.path is not None
    assert attempt.path.parent.name == "rejected"
    assert not attempt.reason.startswith("the leader")
    assert rig.world.time == pytest.approx(1.6, abs=0.4), "time stood still in the pause"


def test_after_a_pause_the_leader_leads_on_from_where_the_arms_are(tmp_path: Path) -> None:
    presses((Button.START, 0.0), (Button.PAUSE, 0.5), (Button.PAUSE, 0.5), (Button.SUCCESS, 0.6))
    rig, _ = rig_of(tmp_path)
    rig.record(0)
    rig.close()
    assert len(Person.resumed) == 1
    swayed_rad = 0.1 * np.sin(0.5 * np.pi) ** 2
    assert Person.resumed[0][1] - HOME[1] == pytest.approx(swayed_rad, abs=0.02)


def test_what_became_of_an_episode_is_shown_until_the_next_one_begins(tmp_path: Path) -> None:
    rig, station = rig_of(tmp_path)
    presses((Button.START, 0.0), (Button.FAILURE, 0.5))
    rig.record(0)
    assert {status.last for status in station.shown} == {""}
    station.shown.clear()
    waits = Button.CORRECT  # does nothing before the start
    presses((waits, 0.0), (Button.START, 0.0), (Button.FAILURE, 0.5))
    rig.record(1)
    rig.close()
    told = {status.state: status.last for status in station.shown}
    assert told["press start"].startswith("trial 0 was rejected: called a failure by who led it")
    assert told["leading"] == ""


def test_failure_is_kept_apart_with_its_reason(tmp_path: Path) -> None:
    presses((Button.START, 0.0), (Button.FAILURE, 1.5))
    rig, _ = rig_of(tmp_path)
    attempt = rig.record(0)
    rig.close()
    assert attempt.reason.startswith("called a failure by who led it")
    assert attempt.path is not None
    assert attempt.path.exists()


def test_discard_records_the_same_start_again_and_next_leaves_no_file(tmp_path: Path) -> None:
    start = Button.START
    presses((start, 0.0), (Button.DISCARD, 0.3), (start, 0.0), (Button.NEXT, 0.3))
    rig, _ = rig_of(tmp_path)
    attempt = rig.record(0)
    rig.close()
    assert Person.aligned_n == 2
    assert attempt.reason == "thrown away by who led it"
    assert attempt.path is None
    assert not list(tmp_path.glob("*/*.hdf5"))
    assert len(list(tmp_path.glob("attempts/*.json"))) == 1


def test_success_at_once_is_a_rejected_attempt_and_no_error(tmp_path: Path) -> None:
    presses((Button.START, 0.0), (Button.SUCCESS, 0.0))
    rig, _ = rig_of(tmp_path)
    attempt = rig.record(0)
    rig.close()
    assert not attempt.kept
    assert attempt.path is None


def test_the_arms_wait_for_a_leader_that_stands_elsewhere_and_name_the_joint(
    tmp_path: Path,
) -> None:
    presses((Button.START, 0.0))
    Person.offset = 0.5 * np.eye(14)[3]
    rig, station = rig_of(tmp_path, wait_max_s=0.5)
    with pytest.raises(UsageError, match=r"still apart after 0.5 s: left_panda_joint4 is \+0.50"):
        rig.record(0)
    assert rig.world.time == 0.0
    assert "left_panda_joint4" in station.shown[-1].held
    rig.close()


def test_a_whole_turn_off_is_no_reason_to_wait(tmp_path: Path) -> None:
    presses((Button.START, 0.0), (Button.FAILURE, 0.3))
    Person.offset = 2.0 * np.pi * np.eye(14)[6]
    rig, _ = rig_of(tmp_path, wait_max_s=5.0)
    attempt = rig.record(0)
    rig.close()
    assert attempt.reason.startswith("called a failure")


def test_nobody_there_is_told_after_the_longest_wait(tmp_path: Path) -> None:
    presses()
    rig, _ = rig_of(tmp_path, wait_max_s=0.2)
    with pytest.raises(UsageError, match=r"nobody pressed start after 0.2 s"):
        rig.record(0)
    rig.close()


def test_without_a_wait_an_episode_begins_at_once(tmp_path: Path) -> None:
    presses((Button.NEXT, 0.2))
    rig, station = rig_of(tmp_path, wait_for_start=False)
    rig.record(0)
    rig.close()
    assert station.states[-1] == "leading"


def test_the_time_of_a_person_is_their_own() -> None:
    task = make_task(CONFIG)
    assert for_a_person(task, 300.0).time_limit_s == 300.0
    assert task.time_limit_s == CONFIG.scene.task.time_limit_s


def test_a_person_makes_as_many_attempts_as_they_like(tmp_path: Path) -> None:
    rig, _ = rig_of(tmp_path)
    assert recording._attempts_max(rig.job) > 10**6
    rig.close()
    rig, _ = rig_of(tmp_path, attempts_max=3)
    assert recording._attempts_max(rig.job) == 3
    rig.close()


def test_lines_tell_what_changes_and_how_much_time_is_left() -> None:
    said: list[str] = []
    station = LineStation(said.append)
    station.show(Status("press start"))
    station.show(Status("press start"))
    station.show(Status("leading", 61.0, "left hand"))
    for left_s in (60.0, 59.98, 30.0, 10.0):
        station.show(Status("leading", left_s, "left hand"))
    time.sleep(0.6)
    station.show(Status("leading", 9.0, "left hand", "the clutch is held"))
    assert said == [
        "press start",
        "leading; left hand",
        "60 s left",
        "30 s left",
        "10 s left",
        "leading; left hand; the arms hold: the clutch is held",
    ]
