"""Leaders: whoever leads the arms by giving joint angles, and the table of those that exist."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from minidual.config.scene import SceneConfig
from minidual.config.teleop import TeleopConfig
from minidual.errors import unknown_name
from minidual.robot.constants import Array
from minidual.robot.kinematics import Kinematics
from minidual.skills.operator import Demonstration, ScriptedOperator
from minidual.tasks.task import Trial


class Leader(Protocol):
    """Gives the posture that the follower is to take.

    realtime: whether the leader lives in real time (a person, a device), so that the simulation must not run
    ahead of the wall clock.
    """

    realtime: bool

    def read(self, now_s: float) -> tuple[Array, Array] | None:
        """Return joint angles (14,) [rad] and openings (2,) at a time since the start [s]; None if it has none."""
        ...

    def finished(self, now_s: float) -> bool:
        """Return whether the leader has ended the episode."""
        ...

    def close(self) -> None:
        """Give back what the leader holds (a device, a terminal)."""
        ...


class ScriptedLeader:
    """Stands in for a person's hands: plays what the scripted operator planned for one trial."""

    realtime = False

    def __init__(self, demonstration: Demonstration) -> None:
        self.demonstration = demonstration

    def read(self, now_s: float) -> tuple[Array, Array] | None:
        """Return the planned joint angles and openings."""
        return self.demonstration.at(now_s)

    def finished(self, now_s: float) -> bool:
        """Return whether the plan has been played to its end."""
        return now_s >= self.demonstration.duration_s - 0.5 / self.demonstration.rate_hz

    def close(self) -> None:
        """Nothing is held."""


@dataclass(frozen=True)
class LeaderSetup:
    """What a leader may be made from; `operator` is shared between the trials of one process."""

    scene: SceneConfig
    config: TeleopConfig
    seed: int
    operator: ScriptedOperator


def _scripted(setup: LeaderSetup, trial: Trial) -> Leader:
    demonstration = setup.operator.plan(trial, seed=setup.seed, rate_hz=setup.config.rate_hz)
    return ScriptedLeader(demonstration)


def _keyboard(setup: LeaderSetup, trial: Trial) -> Leader:
    from minidual.demos.keyboard import KeyboardLeader

    return KeyboardLeader(Kinematics())


LEADERS = {"scripted": _scripted, "keyboard": _keyboard}
"""Name to maker. Registering is adding a line: makers are called with a `LeaderSetup` and the trial."""

IN_PROCESS: frozenset[str] = frozenset({"keyboard"})
"""Leaders that need this process's terminal, and so cannot be spread over workers."""


def require_leader(name: str) -> str:
    """Return the name if there is such a leader; UsageError with the closest one otherwise."""
    if name not in LEADERS:
        raise unknown_name("leader", name, LEADERS)
    return name


def make_leader(name: str, setup: LeaderSetup, trial: Trial) -> Leader:
    """Return a leader for one trial.

    Raises:
        UsageError: There is no such leader.
        EnvironmentMissingError: What it needs (a terminal, a device) is not there.
    """
    return LEADERS[require_leader(name)](setup, trial)
