"""One episode that a program of `examples/` leads through the network leader."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from minidual.config.learning import TeleopConfig
from minidual.config.root import Config
from minidual.demos.episode import Episode, read_episode
from minidual.demos.rig import Job, Rig
from minidual.tasks.catalogue import make_task

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def episode_led_by(example: str, folder: Path, network: dict[str, Any]) -> Episode:
    """Run a program for two seconds; return what the file of the episode that it leads holds.

    Args:
        example: Name of the program.
        folder: Of the recording.
        network: Settings of `teleop.network`.
    """
    words = [sys.executable, str(EXAMPLES / example), str(network["port"]), "2"]
    teleop = TeleopConfig.model_validate({"leader": "network", "network": network})
    teleop = teleop.model_copy(update={"cameras": ()})
    config = Config()
    rig = Rig(Job(folder, make_task(config), teleop, config.arbiter, 1), cameras=())
    rig._connected()  # a program that connects to a WebSocket needs somebody who listens
    program = subprocess.Popen(words, cwd=folder)
    try:
        attempt = rig.record(0)
        rig.close()
        assert program.wait(20.0) == 0
    finally:
        program.kill()
        program.wait()
    assert attempt.path is not None, attempt.reason
    return read_episode(attempt.path, cameras=())


def assert_both_arms_moved(episode: Episode) -> None:
    """Check that both arms moved, and that the hands closed."""
    moved = np.ptp(episode.qpos, axis=0)
    assert min(moved[1], moved[8]) > 0.05
    assert episode.gripper[-1].max() < episode.gripper[0].min()
