"""A policy that reads forces: learned from the recording, said by the checkpoint, needed to answer."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from minidual.config.learning import DeployConfig, TrainConfig
from minidual.demos.lerobot_features import state_names
from minidual.errors import DataError, UsageError
from minidual.policies.demonstrations import Demonstrations, joined
from minidual.policies.inputs import read_input
from minidual.policies.kinds import load_policy
from minidual.policies.pilot import load_runtime
from minidual.policies.policy import exercise_checkpoint
from minidual.policies.takes import FILE, Takes, read_takes
from minidual.robot.pair import DUAL_PANDA
from tests.support.late import late
from tests.support.training_samples import SMALL, tiny, train

torch = late("torch")
batches = late("minidual.policies.batches")

INPUTS = {"joint_torques": 14, "hand_wrench": 12}
INPUTS_N = sum(INPUTS.values())
NEWTONS = 20.0
"""Standard deviation of the made-up forces."""
NAMES = state_names(DUAL_PANDA)


def feeling() -> Demonstrations:
    """Return demonstrations whose commands follow the forces felt, as inserting does."""
    demos = tiny()
    rng = np.random.default_rng(3)
    forces = rng.normal(5.0, NEWTONS, (len(demos), INPUTS_N)).astype(np.float32)
    action = demos.action.copy()
    action[:, :14] = forces[:, :14] / NEWTONS
    takes = Takes(
        state=NAMES,
        action=NAMES,
        inputs=INPUTS,
        rate_hz=50.0,
        radians=True,
    ).with_cameras({"high": (12, 16)})
    state = np.concatenate([0.3 * demos.state, forces], axis=1)
    return dataclasses.replace(demos, state=state, action=action, takes=takes)


def dataset(root: Path, **signals: np.ndarray) -> Path:
    """Write the tables of a dataset that holds these signals."""
    folder = root / "data" / "chunk-000"
    folder.mkdir(parents=True)
    columns = {f"observation.{name}": list(values) for name, values in signals.items()}
    pq.write_table(pa.table({"index": [0, 1], **columns}), folder / "file-000.parquet")
    return root


def test_a_recorded_signal_is_read_as_rows_of_numbers(tmp_path: Path) -> None:
    wrench = np.arange(24, dtype=np.float32).reshape(2, 12)
    root = dataset(tmp_path, hand_wrench=wrench, internal_force=np.array([1.0, 2.0]))
    np.testing.assert_array_equal(read_input(root, "hand_wrench"), wrench)
    assert read_input(root, "internal_force").shape == (2, 1)


def test_a_dataset_without_the_signal_is_refused_with_what_to_type(tmp_path: Path) -> None:
    root = dataset(tmp_path, internal_force=np.array([1.0, 2.0]))
    with pytest.raises(
        DataError, match=r"no signal 'hand_wrench'.*holds internal_force"
    ) as refused:
        read_input(root, "hand_wrench")
    assert "teleop-record --force --set 'teleop.signals=[hand_wrench]'" in str(refused.value.remedy)
    with pytest.raises(UsageError, match=r"cannot sense 'driver'; .*joint_torques"):
        read_input(root, "driver")
    broken = dataset(tmp_path / "broken", internal_force=np.array([1.0, np.nan]))
    with pytest.raises(DataError, match="'internal_force' is not finite"):
        read_input(broken, "internal_force")


def test_inputs_stand_behind_joints_and_openings() -> None:
    demos = feeling()
    assert demos.state_dim == 16 + INPUTS_N
    assert demos.state_joints == list(range(14))
    assert demos.state_grippers == [14, 15]
    assert demos.state_inputs == list(range(16, 16 + INPUTS_N))
    assert tiny().state_inputs == []
    with pytest.raises(DataError, match="and 42 and 16 a state"):
        joined([demos, tiny()])
    assert demos.takes is not None
    assert "inputs: joint_torques (14), hand_wrench (12)" in demos.takes.text()


@pytest.mark.torch
def test_inputs_are_normalised_by_the_data_and_noisy_as_joints_are() -> None:
    demos = feeling()
    rows = np.arange(len(demos))
    stats = batches.dataset_statistics(demos, rows, 0.01)
    config = TrainConfig(chunk_size=5, state_noise_approach_rad=0.06, state_noise_rad=0.01)
    maker = batches.BatchMaker(demos, config, stats)
    clean = maker.clean(rows)["observation.state"].numpy()
    assert clean.shape == (len(demos), 42)
    assert np.abs(clean[:, 16:].mean(axis=0)).max() < 1e-4
    np.testing.assert_allclose(clean[:, 16:].std(axis=0), 1.0, atol=1e-3)

    def noise(row: int) -> np.ndarray:
        same = np.full(3000, row)
        noisy = maker.training(same, np.random.default_rng(0))["observation.state"]
        return (noisy - maker.clean(same)["observation.state"]).numpy()

    joints = stats["observation.state"]["std"].numpy()[:14]
    assert (noise(3)[:, :14] * joints).std() == pytest.approx(0.06, rel=0.03)
    assert noise(3)[:, 16:].std() == pytest.approx(0.06 / batches.JOINT_STD_RAD, rel=0.03)
    assert noise(30)[:, 16:].std() == pytest.approx(0.01 / batches.JOINT_STD_RAD, rel=0.03)
    assert np.abs(noise(3)[:, 14:16]).max() == 0.0


@pytest.mark.torch
@pytest.mark.parametrize("policy", ["spatial_act", "act"])
def test_a_trained_network_reacts_to_its_inputs(policy: str, tmp_path: Path) -> None:
    """Its commands follow the forces, which nothing else tells; the checkpoint says what it reads."""
    demos = feeling()
    config = TrainConfig(**{**SMALL, "policy": policy, "steps": 2 if policy == "act" else 40})
    result = train(demos, config, 0, tmp_path / "a")
    assert read_takes(tmp_path / "a") == demos.takes
    learned = load_policy(tmp_path / "a", threads=1)
    assert dict(learned.inputs) == INPUTS
    assert (learned.dim, learned.state_dim) == (16, 42)
    images = {"high": demos.images["high"][5]}
    felt = demos.state[5].copy()
    other = felt.copy()
    other[16:30] += 2.0 * NEWTONS
    learned.reset()
    answer = learned.predict(images, felt)
    learned.reset()
    change = learned.predict(images, other) - answer
    assert np.abs(change[:, :14]).mean() > (1e-5 if policy == "act" else 0.01)
    if policy == "spatial_act":
        assert result.loss_final < result.loss_initial
        assert exercise_checkpoint(tmp_path / "a", demos, DUAL_PANDA).targets_n == 16


@pytest.mark.torch
def test_a_checkpoint_with_inputs_drives_given_all_of_them(tmp_path: Path) -> None:
    demos = feeling()
    train(demos, TrainConfig(**SMALL), 0, tmp_path / "a")
    runtime = load_runtime(tmp_path / "a", DeployConfig(n_action_steps=5), DUAL_PANDA)
    image = {"high": demos.images["high"][5]}
    measured = np.r_[DUAL_PANDA.home, 1.0, 1.0]
    state = runtime.with_usual_inputs(measured)
    assert state.shape == (42,)
    np.testing.assert_allclose(state[16:], 5.0, atol=0.5 * NEWTONS)
    assert runtime.predict_chunk(image, state).shape == (10, 16)
    with pytest.raises(
        DataError, match=r"\(16,\), not \(42,\): .*joint_torques \(14\), hand_wrench"
    ):
        runtime.act(image, measured)


@pytest.mark.torch
def test_a_checkpoint_without_inputs_loads_whatever_its_age(tmp_path: Path) -> None:
    plain = tiny()
    train(plain, TrainConfig(**SMALL), 0, tmp_path / "b")
    assert not (tmp_path / "b" / FILE).exists()
    old = load_policy(tmp_path / "b", threads=1)
    assert dict(old.inputs) == {}
    assert old.state_dim == 16
    takes = Takes(state=NAMES, action=NAMES, rate_hz=50.0)
    record = takes.model_dump(mode="json")
    del record["inputs"]
    (tmp_path / "b" / FILE).write_text(json.dumps(record))
    assert read_takes(tmp_path / "b") == takes
    assert dict(load_policy(tmp_path / "b", threads=1).inputs) == {}
