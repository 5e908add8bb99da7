"""`train-act --dataset` trains on datasets of other robots, and says what the policy takes."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from minidual.config.learning import TrainConfig
from minidual.config.root import Config
from minidual.demos.lerobot_reader import read_dataset
from minidual.errors import DataError, ExitCode, UsageError
from minidual.gate.stage import ToolContext
from minidual.policies.chunk_policy import ChunkPolicy
from minidual.policies.demonstrations import (
    INSTRUCTIONS_MAX,
    instructions_of,
    load_demonstrations,
)
from minidual.policies.kinds import load_policy
from minidual.policies.pilot import load_runtime
from minidual.policies.takes import Takes, read_takes
from minidual.robot.pair import DUAL_PANDA
from minidual.stages import train_dataset as module
from minidual.stages.train_dataset import (
    Imitation,
    dataset_checks,
    dataset_folder,
    exercised,
    train_dataset,
)
from tests.support import foreign_datasets as foreign
from tests.support.foreign_datasets import ARM, TOP
from tests.support.training_samples import RESULT, SMALL, tiny

SETTINGS = {**SMALL, "steps": 60, "loss_ratio_max": 0.99, "batch_size": 8}


def context(
    folder: Path, dataset: Path, policy: str = "spatial_act", **options: str
) -> ToolContext:
    return ToolContext(
        config=Config(train=TrainConfig(**{**SETTINGS, "policy": policy})),
        seed=3,
        profile="standard",
        options={"dataset": str(dataset), **options},
        run_folder=folder / "run",
        name="train-dataset",
    )


@pytest.fixture(scope="module")
def cups(tmp_path_factory: pytest.TempPathFactory) -> Path:
    features = foreign.one_arm()
    features["action"] = foreign.vector([*ARM, "base"], len(ARM) + 1)
    return foreign.make(tmp_path_factory.mktemp("foreign") / "cups", features)


@pytest.mark.torch
def test_a_dataset_of_another_robot_trains_a_policy_that_says_what_it_takes(
    cups: Path,
    tmp_path: Path,
) -> None:
    result = train_dataset(context(tmp_path, cups, height="16"))
    checkpoint = tmp_path / "run" / "train-dataset" / "cups" / "checkpoint"
    assert result.exit_code == ExitCode.PASS, result.lines
    assert result.data["checkpoint"] == str(checkpoint)
    assert read_takes(checkpoint) == Takes(
        state=ARM,
        action=(*ARM, "base"),
        cameras={TOP: (16, 24)},
        rate_hz=20.0,
        robot="so100_follower",
    )
    record = json.loads((checkpoint.parent / "train.json").read_text())
    assert record["action_error"] < record["mean_error"]
    assert any("state of 6: shoulder_pan" in line for line in result.lines)
    with pytest.raises(UsageError, match=r"another state than two panda arms: shoulder_pan"):
        load_runtime(checkpoint, Config().deploy, DUAL_PANDA)


@pytest.mark.torch
def test_a_dataset_of_two_tasks_trains_one_policy_that_is_told_which(tmp_path: Path) -> None:
    tasks = ("stack the cups", "fetch a plate")
    both = foreign.make(tmp_path / "both", foreign.one_arm(), tasks=tasks)
    result = train_dataset(context(tmp_path, both, height="16"))
    assert result.exit_code == ExitCode.PASS, result.lines
    assert any("instructions: fetch a plate; stack the cups" in line for line in result.lines)

    policy = load_policy(tmp_path / "run" / "train-dataset" / "both" / "checkpoint")
    assert policy.state_dim == len(ARM)
    pictures = {name: np.full((*size, 3), 90, np.uint8) for name, size in policy.cameras.items()}
    state = np.zeros(len(ARM), np.float32)
    with pytest.raises(UsageError, match="was not told what to do; it was trained to: 'fetch a"):
        policy.predict(pictures, state)
    with pytest.raises(UsageError, match=r"cannot do 'wash up'; .* 'stack the cups'"):
        policy.instruct("wash up")
    chunks: list[np.ndarray] = []
    for task in tasks:
        policy.reset()
        policy.instruct(task)
        chunks.append(policy.predict(pictures, state))
    assert not np.allclose(chunks[0], chunks[1], atol=1e-3)


@pytest.mark.torch
def test_more_instructions_than_a_policy_reads_are_descriptions(tmp_path: Path) -> None:
    blind = {name: feature for name, feature in foreign.one_arm().items() if name != TOP}
    tasks = [f"stack cup {number}" for number in range(INSTRUCTIONS_MAX + 1)]
    many = foreign.make(tmp_path / "many", blind, tasks=tasks)
    assert instructions_of(read_dataset(many)) == ()
    fewer = foreign.make(tmp_path / "fewer", blind, tasks=tasks[1:])
    assert instructions_of(read_dataset(fewer)) == tuple(sorted(tasks[1:]))


@pytest.mark.torch
def test_a_state_tells_the_instruction_of_its_episode(tmp_path: Path) -> None:
    tasks = ("stack the cups", "fetch a plate", "stack the cups")
    demos = load_demonstrations(foreign.make(tmp_path / "d", foreign.one_arm(), tasks=tasks), [])
    told = [demos.instruction(row) for row in range(0, len(demos), foreign.TICKS)]
    assert told == list(tasks)
    assert demos.sensed.shape == (len(demos), len(ARM))
    assert demos.state[:, len(ARM) :].sum(axis=1).tolist() == [1.0] * len(demos)
    assert set(demos.state_joints) < set(range(len(ARM))), "instructions get no noise"


@pytest.mark.torch
def test_a_camera_that_is_not_there_is_named(cups: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=rf"no camera 'wrist'; there are {TOP}"):
        train_dataset(context(tmp_path, cups, cameras="wrist"))
    with pytest.raises(UsageError, match="--height is 4"):
        train_dataset(context(tmp_path, cups, height="4"))


def test_the_dataset_of_a_recording_or_a_run_is_found(tmp_path: Path) -> None:
    inner = tmp_path / "standard" / "teleop-record" / "lerobot" / "meta"
    inner.mkdir(parents=True)
    (inner / "info.json").write_text("{}")
    for folder in (tmp_path / "standard", inner.parents[1], inner.parent):
        assert dataset_folder(str(folder)) == inner.parent
    assert module._name_of(inner.parent) == "standard"
    with pytest.raises(UsageError, match="no LeRobot dataset"):
        dataset_folder(str(tmp_path))
    with pytest.raises(UsageError, match="no such folder"):
        dataset_folder("lerobot/pusht")


class Fixed(ChunkPolicy):
    """Gives one action, whatever it sees."""

    cameras = {"high": (12, 16)}  # noqa: RUF012
    chunk_size = 1

    def __init__(self, action: np.ndarray) -> None:
        self.action = action
        self.dim = len(action)

    def predict(self, images: object, state: object) -> np.ndarray:
        return self.action[None].astype(float)


def test_a_policy_that_commands_the_mean_has_imitated_nothing() -> None:
    demos = tiny()
    imitation = exercised(Fixed(demos.action.mean(axis=0)), demos)
    assert imitation.action_error == pytest.approx(imitation.mean_error)
    checks = {check.name: check.passed for check in dataset_checks(RESULT, imitation, 0.5)}
    assert checks == {"loss_ratio": True, "steps_done": True, "action_error": False}
    better = Imitation(0.5 * imitation.mean_error, imitation.mean_error, 100.0)
    assert all(check.passed for check in dataset_checks(RESULT, better, 0.5))
    cut = dataclasses.replace(RESULT, steps=1, loss_ratio=0.9)
    failed = {c.name for c in dataset_checks(cut, better, 0.5) if not c.passed}
    assert failed == {"loss_ratio", "steps_done"}


def test_actions_that_are_not_finite_or_never_change_are_refused() -> None:
    demos = tiny()
    with pytest.raises(DataError, match="not usable"):
        exercised(Fixed(np.full(16, np.nan)), demos)
    still = dataclasses.replace(demos, action=np.ones_like(demos.action))
    with pytest.raises(DataError, match="nothing to learn"):
        exercised(Fixed(np.ones(16)), still)
