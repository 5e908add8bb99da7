"""A task as an environment with the names that `lerobot-eval` asks for."""

import math
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from minidual.api.settings import Settings, configured
from minidual.environments.task_env import CONTROL_HZ, Observation, TaskEnv
from minidual.plant.render import Image
from minidual.plugin_parts.names import camera_name, check_views
from minidual.tasks.catalogue import make_task


class EvaluatedTask(gymnasium.Env[Observation, npt.NDArray[np.float32]]):
    """One task.

    Observation: `agent_pos` (n + 2,) float32, joints [rad] and openings; `pixels`, {camera: (H, W, 3)
    uint8}. Action: as `agent_pos`. `info` has `is_success` and `time_s`.

    Attributes:
        task: Name of the task.
        task_description: Its instruction.
        metadata: With `render_fps`, the rate of actions.

    Args:
        task: Row of TASKS.
        views: Cameras, out of high, left, right.
        rate_hz: Of actions.
        settings: {dotted path: value} of the scene, such as {"scene.camera.width_px": 160}.

    Raises:
        UsageError: Unknown task, camera or setting.
    """

    def __init__(
        self,
        task: str = "rod_carry",
        *,
        views: Sequence[str] = ("high",),
        rate_hz: float = CONTROL_HZ,
        settings: Settings | None = None,
    ) -> None:
        self._views = check_views(tuple(views))
        scene = configured(task, settings).scene if settings else None
        self._inner = TaskEnv(
            scene,
            task=task,
            images=self._views,
            render_mode="rgb_array",
            rate_hz=rate_hz,
        )
        described = make_task(configured(task, settings))
        self.task = task
        self.task_description = described.instruction
        self._max_episode_steps = math.ceil(described.time_limit_s * rate_hz - 1e-9)
        self.render_mode = "rgb_array"
        self.metadata = dict(self._inner.metadata)
        self.action_space = self._inner.action_space
        members = self._inner.observation_space
        assert isinstance(members, spaces.Dict)
        own: dict[str, spaces.Space[Any]] = {"agent_pos": members["state"]}
        if self._views:
            images = members["images"]
            assert isinstance(images, spaces.Dict)
            own["pixels"] = spaces.Dict({camera_name(view): images[view] for view in self._views})
        self.observation_space = spaces.Dict(own)

    def reset(
        self,
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Start a random trial; options of LeRobot have no meaning here."""
        observation, _ = self._inner.reset(seed=seed)
        return self._renamed(observation), {"is_success": False, "time_s": 0.0}

    def step(
        self,
        action: npt.NDArray[np.float32],
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold one action for one period."""
        observation, reward, terminated, truncated, info = self._inner.step(action)
        short = {"is_success": bool(info["success"]), "time_s": float(info["time_s"])}
        return self._renamed(observation), reward, terminated, truncated, short

    def render(self) -> Image | None:  # type: ignore[override]
        """Return the overview picture."""
        return self._inner.render()

    def close(self) -> None:
        """Free the OpenGL contexts."""
        self._inner.close()

    def _renamed(self, observation: Observation) -> Observation:
        renamed: Observation = {"agent_pos": observation["state"]}
        if self._views:
            pictures = observation["images"]
            renamed["pixels"] = {camera_name(view): pictures[view] for view in self._views}
        return renamed
