"""One episode that a person's device leads, recorded as `teleop-record` does, without its gate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from minidual.config.learning import TeleopConfig
from minidual.config.root import Config
from minidual.demos.episode import Episode, read_episode
from minidual.demos.rig import Job, Rig
from minidual.demos.station import Button, Station, Status
from minidual.robot.kinematics import Kinematics
from minidual.tasks.catalogue import make_task


class Clock(Station):
    """Tells the simulated time since the episode began, however busy the machine is.

    Attributes:
        time_s: NaN before it begins.
    """

    def __init__(self) -> None:
        self.time_s = math.nan
        self._left_at_first_s = math.nan

    def show(self, status: Status) -> None:
        """Take the time that is left."""
        if status.time_left_s is None:
            return
        if math.isnan(self._left_at_first_s):
            self._left_at_first_s = status.time_left_s
        self.time_s = self._left_at_first_s - status.time_left_s


class TimedStation(Clock):
    """Presses start at once, and success so long after the episode has begun."""

    def __init__(self, leads_s: float) -> None:
        super().__init__()
        self._leads_s = leads_s
        self._started = False

    def pressed(self) -> tuple[Button, ...]:
        """Return the button whose time has come."""
        if not self._started:
            self._started = True
            return (Button.START,)
        return (Button.SUCCESS,) if self.time_s >= self._leads_s else ()


def lead_episode(folder: Path, settings: dict[str, Any], station: Station) -> Episode:
    """Record one attempt with the settings of `teleop`; return what its file holds."""
    config = Config()
    teleop = TeleopConfig.model_validate(settings).model_copy(update={"cameras": ()})
    rig = Rig(Job(folder, make_task(config), teleop, config.arbiter, 1), cameras=())
    rig.station = station
    attempt = rig.record(0)
    rig.close()
    assert attempt.path is not None, attempt.reason
    return read_episode(attempt.path, cameras=())


def hands_moved(episode: Episode) -> Sequence[Any]:
    """Return how far each hand came (3,) from first to last tick, world axes [m]."""
    kinematics = Kinematics()
    first = [T[:3, 3].copy() for T in kinematics.tcp_poses(episode.qpos[0])]
    last = [T[:3, 3].copy() for T in kinematics.tcp_poses(episode.qpos[-1])]
    return [after - before for before, after in zip(first, last, strict=True)]
