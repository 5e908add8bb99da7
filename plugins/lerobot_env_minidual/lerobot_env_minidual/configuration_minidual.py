"""Options of `--env.type=minidual`, and the vector environments that `lerobot-eval` runs."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import gymnasium
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs import EnvConfig
from lerobot.envs.utils import FreezeAfterEpisodeEnd
from lerobot.utils.constants import ACTION, OBS_IMAGES, OBS_STATE


def make_task(
    task: str, views: list[str], rate_hz: float, settings: dict[str, Any]
) -> gymnasium.Env:
    """Return one world, which costs nothing once its episode has ended."""
    from minidual.plugin_parts.env import EvaluatedTask

    return FreezeAfterEpisodeEnd(
        EvaluatedTask(task, views=views, rate_hz=rate_hz, settings=settings or None),
    )


@EnvConfig.register_subclass("minidual")
@dataclass
class MinidualEnv(EnvConfig):
    """The tasks of minidual.

    Attributes:
        task: rod_carry, pot_lift, handover, insertion, sort or your own; several by commas, or all.
        fps: Rate of actions: that of the dataset on which the policy was trained.
        views: Cameras: high, left, right.
        settings: Settings of the scene by dotted path, such as {"scene.camera.width_px": 160}.
    """

    task: str | None = "rod_carry"
    fps: int = 50
    views: list[str] = field(default_factory=lambda: ["high"])
    settings: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Declare the features of the tasks, which all have the same."""
        from minidual.plugin_parts.names import camera_name, check_views, position_names
        from minidual.robot.pair import DUAL_PANDA
        from minidual.tasks.catalogue import TASKS

        self.tasks = tuple(TASKS) if self.task == "all" else TASKS.names(self.task or "")
        dim = len(position_names(DUAL_PANDA))
        self.features = {
            ACTION: PolicyFeature(type=FeatureType.ACTION, shape=(dim,)),
            "agent_pos": PolicyFeature(type=FeatureType.STATE, shape=(dim,)),
        }
        self.features_map = {ACTION: ACTION, "agent_pos": OBS_STATE}
        for view in check_views(tuple(self.views)):
            key = f"pixels/{camera_name(view)}"
            shape = self._picture_shape()
            self.features[key] = PolicyFeature(type=FeatureType.VISUAL, shape=shape)
            self.features_map[key] = f"{OBS_IMAGES}.{camera_name(view)}"

    def _picture_shape(self) -> tuple[int, int, int]:
        """Return the shape of a picture, which all tasks must have."""
        from minidual.api.settings import configured
        from minidual.errors import UsageError
        from minidual.tasks.catalogue import make_task

        shapes: dict[str, tuple[int, int, int]] = {}
        for task in self.tasks:
            camera = make_task(configured(task, self.settings)).scene.camera
            shapes[task] = (camera.height_px, camera.width_px, 3)
        if len(set(shapes.values())) > 1:
            sizes = ", ".join(f"{task} {w} x {h}" for task, (h, w, _) in shapes.items())
            raise UsageError(
                f"the pictures of these tasks have several sizes: {sizes}",
                remedy="""give all of them one: --env.settings='{"scene.camera.width_px": 192}'""",
            )
        return next(iter(shapes.values()))

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """`create_envs` makes the environments itself."""
        return {}

    def create_envs(
        self,
        n_envs: int,
        use_async_envs: bool = False,
    ) -> dict[str, dict[int, VectorEnv]]:
        """Return {task: {0: vector environment}}.

        The end of an episode is reported in its own step (`SAME_STEP`). Workers are started by a
        server: OpenGL by EGL does not survive a fork.
        """
        envs: dict[str, dict[int, VectorEnv]] = {}
        for task in self.tasks:
            make = partial(make_task, task, self.views, float(self.fps), self.settings)
            envs[task] = {0: _vector([make] * n_envs, use_async_envs and n_envs > 1)}
        return envs


def _vector(makers: list[Callable[[], gymnasium.Env]], in_processes: bool) -> VectorEnv:
    if in_processes:
        return AsyncVectorEnv(
            makers,
            context="forkserver",
            autoreset_mode=AutoresetMode.SAME_STEP,
        )
    return SyncVectorEnv(makers, autoreset_mode=AutoresetMode.SAME_STEP)
