"""Leaders are found by name."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.config.learning import TeleopConfig
from minidual.config.scene import SceneConfig
from minidual.demos.leader import LEADERS, LeaderSetup
from minidual.errors import UsageError
from minidual.robot.pair import DUAL_PANDA
from tests.support.carry_trials import carry_task, sample_trial

HOME = DUAL_PANDA.home


def test_leaders_are_found_by_name(scene: SceneConfig) -> None:
    setup = LeaderSetup(DUAL_PANDA, carry_task(scene), TeleopConfig(), 1)
    trial = sample_trial(scene, 1, "demonstrations", 0)
    leader = LEADERS["scripted"].for_trial(setup, trial)
    reading = leader.read(0.0)
    assert reading is not None
    np.testing.assert_allclose(reading[0], HOME, atol=1e-6)
    assert not leader.finished(5.0)
    assert leader.finished(8.7)
    with pytest.raises(
        UsageError,
        match=r"(?s)no leader 'keybord'; there are keyboard, scripted.*'keyboard'",
    ):
        LEADERS["keybord"]
    assert sorted(LEADERS) == ["keyboard", "scripted"]
