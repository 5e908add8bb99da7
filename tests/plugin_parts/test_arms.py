"""Two simulated arms as one robot of named joints, and what tells its loop's rate."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator

import numpy as np
import pytest

from minidual.demos.job import PURPOSE
from minidual.errors import UsageError
from minidual.plugin_parts import link
from minidual.plugin_parts.arms import ArmsSettings, SimulatedArms
from minidual.plugin_parts.names import camera_name, check_views, position_names
from minidual.plugin_parts.rate import RateWatch
from minidual.robot.pair import DUAL_PANDA

JOINT = "left_panda_joint1.pos"


@pytest.fixture
def arms() -> Iterator[SimulatedArms]:
    made = SimulatedArms(ArmsSettings(views=()))
    made.connect()
    yield made
    made.close()


def test_names_are_sides_joints_then_grippers() -> None:
    names = position_names(DUAL_PANDA)
    assert names[0] == JOINT
    assert names[7] == "right_panda_joint1.pos"
    assert names[-2:] == ("left_gripper.pos", "right_gripper.pos")
    assert len(names) == 16


def test_views_are_cameras_named_as_in_our_datasets() -> None:
    arms = SimulatedArms(ArmsSettings(views=("high", "left")))
    assert arms.cameras == {"cam_high": (96, 128, 3), "cam_left": (96, 128, 3)}
    assert camera_name("right") == "cam_right"
    with pytest.raises(UsageError, match="no camera 'top'; there are high, left, right"):
        check_views(("top",))
    with pytest.raises(UsageError, match="views repeat: high, high"):
        check_views(("high", "high"))


def test_an_action_lets_one_period_pass_and_moves_what_it_names(arms: SimulatedArms) -> None:
    before = arms.observe()
    for _ in range(25):
        sent = arms.act({JOINT: before[JOINT] + 0.1})
    after = arms.observe()
    assert arms.time_s == pytest.approx(0.5)
    assert sent[JOINT] == pytest.approx(before[JOINT] + 0.1)
    assert after[JOINT] == pytest.approx(before[JOINT] + 0.1, abs=0.01)
    still = "right_panda_joint4.pos"
    assert after[still] == pytest.approx(before[still], abs=0.01)


def test_targets_beyond_a_limit_are_sent_at_the_limit(arms: SimulatedArms) -> None:
    sent = arms.act({JOINT: 100.0})
    assert sent[JOINT] == pytest.approx(DUAL_PANDA.q_upper[0])


def test_names_and_values_that_are_none_are_refused(arms: SimulatedArms) -> None:
    with pytest.raises(UsageError, match=r"no joint or gripper 'left_joint1\.pos'"):
        arms.act({"left_joint1.pos": 0.0})
    with pytest.raises(UsageError, match="finite numbers"):
        arms.act({JOINT: math.nan})


def test_arms_that_are_not_connected_say_so() -> None:
    arms = SimulatedArms(ArmsSettings(views=()))
    assert not arms.is_connected
    with pytest.raises(UsageError, match="not connected"):
        arms.act({})


def test_starts_are_those_of_recordings_and_follow_each_other(
    arms: SimulatedArms,
    caplog: pytest.LogCaptureFixture,
) -> None:
    assert (arms.trial.purpose, arms.trial.index) == (PURPOSE, 0)
    arms.act({})
    with caplog.at_level(logging.INFO):
        arms.next_start()
    assert "rod_carry, start 0: no success after 0.0 s" in caplog.text
    assert arms.trial.index == 1
    assert arms.time_s == 0.0
    assert float(arms.openings.min()) > 0.9


def test_the_next_start_begins_when_the_time_of_an_episode_is_over() -> None:
    arms = SimulatedArms(ArmsSettings(views=(), start=4, episode_time_s=0.0))
    arms.connect()
    try:
        arms.observe()
        assert arms.trial.index == 4
        arms.observe()
        assert arms.trial.index == 5
    finally:
        arms.close()


def test_a_leader_finds_the_arms_of_its_process_until_they_are_closed() -> None:
    arms = SimulatedArms(ArmsSettings(views=()))
    assert link.present_arms() is arms
    arms.connect()
    arms.close()
    assert link.present_arms() is None


def test_a_start_below_zero_is_refused() -> None:
    with pytest.raises(UsageError, match="start is -1"):
        SimulatedArms(ArmsSettings(start=-1))


@pytest.mark.parametrize(
    ("period_s", "complaint"),
    [(0.02, ""), (1 / 30, "runs at 30 Hz"), (0.01, "simulated time runs fast")],
)
def test_a_loop_of_another_rate_is_told_once(period_s: float, complaint: str) -> None:
    watch = RateWatch(50.0, "--robot.fps")
    told = [watch.note(k * period_s) for k in range(200)]
    texts = [text for text in told if text]
    assert len(texts) == bool(complaint)
    assert complaint in "".join(texts)


def test_a_rate_that_is_no_whole_number_of_steps_keeps_its_time() -> None:
    arms = SimulatedArms(ArmsSettings(views=(), rate_hz=30.0))
    arms.connect()
    try:
        for _ in range(30):
            arms.act({})
        assert arms.time_s == pytest.approx(1.0, abs=0.0011)
    finally:
        arms.close()
    assert np.isclose(arms.rate_hz, 30.0)
