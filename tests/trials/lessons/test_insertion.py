"""The lesson of insertion: trained on played trials, and on its own, which branch at the mating."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual import emergency
from minidual.config.root import Config, changed
from minidual.policies.rl.lesson import WorldsWanted
from minidual.trials.lessons.insertion import InsertionLesson
from minidual.trials.lessons.mating_pilot import BEGINS_M
from tests.support.late import late
from tests.support.mating_trunks import TERMS, Played, PlayedTrunks

training = late("minidual.policies.rl.training")
SETTINGS = {
    "steps": 128,
    "worlds_n": 4,
    "rollout": 16,
    "hidden": 16,
    "demonstrations_n": 2,
    "clone_steps": 20,
    "validation_starts": 2,
    "validate_every_updates": 1,
}


class PlayedLesson(InsertionLesson):
    """The lesson with trials that are only played."""

    def _trunks_of(self, config: Any) -> Any:
        return PlayedTrunks({index: Played(index % 4 + 2, index % 3 > 0) for index in range(500)})


def job(folder: Path, advance: Any = lambda steps, note: None) -> Any:
    values = {f"methods.rl.{name}": value for name, value in SETTINGS.items()}
    config = changed(Config(task="insertion"), values)
    return training.RlJob(config, PlayedLesson(), 7, folder / "progress", advance)


@pytest.mark.torch
def test_it_is_trained_and_goes_on_after_an_interruption(tmp_path: Path) -> None:
    steps_done = [0]

    def stop(steps: int, note: str) -> None:
        steps_done[0] += steps
        if steps_done[0] >= 384:
            raise emergency.EmergencyStop

    long = job(tmp_path, stop)
    long = long._replace(config=changed(long.config, {"methods.rl.steps": 512}))
    with pytest.raises(emergency.EmergencyStop):
        training.train_rl(long)
    result = training.train_rl(long._replace(advance=lambda steps, note: None))
    assert 0 < result.resumed_from < 512
    assert result.steps >= 512
    assert result.network.description == PlayedLesson().describe(long.config)
    assert result.network.action_size == 5
    assert result.demonstrations_n > 0


@pytest.mark.slow
def test_copies_of_a_trial_go_on_alike_and_apart() -> None:
    """Equal actions give equal observations from one start, to the last bit; others do not."""
    config = Config.model_validate(
        {"task": "insertion", "methods": {"rl": {"episodes_of_start": 50}}},
    )
    lesson = InsertionLesson()
    wanted = WorldsWanted(1, config.seed, "lesson-test", 1.0, once=True)
    runs: list[Any] = []
    for action in (0.0, 0.0, 1.0):
        worlds = lesson.worlds(config, wanted)
        first, _ = worlds.reset()
        rows = [first]
        ended = False
        rewards = 0.0
        while not ended:
            observation, reward, terminated, truncated, _ = worlds.step(
                np.array([[action, 0.0, 0.0, 0.0, 0.0]], np.float32),
            )
            rows.append(observation)
            rewards += float(reward[0])
            ended = bool(terminated[0] or truncated[0])
        worlds.close()
        runs.append((np.array(rows), rewards))
    (same, earned), (again, earned_again), (other, _) = runs
    assert np.array_equal(same, again)
    assert earned == earned_again
    assert np.array_equal(same[0], other[0])
    assert not np.array_equal(same[: len(other)], other[: len(same)])
    assert same[0][0, 1] * 0.030 == pytest.approx(-BEGINS_M, abs=0.02)
    assert np.isfinite(same).all()
    assert len(TERMS) > 0


@pytest.mark.slow
@pytest.mark.torch
def test_it_is_trained_by_command(tmp_path: Path) -> None:
    """A few hundred actions: demonstrations by the rule, cloning, one update, a fresh trial."""
    command = [sys.executable, "-m", "minidual.cli", "train", "rl", "--task", "insertion"]
    words = [*command, "--trials", "1", "--runs-dir", str(tmp_path)]
    for name, value in SETTINGS.items():
        words += ["--set", f"methods.rl.{name}={value}"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "standard" / "train" / "rl" / "insertion"
    record = json.loads((folder / "training.json").read_text())
    assert record["steps"] >= SETTINGS["steps"]
    assert record["demonstrated_actions"] > 20
    assert record["success"]["clean"]["trials"] == 1
    described = json.loads((folder / "checkpoint" / "config.json").read_text())
    assert described["task"] == "insertion"
    assert described["observation"] == list(TERMS)
    assert "planner + learned insertion" in done.stdout
