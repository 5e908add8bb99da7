"""Two simulated arms as one robot of named joints: time passes with each action."""

import logging
import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from minidual.api.settings import configured
from minidual.demos.job import PURPOSE
from minidual.environments.task_env import CONTROL_HZ, Observation, TaskEnv
from minidual.errors import UsageError, unknown_name
from minidual.plant.render import Image
from minidual.plugin_parts.link import announce, withdraw
from minidual.plugin_parts.names import camera_name, check_views, position_names
from minidual.plugin_parts.rate import RateWatch
from minidual.robot.pair import GRIPPERS_N, Array, robot_from
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Trial

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ArmsSettings:
    """The simulated arms of a plug-in.

    Attributes:
        task: Row of TASKS.
        views: Cameras that are drawn, out of high, left, right.
        rate_hz: Of actions: each lets 1 / rate_hz of simulated time pass.
        start: Number of the first start.
        seed: Of the starts; None: that of the profiles.
        episode_time_s: Wall time after which the next start begins; None: only when a leader asks.
    """

    task: str = "rod_carry"
    views: tuple[str, ...] = ("high",)
    rate_hz: float = CONTROL_HZ
    start: int = 0
    seed: int | None = None
    episode_time_s: float | None = None


class SimulatedArms:
    """Both arms of a task, driven by joint targets.

    Starts are those of `minidual teleop-record`: start k is that of its episode k.

    Attributes:
        config: Of the task.
        rate_hz: Of actions.
        names: Of joints and grippers.
        cameras: {camera: (height, width, 3)}.
        trial: Of the present start.

    Raises:
        UsageError: Unknown task or camera, or a value out of bounds.
    """

    def __init__(self, settings: ArmsSettings) -> None:
        self.config = configured(settings.task)
        self.rate_hz = settings.rate_hz
        if settings.start < 0:
            raise UsageError(f"start is {settings.start}; it must be 0 or more")
        self._settings = settings
        self._task = make_task(self.config)
        self._views = check_views(settings.views)
        robot = robot_from(self.config.robot)
        self.names = position_names(robot)
        camera = self._task.scene.camera
        self.cameras = {
            camera_name(view): (camera.height_px, camera.width_px, 3) for view in self._views
        }
        self._env: TaskEnv | None = None
        self._watch = RateWatch(settings.rate_hz, "--robot.fps")
        self._index = settings.start
        self.trial = self._draw()
        self._began_s: float | None = None
        self._time_s = 0.0
        self._success = False
        announce(self)

    @property
    def time_s(self) -> float:
        """Simulated time since the start."""
        return self._time_s

    @property
    def q(self) -> Array:
        """Measured joints (n,) [rad]."""
        return self._state[:-GRIPPERS_N].astype(float)

    @property
    def openings(self) -> Array:
        """Of the hands (2,), 0 closed to 1 open."""
        return self._state[-GRIPPERS_N:].astype(float)

    @property
    def is_connected(self) -> bool:
        """Whether the simulation runs."""
        return self._env is not None

    @property
    def verdict(self) -> str:
        """The present start, and whether the task's test is passed."""
        result = "success" if self._success else "no success"
        return f"{self._task.name}, start {self._index}: {result} after {self._time_s:.1f} s"

    def connect(self) -> None:
        """Build the simulation, and put it to the first start."""
        self._env = TaskEnv(
            None,
            task=self._task.name,
            images=self._views,
            rate_hz=self.rate_hz,
        )
        announce(self)
        self._begin()

    def observe(self) -> dict[str, float | Image]:
        """Return the measured positions by name, and the pictures (H, W, 3) by camera."""
        self._begin_next_if_due()
        observed: dict[str, float | Image] = dict(self._by_name(self._state))
        for view in self._views:
            observed[camera_name(view)] = self._observation["images"][view]
        return observed

    def act(self, action: Mapping[str, float]) -> dict[str, float]:
        """Drive one period towards targets by name; return those that were sent, within limits.

        What is not named keeps its last target.

        Raises:
            UsageError: A name that is no joint or gripper, or a value that is not finite.
        """
        env = self._connected()
        for name in action:
            if name not in self.names:
                raise unknown_name("joint or gripper", name, self.names)
        for place, name in enumerate(self.names):
            if name in action:
                self._target[place] = float(action[name])
        observation, _, _, _, info = env.step(self._target)
        self._observation = observation
        self._time_s = info["time_s"]
        self._success = info["success"]
        complaint = self._watch.note(time.monotonic())
        if complaint:
            _log.warning(complaint)
        sent = np.clip(self._target, env.action_space.low, env.action_space.high)  # type: ignore[attr-defined]
        return self._by_name(sent)

    def next_start(self) -> None:
        """Put the scene to its next start."""
        _log.info(self.verdict)
        self._index += 1
        self._begin()

    def close(self) -> None:
        """Say how the last start ended, and free the simulation."""
        if self._env is not None:
            _log.info(self.verdict)
            self._env.close()
            self._env = None
        withdraw(self)

    def _connected(self) -> TaskEnv:
        if self._env is None:
            raise UsageError("the arms are not connected", remedy="call connect() first")
        return self._env

    def _draw(self) -> Trial:
        seed = self.config.seed if self._settings.seed is None else self._settings.seed
        return self._task.trial(seed, PURPOSE, self._index, widen=self.config.teleop.widen)

    def _begin(self) -> None:
        self.trial = self._draw()
        self._observation: Observation
        self._observation, _ = self._connected().reset(options={"trial": self.trial})
        # Hands begin open, and the arms where they stand.
        self._target: npt.NDArray[np.float32] = self._observation["state"].copy()
        self._target[-GRIPPERS_N:] = 1.0
        self._time_s = 0.0
        self._success = False
        self._began_s = None

    def _begin_next_if_due(self) -> None:
        now_s = time.monotonic()
        limit_s = self._settings.episode_time_s
        if self._began_s is None:
            self._began_s = now_s
        elif limit_s is not None and now_s - self._began_s >= limit_s:
            self.next_start()
            self._began_s = now_s

    @property
    def _state(self) -> npt.NDArray[np.float32]:
        self._connected()
        return self._observation["state"]

    def _by_name(self, values: npt.NDArray[np.float32]) -> dict[str, float]:
        return {name: float(value) for name, value in zip(self.names, values, strict=True)}
