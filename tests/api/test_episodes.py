"""Episodes from Python: recorded by a toy rig, found, opened, measured."""

from __future__ import annotations

from pathlib import Path

import pytest

from minidual.api.episodes import list_episodes, measure_episode, open_episode, record_episodes
from minidual.demos import recording
from minidual.errors import DataError, UsageError
from tests.support.recording_toys import TICKS, ToyRig


def test_episodes_are_recorded_found_opened_and_measured(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(recording, "Rig", ToyRig)
    files = record_episodes(tmp_path, episodes=2)
    assert list_episodes(tmp_path / "episodes") == files
    assert len(files) == 2
    episode = open_episode(files[0])
    assert len(episode) == TICKS
    assert episode.duration_s == pytest.approx((TICKS - 1) / 50.0)
    assert measure_episode(episode).duration_s == pytest.approx(episode.duration_s)


def test_too_few_successes_are_an_error_that_counts_them(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(recording, "Rig", ToyRig)
    settings = {"teleop.attempts_max_ratio": 1.0}
    with pytest.raises(UsageError, match="1 of 2 episodes in 2 attempts"):
        record_episodes(tmp_path, episodes=2, settings=settings)


def test_no_episode_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="episodes is 0"):
        record_episodes(tmp_path, episodes=0)
    with pytest.raises(DataError, match="no episode file"):
        open_episode(tmp_path / "episode_000000.hdf5")
    assert list_episodes(tmp_path) == []
