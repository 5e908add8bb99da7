"""Negative controls of train-act: every limited check says no, and says no for its own reason."""

from __future__ import annotations

import dataclasses
import math
import shutil
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from minidual import emergency
from minidual.config.learning import TrainConfig
from minidual.config.root import Config
from minidual.gate.code import Code
from minidual.gate.progress import Progress
from minidual.gate.stage import StageContext, StageResult
from minidual.policies import policy
from minidual.policies.chunk_policy import ChunkPolicy
from minidual.policies.policy import EmittedActions, exercise_checkpoint
from minidual.robot.pair import DUAL_PANDA
from minidual.stages import train_act
from minidual.stages.train_act import train_checks, training_seeds
from tests.support.training_samples import RESULT, SMALL, tiny

EMITTED = EmittedActions(in_limits=1.0, overshoot_max_rad=0.0, targets_n=16, inference_hz=300.0)


def failing(
    result: dict[str, Any] | None = None,
    emitted: dict[str, Any] | None = None,
) -> set[str]:
    checks = train_checks(
        dataclasses.replace(RESULT, **(result or {})),
        EMITTED._replace(**(emitted or {})),
        TrainConfig(),
        DUAL_PANDA,
    )
    return {check.name for check in checks if check.passed is False}


def test_a_sound_training_passes_every_limit() -> None:
    assert failing() == set()
    limited = {c.name for c in train_checks(RESULT, EMITTED, TrainConfig(), DUAL_PANDA) if c.op}
    assert limited == {"loss_ratio", "actions_in_limits", "targets_n", "steps_done"}


@pytest.mark.parametrize(
    ("result", "name"),
    [
        ({"loss_ratio": 0.5}, "loss_ratio"),
        ({"loss_ratio": math.nan}, "loss_ratio"),
        ({"steps": 99}, "steps_done"),
    ],
)
def test_a_training_that_learned_nothing_or_was_cut_fails(
    result: dict[str, Any],
    name: str,
) -> None:
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
        self.dim = dim
        self.value = value

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
    dim: int,
    value: float,
    failed: set[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    demos = tiny(episodes=1, size=(96, 128))
    if dim != demos.dim:
        demos = dataclasses.replace(demos, state=demos.state[:, :dim], action=demos.action[:, :dim])
    monkeypatch.setattr(policy, "load_policy", lambda *_: Wide(dim, value))
    emitted = exercise_checkpoint(tmp_path, demos, DUAL_PANDA)
    assert emitted.targets_n == dim
    assert failing(emitted=emitted._asdict()) == failed


class Stage:
    """Runs of train-act in one run folder.

    A run is interrupted when training number `stop_in` is exercised (0: not).
    """

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder = folder
        self.said = list[str]()
        self.stop_in = 0
        monkeypatch.setattr(train_act, "load_demonstrations", lambda *_, **__: tiny())
        monkeypatch.setattr(train_act, "exercise_checkpoint", self.exercise)
        monkeypatch.setattr(train_act, "draw_loss", lambda *_: None)

    def exercise(self, *_: Any, **__: Any) -> EmittedActions:
        self.stop_in -= 1
        if self.stop_in == 0:
            raise KeyboardInterrupt
        return EMITTED

    def run(self, stop_in: int = 0, **settings: Any) -> StageResult:
        self.stop_in = stop_in
        folder = self.folder / ".train-act.tmp"
        folder.mkdir()
        context = StageContext(
            config=Config(train=TrainConfig(**{**SMALL, **settings})),
            seed=5,
            profile="standard",
            folder=folder,
            upstream={"teleop-record": self.folder},
            progress=Progress(self.said.append),
        )
        try:
            return train_act.run(context)
        finally:
            shutil.rmtree(folder)

    def moved(self) -> list[str]:
        """Names in set-aside, without their times."""
        return sorted(
            path.name.partition("-20")[0] for path in (self.folder / "set-aside").glob("*")
        )

    def kept(self) -> list[str]:
        return sorted(
            str(path.relative_to(self.folder)) for path in self.folder.glob(".train-act.*")
        )


@pytest.fixture
def stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Stage:
    return Stage(tmp_path, monkeypatch)


@pytest.mark.torch
def test_every_interrupted_seed_goes_on_and_nothing_is_left(stage: Stage) -> None:
    with pytest.raises(KeyboardInterrupt):
        stage.run(stop_in=2, seeds_n=2)
    notes = stage.run(seeds_n=2).notes
    assert "continued an interrupted training from step 4" in notes
    assert "seed_2.continued an interrupted training from step 4" in notes
    assert (stage.kept(), stage.moved()) == ([], [])


@pytest.mark.torch
def test_progress_of_other_settings_is_kept_in_the_run_for_every_seed(stage: Stage) -> None:
    """The progress of each seed is a file of its own in `set-aside`."""
    with pytest.raises(KeyboardInterrupt):
        stage.run(stop_in=2, seeds_n=2)
    notes = stage.run(seeds_n=2, learning_rate=0.01).notes
    assert stage.moved() == ["train-act.other-progress"] * 2
    named = [Path(note.rpartition(" ")[2]) for note in notes if "did not fit" in note]
    assert len(named) == 2
    assert all(path.parent == stage.folder / "set-aside" and path.is_file() for path in named)


@pytest.mark.torch
def test_a_damaged_file_of_one_seed_leaves_the_others(stage: Stage) -> None:
    with pytest.raises(KeyboardInterrupt):
        stage.run(stop_in=2, seeds_n=2)
    first, _ = sorted(stage.folder.rglob(".train-act.progress-*"))
    first.write_bytes(b"")
    notes = stage.run(seeds_n=2).notes
    assert stage.moved() == ["train-act.damaged-progress"]
    assert "seed_2.continued an interrupted training from step 4" in notes


@pytest.mark.torch
def test_a_training_does_not_go_on_under_other_code(
    stage: Stage,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    modules = train_act.code_of(["minidual.policies.act:train"]).modules
    assert {
        "minidual.policies.act",
        "minidual.policies.train",
        "minidual.policies.batches",
    } <= modules.keys()
    with pytest.raises(KeyboardInterrupt):
        stage.run(stop_in=2, seeds_n=2)
    monkeypatch.setattr(
        train_act,
        "code_of",
        lambda _: Code({**modules, "minidual.policies.batches": "changed"}),
    )
    notes = stage.run(seeds_n=2).notes
    assert not any("continued" in note for note in notes)
    assert stage.moved() == ["train-act.progress"] * 2
    assert sum("a training of other code is now in" in line for line in stage.said) == 2
    assert all(path.is_file() for path in (stage.folder / "set-aside").iterdir())


def failing_checks(result: StageResult) -> set[str]:
    return {check.name for check in result.checks if check.passed is False}


@pytest.mark.torch
def test_a_training_that_hardly_moves_its_weights(stage: Stage) -> None:
    result = stage.run(learning_rate=1e-8, backbone_learning_rate=1e-8)
    assert failing_checks(result) == {"loss_ratio"}


@pytest.mark.torch
def test_a_training_on_a_machine_that_is_too_slow_for_its_time_limit(stage: Stage) -> None:
    result = stage.run(steps=400, time_limit_s=0.05)
    assert "steps_done" in failing_checks(result)


@pytest.mark.torch
def test_a_finished_training_survives_the_emergency_stop(
    stage: Stage,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(train_act, "draw_loss", lambda *_: emergency.press("test"))
    try:
        with pytest.raises(emergency.EmergencyStop):
            stage.run()
    finally:
        emergency.release()
    monkeypatch.setattr(train_act, "draw_loss", lambda *_: None)
    assert "continued an interrupted training from step 4" in stage.run().notes


def test_each_training_has_its_own_seed_and_the_first_is_the_runs() -> None:
    seeds = training_seeds(20260, 3)
    assert seeds[0] == 20260
    assert len(set(seeds)) == 3
    assert training_seeds(20260, 1) == seeds[:1]
