"""The lesson of insertion with its own trials: they branch where the policy takes over."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.config.root import Config
from minidual.policies.rl.lesson import WorldsWanted
from minidual.trials.lessons.insertion import InsertionLesson
from minidual.trials.lessons.mating_pilot import BEGINS_M
from tests.support.mating_trunks import TERMS

pytestmark = pytest.mark.slow


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


@pytest.mark.torch
def test_it_is_trained_by_command(tmp_path: Path) -> None:
    """A few hundred actions: demonstrations by the rule, cloning, one update, a fresh trial."""
    settings = {
        "steps": 64,
        "worlds_n": 4,
        "rollout": 32,
        "demonstrations_n": 2,
        "clone_steps": 20,
        "validation_starts": 2,
        "value_warmup": 0,
    }
    command = [sys.executable, "-m", "minidual.cli", "train", "rl", "--task", "insertion"]
    words = [*command, "--trials", "1", "--runs-dir", str(tmp_path)]
    for name, value in settings.items():
        words += ["--set", f"methods.rl.{name}={value}"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "standard" / "train" / "rl" / "insertion"
    record = json.loads((folder / "training.json").read_text())
    assert record["steps"] >= 64
    assert record["demonstrated_actions"] > 20
    assert record["success"]["clean"]["trials"] == 1
    described = json.loads((folder / "checkpoint" / "config.json").read_text())
    assert described["task"] == "insertion"
    assert described["observation"] == list(TERMS)
    assert "planner + learned insertion" in done.stdout
