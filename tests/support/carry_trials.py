"""Trials and judges of the rod task for a given scene."""

from __future__ import annotations

from typing import Any

from minidual.config.control import SensingConfig
from minidual.config.root import Config
from minidual.config.scene import SceneConfig
from minidual.tasks.catalogue import make_task
from minidual.tasks.judge import Judge
from minidual.tasks.task import Task, Trial
from minidual.trials.metrics import TrialMetrics

PERFECT_SENSING = SensingConfig(
    pose_noise_m=0.0,
    pose_noise_rad=0.0,
    pose_rate_hz=1000.0,
    force_noise_n=0.0,
    delay_s=0.0,
    force_filter_s=0.0,
    grasp_memory_s=0.0,
)


def carry_task(scene: SceneConfig) -> Task:
    """Return the task in exactly this scene."""
    return make_task(Config(scene=SceneConfig.model_validate(scene.model_dump())))


def sample_trial(
    scene: SceneConfig,
    seed: int,
    purpose: str,
    index: int,
    *,
    widen: float = 1.0,
) -> Trial:
    """Draw a trial of the rod task."""
    return carry_task(scene).trial(seed, purpose, index, widen=widen)


def rod_trial(
    purpose: str,
    index: int,
    start: tuple[float, float, float],
    goal: tuple[float, float, float],
) -> Trial:
    """Return a trial of the rod from and to (x, y, yaw)."""
    return Trial(purpose, index, {"rod": start}, {"rod": goal})


def rod_judge(scene: SceneConfig, trial: Trial, *, demand_internal_force: bool = False) -> Judge:
    """Return the judge of a trial in a scene."""
    return Judge(carry_task(scene), trial, {"squeezed"} if demand_internal_force else ())


def same_row(result: TrialMetrics) -> dict[str, Any]:
    """A trial's row without the times that were measured by the clock."""
    return {name: value for name, value in result.to_row().items() if name not in result.wall}
