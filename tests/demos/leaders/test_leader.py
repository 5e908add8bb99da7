"""Leaders are found by name."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.config.learning import TeleopConfig
from minidual.config.scene import SceneConfig
from minidual.demos.leader import LEADERS, Leader, LeaderSetup
from minidual.demos.station import Button
from minidual.errors import UsageError
from minidual.robot.pair import DUAL_PANDA
from tests.support.carry_trials import carry_task, sample_trial

HOME = DUAL_PANDA.home
ROWS = (
    "augmented",
    "browser",
    "corrector",
    "gamepad",
    "gello",
    "keyboard",
    "network",
    "replay",
    "scripted",
)


def buttons_at(leader: Leader, now_s: float) -> tuple[Button, ...]:
    sample = leader.read(now_s)
    assert sample is not None
    return sample.pressed


def test_leaders_are_found_by_name(scene: SceneConfig) -> None:
    setup = LeaderSetup(DUAL_PANDA, carry_task(scene), TeleopConfig(), 1)
    trial = sample_trial(scene, 1, "demonstrations", 0)
    leader = LEADERS["scripted"].connect(setup)
    leader.align(trial, HOME)
    first = leader.read(0.0)
    assert first is not None
    assert first.q is not None
    np.testing.assert_allclose(first.q, HOME, atol=1e-6)
    assert buttons_at(leader, 5.0) == ()
    assert buttons_at(leader, 8.7) == (Button.SUCCESS,)
    with pytest.raises(
        UsageError,
        match=r"(?s)no leader 'keybord'; there are augmented, browser, corrector, gamepad.*'keyboard'",
    ):
        LEADERS["keybord"]
    assert sorted(LEADERS) == sorted(ROWS)


def test_what_a_leader_gives_is_known_before_it_is_connected() -> None:
    people = {name for name in ROWS if LEADERS[name].features.realtime}
    assert people == {"browser", "gamepad", "gello", "keyboard", "network"}
    assert {name for name in ROWS if LEADERS[name].features.targets == "poses"} == {
        "browser",
        "gamepad",
    }
    assert all(LEADERS[name].usage for name in people)
