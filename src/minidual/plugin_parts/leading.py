"""A leader of minidual, read as a dictionary of named joint targets."""

import logging
import time
from dataclasses import dataclass, field

import numpy as np

from minidual.api.settings import Settings, configured
from minidual.config.root import Config
from minidual.demos.leader import LEADERS, Feedback, Leader, LeaderSetup
from minidual.demos.mirror import Mirror
from minidual.demos.station import Button
from minidual.environments.task_env import CONTROL_HZ
from minidual.errors import UsageError
from minidual.plugin_parts.link import LedArms, present_arms
from minidual.plugin_parts.names import position_names
from minidual.robot.pair import robot_from
from minidual.tasks.catalogue import make_task

_log = logging.getLogger(__name__)
_ENDS = (Button.SUCCESS, Button.FAILURE, Button.DISCARD, Button.NEXT)
"""Buttons by which a person ends an episode: the scene goes to its next start."""
_TOLD_EVERY_S = 5.0


@dataclass(frozen=True)
class LeadSettings:
    """Who leads.

    Attributes:
        leader: Row of LEADERS.
        task: Row of TASKS, for arms of other processes; simulated arms bring their own.
        settings: {dotted path: value} of the configuration, such as {"teleop.network.port": 8765}.
    """

    leader: str = "scripted"
    task: str = "rod_carry"
    settings: Settings = field(default_factory=dict)


class Lead:
    """Reads a leader for the simulated arms of this process, or for others that stand at home."""

    def __init__(self, settings: LeadSettings) -> None:
        self._settings = settings
        self._config = configured(settings.task, self._overrides())
        features = LEADERS[settings.leader].features
        if features.picture:
            raise UsageError(
                f"the leader '{settings.leader}' needs minidual's own view, which LeRobot has not",
                remedy=f"minidual teleop-record --set teleop.leader={settings.leader}",
            )
        self._is_person = features.realtime
        self.names = position_names(robot_from(self._config.robot))
        self._leader: Leader | None = None
        self._led: tuple[str, int] | None = None
        """Purpose and index of the trial that it leads."""
        self._told_s = float("-inf")

    @property
    def is_connected(self) -> bool:
        """Whether the device is."""
        return self._leader is not None

    def connect(self) -> None:
        """Connect the device.

        Raises:
            EnvironmentMissingError: It, or the library that reads it, is missing.
        """
        arms = present_arms()
        config = self._config
        rate_hz = float(CONTROL_HZ)
        if arms is not None:
            config = self._config_of(arms)
            rate_hz = arms.rate_hz
        # The rate of a recording has bounds that those of LeRobot need not keep.
        teleop = config.teleop.model_copy(update={"rate_hz": rate_hz})
        robot = robot_from(config.robot)
        setup = LeaderSetup(robot, make_task(config), teleop, config.seed)
        self._leader = LEADERS[self._settings.leader].connect(setup)
        self._mirror = Mirror(self._leader, robot, teleop)
        self._home = robot.home
        self._trial_at_home = setup.task.trial(config.seed, "home", 0)
        self._led = None

    def action(self) -> dict[str, float]:
        """Return the newest targets by name; without a reading the last ones.

        Raises:
            UsageError: The leader is not connected, or begins elsewhere than the arms.
        """
        leader = self._leader
        if leader is None:
            raise UsageError("the leader is not connected", remedy="call connect() first")
        arms = present_arms()
        self._align_if_new(leader, arms)
        if arms is not None:
            self._feed_back(leader, arms)
        reading = self._mirror.read(self._now_s(arms))
        if reading is not None:
            self._target = np.concatenate([reading.target, reading.openings])
            self._tell_why_held()
            has_ended = any(button in _ENDS for button in reading.pressed)
            if arms is not None and self._is_person and has_ended:
                arms.next_start()
                self._align_if_new(leader, arms)
        return {name: float(value) for name, value in zip(self.names, self._target, strict=True)}

    def close(self) -> None:
        """Release the device."""
        if self._leader is not None:
            self._leader.close()
            self._leader = None

    def _overrides(self) -> dict[str, object]:
        return {"teleop.leader": self._settings.leader, **self._settings.settings}

    def _config_of(self, arms: LedArms) -> Config:
        config = configured(arms.config.task, self._overrides())
        if config.robot != arms.config.robot:
            raise UsageError(
                f"the leader is set up for {config.robot.arm}, the arms are {arms.config.robot.arm}",
            )
        return config

    def _align_if_new(self, leader: Leader, arms: LedArms | None) -> None:
        """Prepare the leader for the present trial, unless it leads it already."""
        trial = self._trial_at_home if arms is None else arms.trial
        name = (trial.purpose, trial.index)
        if self._led == name:
            return
        q = np.array(self._home if arms is None else arms.q, dtype=float)
        leader.align(trial, q)
        self._mirror.begin(q)
        self._led = name
        self._began_s = time.monotonic()
        self._target = np.concatenate([q, np.ones(2)])
        if not self._is_person:
            sample = leader.read(0.0)
            if sample is not None:
                self._mirror.check_start(sample)

    def _now_s(self, arms: LedArms | None) -> float:
        return time.monotonic() - self._began_s if arms is None else arms.time_s

    def _feed_back(self, leader: Leader, arms: LedArms) -> None:
        q = np.array(arms.q, dtype=float)
        openings = np.array(arms.openings, dtype=float)
        leader.feedback(Feedback(arms.time_s, q, openings, np.zeros(len(q))))

    def _tell_why_held(self) -> None:
        now_s = time.monotonic()
        if self._mirror.gate.held and now_s - self._told_s > _TOLD_EVERY_S:
            self._told_s = now_s
            _log.warning("the arms hold: %s", self._mirror.gate.held)
