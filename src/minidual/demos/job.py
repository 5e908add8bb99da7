"""The settings of a recording, the same for all of its trials."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from minidual.config.control import ArbiterConfig, SupervisorConfig
from minidual.config.learning import TeleopConfig
from minidual.demos.corrections import DrivingPolicy
from minidual.robot.pair import Robot, robot_from
from minidual.tasks.task import Task, Trial

PURPOSE = "demonstrations"
"""Random stream, not used by tests."""

type Room = tuple[
    str,
    Callable[[mujoco.MjModel, Task, Trial, np.random.Generator], AbstractContextManager[None]],
]
"""Name, and a context that changes what the cameras see of a compiled model, then restores it."""


@dataclass(frozen=True)
class Job:
    """Inputs shared by all trials; they take turns in `rooms`."""

    folder: Path
    task: Task
    teleop: TeleopConfig
    arbiter: ArbiterConfig
    seed: int
    supervisor: SupervisorConfig = field(default_factory=SupervisorConfig)
    rooms: tuple[Room, ...] = ()
    policy: Callable[[], DrivingPolicy] | None = None
    """Loads the policy that drives until the leader takes over; None: the leader drives."""

    @property
    def robot(self) -> Robot:
        """The arms."""
        return robot_from(self.task.config.robot)

    def trial(self, index: int) -> Trial:
        """Return trial `index`."""
        return self.task.trial(self.seed, PURPOSE, index, widen=self.teleop.widen)

    def room(self, trial: Trial, turn: int = 0) -> Room | None:
        """Return a trial's room, None without rooms; `turn` counts changes of room within it."""
        if not self.rooms:
            return None
        return self.rooms[(trial.index + turn) % len(self.rooms)]
