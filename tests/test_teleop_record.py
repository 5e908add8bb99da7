"""Recording to files: the checks can fail, the files repeat, and a killed recording leaves whole episodes only."""

from __future__ import annotations

import dataclasses
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import mujoco
import numpy as np
import pytest

from minidual.config.root import Config
from minidual.config.scene import SceneConfig
from minidual.config.teleop import TeleopConfig
from minidual.demos import recording as teleop_recording
from minidual.demos import rig as teleop_rig
from minidual.demos.episode import read_episode, validate_episode
from minidual.demos.recording import Recording, RecordingNumbers, record
from minidual.demos.rig import Attempt, Job, Rig
from minidual.errors import NothingEvaluatedError, UsageError
from minidual.gate.stage import StageContext
from minidual.plant.world import World
from minidual.robot.arms import DUAL_PANDA
from minidual.robot.pair import Robot
from minidual.stages.registry import STAGES
from minidual.stages.teleop_record import record_checks, run, write_quality
from minidual.tasks.task import make_task

CONFIG = Config()
GOOD = RecordingNumbers(
    episodes=120,
    attempts=121,
    successes=120,
    files_at_fault=0,
    jerk_rms_max=21.0,
    sync_error_max_s=0.0,
    latency_p50_s=0.0003,
    latency_p99_s=0.001,
    episodes_per_min=30.0,
    recorded_ticks=52200,
    dataset_rows=52200,
    dataset_episodes=120,
)


def _job(folder: Path, **teleop: Any) -> Job:
    settings = CONFIG.teleop.model_copy(update={"episodes_n": 2, **teleop})
    return Job(folder, make_task(CONFIG), settings, CONFIG.arbiter, seed=11)


def test_good_numbers_pass() -> None:
    checks = record_checks(GOOD, TeleopConfig())
    assert all(c.passed for c in checks if c.limited)
    assert {"episodes", "schema_ok", "jerk_rms_max", "latency_p99_s", "episodes_per_min"} <= {c.name for c in checks}


@pytest.mark.parametrize(
    ("check", "change"),
    [
        ("episodes", {"episodes": 119, "dataset_episodes": 119}),
        ("schema_ok", {"files_at_fault": 1}),
        ("jerk_rms_max", {"jerk_rms_max": 200.0}),
        ("jerk_rms_max", {"jerk_rms_max": float("nan")}),
        ("latency_p99_s", {"latency_p99_s": 0.11}),
        ("episodes_per_min", {"episodes_per_min": 2.9}),
        ("sync_error_max_s", {"sync_error_max_s": 0.021}),
        ("sync_error_max_s", {"sync_error_max_s": float("nan")}),
        ("dataset_rows", {"dataset_rows": 52199}),
        ("dataset_episodes", {"dataset_episodes": 119}),
    ],
)
def test_each_check_can_fail(check: str, change: dict[str, Any]) -> None:
    checks = record_checks(dataclasses.replace(GOOD, **change), TeleopConfig())
    assert {c.name for c in checks if c.passed is False} == {check}


def _contents(path: Path) -> dict[str, Any]:
    """Return every dataset and attribute of an HDF5 file."""
    found: dict[str, Any] = {}
    with h5py.File(path) as file:
        found["attributes"] = {k: str(v) for k, v in file.attrs.items()}
        file.visititems(lambda name, item: found.update({name: item[()]} if isinstance(item, h5py.Dataset) else {}))
    return found


def _world(model: mujoco.MjModel) -> Any:
    def make(scene: SceneConfig, robot: Robot, *, visuals: bool) -> World:
        return World(scene, robot, model=model)

    return make


@pytest.fixture(scope="module")
def shared_model(visual_model: mujoco.MjModel) -> Iterator[None]:
    """Worlds of this process share the compiled model, which takes seconds to make."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(teleop_rig, "World", _world(visual_model))
        yield


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, shared_model: None) -> tuple[Job, Recording]:
    """Two demonstrations recorded in this process."""
    job = _job(tmp_path_factory.mktemp("recorded"))
    return job, record(job, workers=1)


def test_a_recording_holds_sound_demonstrations_only(recorded: tuple[Job, Recording], tmp_path: Path) -> None:
    job, recording = recorded
    assert [a.trial.index for a in recording.kept] == [0, 1]
    assert sorted(p.name for p in job.folder.rglob("*")) == ["episode_000000.hdf5", "episode_000001.hdf5", "episodes"]
    for attempt in recording.kept:
        assert attempt.path is not None
        assert validate_episode(attempt.path, cameras=("high",), robot=DUAL_PANDA) == []
        episode = read_episode(attempt.path)
        assert episode.meta.success
        assert episode.meta.trial == attempt.trial.index
        assert episode.images["high"].shape == (len(episode), 96, 128, 3)
        assert episode.meta.extra["start_x_y_yaw"] == list(job.trial(attempt.trial.index).start["rod"])
        assert set(np.unique(episode.action_gripper)) == {0.0, 1.0}
        assert 0.05 < episode.gripper.min() < 0.5 < episode.gripper.max() <= 1.001, "measured openings, not commands"
    rows = sum(len(read_episode(path, cameras=())) for path in recording.paths)
    numbers = recording.numbers(dataset_rows=rows, dataset_episodes=2)
    checks = record_checks(numbers, job.teleop.model_copy(update={"latency_max_s": 1.0, "episodes_per_min": 0.0}))
    assert [c.sentence() for c in checks if c.passed is False] == []
    write_quality(recording.attempts, tmp_path / "quality.csv")
    lines = (tmp_path / "quality.csv").read_text().splitlines()
    assert len(lines) == 3
    assert lines[0].startswith("trial,start_x_m,start_y_m,start_yaw_rad,success,kept,reason")


def test_faults_of_a_recording_reach_its_numbers(recorded: tuple[Job, Recording]) -> None:
    first, second = recorded[1].attempts
    broken = dataclasses.replace(second, problems=("not_finite: ...",), sync_error_max_s=float("nan"))
    first, broken = (dataclasses.replace(a, wall_s=40.0) for a in (first, broken))
    numbers = Recording((first, broken), 100.0, workers=2).numbers(870, 2)
    assert numbers.files_at_fault == 1
    assert np.isnan(numbers.sync_error_max_s), "an unknown value must not vanish"
    assert numbers.episodes_per_min == pytest.approx(3.0)


def test_workers_change_nothing_in_the_files(recorded: tuple[Job, Recording], tmp_path: Path) -> None:
    again = record(_job(tmp_path), workers=2)
    for first, second in zip(recorded[1].kept, again.kept, strict=True):
        assert first.path is not None
        assert second.path is not None
        a, b = _contents(first.path), _contents(second.path)
        assert a.keys() == b.keys()
        for key, value in a.items():
            np.testing.assert_array_equal(value, b[key], err_msg=key)


def test_failed_attempts_are_set_aside_with_their_reason(tmp_path: Path, shared_model: None) -> None:
    # Hands that close 6 cm beside the rod: nothing is lifted.
    job = _job(tmp_path, episodes_n=1, attempts_max_ratio=1.0)
    rig = Rig(job, ("high",))
    real = rig.world.reset

    def aside(q=None, *, poses):
        ((name, (x, y, yaw)),) = poses.items()
        real(q, poses={name: (x + 0.06, y, yaw)})

    rig.world.reset = aside  # type: ignore[method-assign]
    attempt = rig.record(0)
    rig.close()
    assert not attempt.success
    assert not attempt.kept
    assert "rose" in attempt.reason
    assert attempt.path == tmp_path / "rejected" / "episode_000000.hdf5"
    meta = read_episode(attempt.path, cameras=()).meta
    assert not meta.success
    assert meta.extra["reason"] == attempt.reason
    assert not (tmp_path / "episodes").exists()


def _fake(outcomes: list[bool], calls: list[list[int]]) -> Any:
    def record_attempts(job: Job, indices: Any, *, workers: int, observe: None = None) -> Any:
        calls.append(list(indices))
        for index in indices:
            good = outcomes[index]
            yield Attempt(job.trial(index), good, good, "" if good else "held at 3.00 s: left hand")

    return record_attempts


def test_failures_are_made_up_for_in_a_way_that_no_worker_can_change(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    calls: list[list[int]] = []
    outcomes = [True, False, True, False, False, True, True]
    monkeypatch.setattr(teleop_recording, "record_attempts", _fake(outcomes, calls))
    recording = record(_job(tmp_path, episodes_n=4, attempts_max_ratio=2.0), workers=2)
    assert calls == [[0, 1, 2, 3], [4, 5], [6]]
    assert [a.trial.index for a in recording.kept] == [0, 2, 5, 6]


def test_attempts_are_bounded_and_their_commonest_reason_reported(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    calls: list[list[int]] = []
    monkeypatch.setattr(teleop_recording, "record_attempts", _fake([False] * 50, calls))
    config = CONFIG.model_copy(update={"teleop": CONFIG.teleop.model_copy(update={"episodes_n": 4})})
    with pytest.raises(NothingEvaluatedError, match=r"none of 6 attempts.*6 x held at 3\.00 s: left hand"):
        run(StageContext(tmp_path, config, config.seed, "standard"))
    assert sum(map(len, calls)) == 6
    assert (tmp_path / "quality.csv").read_text().count("left hand") == 6


def test_an_unknown_leader_is_refused_before_anything_is_built(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"(?s)no leader 'scriptd'.*did you mean 'scripted'"):
        record(_job(tmp_path, leader="scriptd"), workers=1)
    assert list(tmp_path.iterdir()) == []


def test_the_stage_stands_in_the_table_and_names_what_it_depends_on() -> None:
    assert {"task", "robot", "teleop", "scene", "arbiter", "supervisor"} == set(
        STAGES["teleop-record"].parameters(CONFIG)
    )


_SCRIPT = """
import sys
from pathlib import Path
from minidual.config.root import Config
from minidual.demos.recording import record
from minidual.demos.rig import Job
from minidual.tasks.task import make_task
c = Config()
job = Job(Path(sys.argv[1]), make_task(c), c.teleop.model_copy(update={"episodes_n": 50}), c.arbiter, 11)
record(job, workers=1)
"""


def test_a_killed_recording_leaves_whole_episodes_only(tmp_path: Path) -> None:
    process = subprocess.Popen([sys.executable, "-c", _SCRIPT, str(tmp_path)], start_new_session=True)
    try:
        deadline = time.monotonic() + 90.0
        while not list(tmp_path.glob("episodes/*.hdf5")):
            assert process.poll() is None, "the recording ended by itself"
            assert time.monotonic() < deadline, "no episodes after 90 s"
            time.sleep(0.05)
        time.sleep(0.7)  # in the middle of the second
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    whole = sorted(tmp_path.rglob("*.hdf5"))
    assert whole
    for path in whole:
        assert validate_episode(path, cameras=("high",)) == []
        if path.parent.name == "episodes":
            assert read_episode(path, cameras=()).meta.success
