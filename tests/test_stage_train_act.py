"""Negative controls of train-act: every limited check says no, and says no for its own reason."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from types import MappingProxyType
from typing import Any

import learning_world
import numpy as np
import pytest

from minidual.config.learning import TrainConfig
from minidual.policies import policy
from minidual.policies.kinds import ChunkPolicy, TrainResult
from minidual.policies.policy import EmittedActions, exercise_checkpoint
from minidual.robot.pair import DUAL_PANDA
from minidual.stages.train_act import train_checks

RESULT = TrainResult(
    steps=100,
    steps_asked=100,
    train_s=60.0,
    samples_per_s=400.0,
    parameters=770_000,
    loss_initial=1.0,
    loss_final=0.05,
    loss_ratio=0.05,
    validation_l1=0.06,
    validation_keyframe_rad=0.004,
    training_episodes=[0, 1],
    validation_episodes=[2],
    ticks=1200,
    bf16=True,
    resumed_from_step=0,
    stopped_by="steps",
)
EMITTED = EmittedActions(in_limits=1.0, overshoot_max_rad=0.0, targets_n=16, inference_hz=300.0)


def failing(result: dict[str, Any] | None = None, emitted: dict[str, Any] | None = None) -> set[str]:
    checks = train_checks(
        dataclasses.replace(RESULT, **(result or {})), EMITTED._replace(**(emitted or {})), TrainConfig(), DUAL_PANDA
    )
    return {check.name for check in checks if check.passed is False}


def test_a_sound_training_passes_every_limit() -> None:
    assert failing() == set()
    limited = {c.name for c in train_checks(RESULT, EMITTED, TrainConfig(), DUAL_PANDA) if c.op}
    assert limited == {"loss_ratio", "actions_in_limits", "targets_n", "train_s", "steps_done"}


@pytest.mark.parametrize(
    ("result", "name"),
    [
        ({"loss_ratio": 0.5}, "loss_ratio"),
        ({"loss_ratio": math.nan}, "loss_ratio"),
        ({"train_s": 1801.0}, "train_s"),
        ({"steps": 99}, "steps_done"),
    ],
)
def test_a_training_that_learned_nothing_took_too_long_or_was_cut_fails(result: dict[str, Any], name: str) -> None:
    assert failing(result=result) == {name}


@pytest.mark.parametrize(
    ("emitted", "name"),
    [
        ({"in_limits": 0.99}, "actions_in_limits"),
        ({"targets_n": 14}, "targets_n"),
        ({"in_limits": math.nan}, "actions_in_limits"),
    ],
)
def test_a_policy_that_emits_the_wrong_thing_fails(emitted: dict[str, Any], name: str) -> None:
    assert failing(emitted=emitted) == {name}


class Wide(ChunkPolicy):
    """Emits actions of constant value; knows nothing of arms."""

    cameras = MappingProxyType({"high": (96, 128)})
    chunk_size = 5

    def __init__(self, dim: int, value: float) -> None:
        self.dim, self.value = dim, value

    def predict(self, images: Any, state: Any) -> np.ndarray:
        return np.full((5, self.dim), self.value)


@pytest.mark.parametrize(
    ("dim", "value", "failed"),
    [
        (16, 0.5, {"actions_in_limits"}),  # joint 4 of a Panda is never above -0.07 rad
        (14, 0.5, {"actions_in_limits", "targets_n"}),
    ],
)
def test_a_checkpoint_is_judged_as_it_predicts(
    dim: int, value: float, failed: set[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    demos = learning_world.demonstrations(1, seed=0, every=40)
    if dim != demos.dim:
        demos = dataclasses.replace(demos, state=demos.state[:, :dim], action=demos.action[:, :dim])
    monkeypatch.setattr(policy, "load_policy", lambda *_: Wide(dim, value))
    emitted = exercise_checkpoint(tmp_path, demos, DUAL_PANDA)
    assert emitted.targets_n == dim
    assert failing(emitted=emitted._asdict()) == failed
