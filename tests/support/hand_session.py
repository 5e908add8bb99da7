"""A session by hand, in a process that may be killed: a person leads episodes, one after the other.

Run as a program it records in the folder that is its argument, and says when a tick of an episode
was recorded.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from minidual.config.learning import TeleopConfig
from minidual.config.root import Config
from minidual.demos import recording
from minidual.demos.leader import LEADERS, Features, Leader, LeaderSample, LeaderSetup
from minidual.demos.rig import Job, Rig
from minidual.demos.station import Button
from minidual.robot.pair import DUAL_PANDA, Array
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Trial

INPUTS = {"seed": 1}
EPISODE_S = 1.3
CONFIG = Config()


class SwayingPerson(Leader):
    """Sways the second joints, and calls each episode a failure after 1.3 s."""

    features: ClassVar[Features] = Features(realtime=True)

    @classmethod
    def connect(cls, setup: LeaderSetup) -> Self:
        return cls()

    def align(self, trial: Trial, q_follower: Array) -> None:
        """Nothing is to be done."""

    def read(self, now_s: float) -> LeaderSample | None:
        q = DUAL_PANDA.home.copy()
        q[[1, 8]] += 0.1 * np.sin(np.pi * now_s) ** 2
        pressed = (Button.FAILURE,) if now_s >= EPISODE_S else ()
        return LeaderSample(np.ones(2), q=q, pressed=pressed)


@contextmanager
def swaying() -> Iterator[None]:
    """Add the person to the table of leaders for a while."""
    LEADERS.add("swaying", SwayingPerson)
    yield
    LEADERS._rows.pop("swaying")


def job_of(folder: Path, attempts_max: int) -> Job:
    """Return a recording without pictures of a person who does not wait for a button."""
    person = {"wait_for_start": False, "attempts_max": attempts_max}
    teleop = TeleopConfig.model_validate({"leader": "swaying", "person": person})
    teleop = teleop.model_copy(update={"cameras": ()})
    return Job(folder, make_task(CONFIG), teleop, CONFIG.arbiter, 1)


def main(folder: Path) -> None:
    """Record until somebody kills this process."""
    lead = Rig.lead

    def talking(rig: Rig, trial: Trial, on_tick):
        def tick(measured):
            on_tick(measured)
            print(trial.index, flush=True)

        return lead(rig, trial, tick)

    Rig.lead = talking
    recording.claim(folder, INPUTS, "old")
    with swaying():
        list(recording.attempts_of(job_of(folder, 100), workers=1))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
