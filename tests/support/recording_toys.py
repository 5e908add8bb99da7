"""Recordings without physics: tiny synthetic episodes pass through the real writer, judge, rounds and stage.

Run as a script, it is the `minidual` command with the toy rig, which hangs at the trial HANG_AT of the environment.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from minidual import durable
from minidual.config.root import Config
from minidual.demos import recording
from minidual.demos.rig import Job, Rig
from minidual.demos.session import SessionResult, Tick
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA
from minidual.tasks.catalogue import make_task
from minidual.tasks.judge import Outcome
from minidual.tasks.task import Trial

TICKS = 51
CONFIG = Config()


def job(folder: Path, **teleop: Any) -> Job:
    """Return a job without cameras."""
    settings = CONFIG.teleop.model_copy(update={"cameras": (), **teleop})
    return Job(folder, make_task(CONFIG), settings, CONFIG.arbiter, seed=11)


class ToyRig(Rig):
    """Every fourth trial fails.

    Attributes:
        late_s: Age of the joints when the images are taken.
        behind_s: By which the joints are behind their commands.
    """

    late_s = 0.0
    behind_s = 0.02

    def __init__(self, job: Job, cameras: Sequence[str]) -> None:
        self.job = job
        self.kinematics = Kinematics(job.robot)

    def lead(self, trial: Trial, on_tick: Callable[[Tick], None]) -> SessionResult:
        """Sway the arms a little."""
        if str(trial.index) == os.environ.get("HANG_AT"):
            time.sleep(60.0)
        phase = np.random.default_rng(trial.index).uniform(0.0, 2.0 * np.pi, 14)
        times = np.arange(TICKS) / 50.0
        q = _sway(times, phase)
        action = _sway(times + self.behind_s, phase)
        camera = self.job.task.scene.camera
        pixels = np.random.default_rng(7).integers(
            90,
            110,
            (camera.height_px, camera.width_px, 3),
            dtype=np.uint8,
        )
        for k, t in enumerate(times):
            images = {camera: pixels + np.uint8(k) for camera in self.job.teleop.cameras}
            on_tick(
                Tick(
                    timestamps=t,
                    image_timestamps=t + self.late_s,
                    qpos=q[k],
                    qvel=np.zeros(14),
                    gripper=np.ones(2),
                    images=images,
                    action=action[k],
                    action_gripper=np.ones(2),
                ),
            )
        good = trial.index % 4 != 1
        outcome = Outcome(good, (), times[-1], {"goal_error_m": 1e-3, "tilt_max_rad": 1e-2})
        return SessionResult(q, outcome, [1e-4] * TICKS, ended_by="leader")

    def close(self) -> None:
        """Nothing to free."""


def _sway(times_s: np.ndarray, phase: np.ndarray) -> np.ndarray:
    return DUAL_PANDA.home + 0.05 * np.sin(2.0 * np.pi * 0.5 * times_s[:, None] + phase)


def hang_in_conversion(paths: Iterable[Path], out_dir: Path, *_: Any, **__: Any) -> None:
    """Stand in for `lerobot_adapter.convert`, at the end of the recording."""
    list(paths)
    (durable.partial_path(out_dir) / "data").mkdir(parents=True)
    time.sleep(60.0)


if __name__ == "__main__":
    from minidual.cli.process import main

    recording.Rig = ToyRig  # type: ignore[misc]
    main()
