"""The tasks of minidual as a benchmark of vla-eval: what a model server sees, gives and is told."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from vla_eval.benchmarks.base import StepBenchmark, StepResult
from vla_eval.specs import GRIPPER_01, IMAGE_RGB, LANGUAGE, DimSpec
from vla_eval.types import Action, EpisodeResult, Observation, Task

from minidual.plugin_parts.env import EvaluatedTask
from minidual.plugin_parts.names import camera_name, check_views, position_names
from minidual.robot.pair import DUAL_PANDA, SIDES
from minidual.tasks.catalogue import TASKS


class MinidualBenchmark(StepBenchmark):
    """Tasks for two arms, judged by their success tests.

    Observation: `images` {camera: (H, W, 3) uint8}, `states` (n + 2,) float32, `task_description`.
    Action: `actions` (n + 2,), joint targets of the left arm, then the right one [rad], then the
    opening of the left and the right hand, from 0 (closed) to 1. One that is not finite or has
    another shape is refused, not repaired.

    Args:
        tasks: Rows of minidual's tasks; none: all.
        views: Cameras, out of high, left, right.
        rate_hz: Of actions.
        seed: Episode k of a task starts at the draw `seed` + k.
        settings: {dotted path: value} of the scene, such as {"scene.camera.width_px": 160}.

    Raises:
        UsageError: A task, camera or setting does not exist.
    """

    def __init__(
        self,
        tasks: Sequence[str] = (),
        views: Sequence[str] = ("high",),
        rate_hz: float = 50.0,
        seed: int = 0,
        settings: dict[str, Any] | None = None,
    ) -> None:
        super().__init__()
        self._tasks = TASKS.names(tasks) if tasks else tuple(TASKS)
        self._views = check_views(tuple(views))
        self._rate_hz = rate_hz
        self._seed = seed
        self._settings = settings
        self._names = position_names(DUAL_PANDA)
        self._env: EvaluatedTask | None = None

    # What vla-eval asks of a benchmark ---------------------------------------------------------

    def get_tasks(self) -> list[Task]:
        """Return the tasks by name."""
        return [{"name": task, "suite": "minidual"} for task in self._tasks]

    def get_metadata(self) -> dict[str, Any]:
        """Return how long an action is; a task's own time limit ends an episode."""
        return {"action_dim": len(self._names)}

    def get_observation_spec(self) -> dict[str, DimSpec]:
        """Return what a model server gets."""
        state = DimSpec(
            "state",
            len(self._names),
            "joint_positions_then_openings",
            description=", ".join(self._names),
        )
        pictures = {camera_name(view): IMAGE_RGB for view in self._views}
        return {**pictures, "language": LANGUAGE, "state": state}

    def get_action_spec(self) -> dict[str, DimSpec]:
        """Return what a model server gives, in the order of the vector."""
        joints_n = len(DUAL_PANDA.arm.joints)
        arms = {f"{side}_joints": DimSpec("joints", joints_n, "joint_positions") for side in SIDES}
        hands = {f"{side}_gripper": GRIPPER_01 for side in SIDES}
        return {**arms, **hands}

    def get_hold_action(self, last_action: Action | None) -> Action:
        """Return the action of a tick without an answer: joint targets stay where they are."""
        if last_action is None:
            return {"actions": self._last_result.obs["agent_pos"]}
        return last_action

    # An episode --------------------------------------------------------------------------------

    def reset(self, task: Task) -> Any:
        """Begin episode `task["episode_idx"]`."""
        if self._env is None or self._env.task != task["name"]:
            self.cleanup()
            self._env = EvaluatedTask(
                task["name"],
                views=self._views,
                rate_hz=self._rate_hz,
                settings=self._settings,
            )
        observation, _ = self._env.reset(seed=self._seed + int(task.get("episode_idx", 0)))
        return observation

    def step(self, action: Action) -> StepResult:
        """Hold one action for one period.

        Raises:
            ValueError: It has another shape, or is not finite.
        """
        numbers = np.asarray(action.get("actions"), dtype=np.float32)
        if numbers.shape != (len(self._names),) or not np.isfinite(numbers).all():
            raise ValueError(
                f"'actions' are {len(self._names)} finite numbers (joints of both arms [rad], then both "
                f"openings), not {numbers.shape}"
            )
        env = self._running
        observation, reward, terminated, truncated, info = env.step(numbers)
        self._recorder.record_video(observation.get("pixels", {}).get("cam_high"))
        done = terminated or truncated
        self._recorder.record_step(reward=reward, done=done, success=info["is_success"])
        return StepResult(observation, reward, done, info)

    def make_obs(self, raw_obs: Any, task: Task) -> Observation:
        """Return an observation as vla-eval names it."""
        return {
            "images": dict(raw_obs.get("pixels", {})),
            "states": raw_obs["agent_pos"],
            "task_description": self._running.task_description,
        }

    def get_step_result(self, step_result: StepResult) -> EpisodeResult:
        """Return what became of the episode."""
        return {
            "success": bool(step_result.info.get("is_success", False)),
            "time_s": float(step_result.info.get("time_s", 0.0)),
        }

    def get_metric_keys(self) -> dict[str, str]:
        """Return the numbers that are averaged over episodes."""
        return {"success": "mean", "time_s": "mean"}

    def cleanup(self) -> None:
        """Free the simulation."""
        if self._env is not None:
            self._env.close()
            self._env = None

    @property
    def _running(self) -> EvaluatedTask:
        if self._env is None:
            raise RuntimeError("no episode has begun; call reset first")
        return self._env
