"""docs/howto-leader.md: its code runs, and a leader from outside the package records an episode."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from minidual.demos.episode import inspect_episode
from minidual.demos.leader import LEADERS
from minidual.demos.recording import usable_workers
from minidual.errors import UsageError
from minidual.robot.pair import DUAL_PANDA
from tests.support import howto


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Any:
    with howto.program("howto-leader.md", LEADERS, tmp_path_factory.mktemp("sway")) as names:
        yield names


def test_what_the_leader_did_is_recorded_and_named(page: dict[str, Any]) -> None:
    attempt = page["attempt"]
    episode = page["episode"]
    assert (attempt.kept, attempt.success) == (False, False)
    assert "lifted" in attempt.reason or "rose" in attempt.reason
    assert attempt.path.parent.name == "rejected"
    assert len(episode) == 100
    swayed = [1, 1 + DUAL_PANDA.dof_per_arm]
    assert np.ptp(episode.qpos[:, swayed], axis=0) == pytest.approx([0.3, 0.3], abs=0.02)
    assert episode.meta.extra["leader"] == "sway"
    assert inspect_episode(attempt.path, cameras=("high",), robot=DUAL_PANDA)[1] == []


def test_the_row_is_refused_twice_and_suggested_for_a_slip(page: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="'sway' is in the table already"):
        LEADERS.add("sway", page["module"].Sway)
    with pytest.raises(UsageError, match=r"(?s)no leader 'swag'.*did you mean 'sway'"):
        LEADERS["swag"]


def test_a_leader_in_real_time_records_in_one_process(
    page: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    job = page["rig"].job
    assert usable_workers(job, 4) == 4
    sway = page["module"].Sway
    monkeypatch.setattr(sway, "features", dataclasses.replace(sway.features, realtime=True))
    assert usable_workers(job, 4) == 1
