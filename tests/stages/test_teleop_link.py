"""A real recording over a late network: an episode is kept, and what the link did is recorded and plotted."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from minidual.config.root import Config, changed
from minidual.demos.attempt import AttemptFiles
from minidual.demos.episode import read_episode
from minidual.gate.stage import StageContext
from minidual.stages import teleop_record

NETWORK = "delay=100ms,jitter=20ms,loss=1%"
pytestmark = [pytest.mark.slow, pytest.mark.torch, pytest.mark.timeout(1200)]


def test_a_demonstration_over_a_late_network_is_kept_with_what_the_link_did(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(teleop_record, "film_demonstration", lambda *_: None)  # takes a minute
    settings = {
        "scene.camera": {"width_px": 48, "height_px": 32},
        "task": "pot_lift",  # a rod is so light that the observer of contacts takes it for noise
        "teleop.episodes_n": 1,
        "teleop.link.network": NETWORK,
    }
    config = changed(Config(), settings)
    result = teleop_record.run(
        StageContext(folder=tmp_path, config=config, seed=20260, profile="smoke")
    )
    numbers = {check.name: check.observed for check in result.checks}
    assert numbers["episodes"] == 1
    assert numbers["dataset_episodes"] == 1
    link = result.data["link"]
    trial = next(index for index in link if index not in result.data["rejected"])
    assert set(link[trial]) == {
        "link_energy_min_j",
        "link_active_share",
        "link_drift_max",
        "link_drift_end",
    }
    assert link[trial]["link_active_share"] > 0.0
    assert link[trial]["link_energy_min_j"] > config.teleop.link.energy_min_j
    episode = read_episode(tmp_path / "episodes" / f"episode_{int(trial):06d}.hdf5", cameras=())
    assert episode.meta.extra["network"] == NETWORK
    path = AttemptFiles(tmp_path).link_path(int(trial))
    rows = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
    assert len(rows) == len(episode)
    energies = [float(row["left arm arms_j"]) for row in rows]
    assert np.isfinite(energies).all()
    assert min(energies) >= link[trial]["link_energy_min_j"] - 1e-6
    assert "<svg" in (tmp_path / "link.svg").read_text(encoding="utf-8")
