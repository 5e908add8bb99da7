"""A scripted demonstration of the rod task."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np

from minidual.config.root import Config
from minidual.demos.augment.segments import GOAL, START
from minidual.demos.episode import Episode
from minidual.demos.schema import EpisodeMeta
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA
from minidual.skills.operator import ScriptedOperator
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import placement
from tests.support import data_samples

SEED = 5


@functools.cache
def kinematics() -> Kinematics:
    return Kinematics(DUAL_PANDA)


@functools.cache
def carried() -> Episode:
    """A scripted demonstration of the rod task, as its file would hold it."""
    task = make_task(Config())
    trial = task.trial(SEED, "demonstrations", 0)
    operator = ScriptedOperator(task.scene, kinematics=kinematics())
    demo = operator.plan(trial, seed=SEED)
    extra = {
        START: list(placement(trial.start["rod"])),
        GOAL: list(placement(trial.goal["rod"])),
    }
    meta = EpisodeMeta(50.0, "carry", SEED, (), success=True, extra=extra)
    times = np.arange(len(demo.q)) / 50.0
    return Episode(meta, {}, demo.q, demo.gripper, demo.q, demo.gripper, times)


def write_carry(folder: Path, number: int = 0) -> Path:
    """Write the demonstration as an episode's file."""
    one = carried()
    data = {
        "qpos": one.qpos,
        "action": np.vstack([one.action[1:], one.action[-1:]]),
        "gripper": one.gripper,
        "action_gripper": one.action_gripper,
        "timestamps": one.timestamps,
        "images": {},
    }
    return data_samples.write(
        folder / f"episode_{number:06d}.hdf5",
        data,
        extra=dict(one.meta.extra),
    )
