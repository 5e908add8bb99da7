"""Faults of cameras, leader, recorder and disk: each makes its own check of `teleop-record` say no."""

import itertools
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.config.learning import TeleopConfig
from minidual.config.root import Config
from minidual.control.stack import ControlStack
from minidual.demos import episode_recorder
from minidual.demos import recording as teleop_recording
from minidual.demos.leader import LeaderSample
from minidual.demos.leaders.scripted import ScriptedLeader
from minidual.demos.recording import RecordedAttempts, record
from minidual.demos.rig import Job
from minidual.demos.session import SessionResult, TeleopSession, Tick
from minidual.demos.writer import EpisodeWriter
from minidual.gate.stage import StageContext
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.skills.operator import ScriptedOperator
from minidual.stages import teleop_record
from minidual.stages.teleop_record import record_checks
from minidual.tasks.task import Trial
from tests.support.carry_trials import carry_task, sample_trial
from tests.support.late import late
from tests.support.recording_toys import ToyRig, job
from tests.support.trial_results import failing

lerobot_adapter = late("minidual.demos.lerobot_adapter")
pytestmark = pytest.mark.torch


def recorded(folder: Path, monkeypatch: pytest.MonkeyPatch, rig: type[ToyRig] = ToyRig) -> Job:
    """Return a job of three episodes whose recording uses a rig."""
    monkeypatch.setattr(teleop_recording, "Rig", rig)
    cameras = ("high", "left") if rig is SwappingRig else ()
    return job(folder, episodes_n=3, cameras=cameras)


def failing_checks(task: Job, attempts: RecordedAttempts) -> set[str]:
    """Return the checks that a recording fails, with a whole dataset."""
    numbers = attempts.numbers()
    whole = {"dataset_rows": numbers["recorded_ticks"], "dataset_episodes": numbers["episodes"]}
    return failing(record_checks(numbers | whole, task.teleop))


class SwappingRig(ToyRig):
    """Two cameras that show different things, and whose cables somebody swaps before trial 3."""

    def lead(self, trial: Trial, on_tick: Callable[[Tick], None]) -> SessionResult:
        """Give each camera a picture of its own."""

        def show(tick: Tick) -> None:
            high = tick.images["high"]
            left = np.flip(high, axis=0) // 3
            images = {"high": high, "left": left}
            if trial.index == 3:
                images = {"high": left, "left": high}
            on_tick(tick._replace(images=images))

        return super().lead(trial, show)


def test_a_sound_recording_passes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    task = recorded(tmp_path, monkeypatch)
    assert failing_checks(task, record(task, workers=1)) == set()


def test_a_leader_that_fails_too_often(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every fourth trial fails, and none may be made up for."""
    task = recorded(tmp_path, monkeypatch)
    task = replace(task, teleop=task.teleop.model_copy(update={"attempts_max_ratio": 1.0}))
    assert failing_checks(task, record(task, workers=1)) == {"episodes"}


def test_two_cameras_with_swapped_cables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    task = recorded(tmp_path, monkeypatch, SwappingRig)
    attempts = record(task, workers=1)
    assert [a.trial.index for a in attempts.kept] == [0, 2, 3]
    assert failing_checks(task, attempts) == {"schema_ok"}


def test_a_recorder_that_adds_noise(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The motion is smooth; its file is not."""
    append = EpisodeWriter.append
    rng = np.random.default_rng(1)

    def noisy(self: EpisodeWriter, *, qpos: Array, **values: Any) -> None:
        append(self, qpos=qpos + rng.normal(0.0, 0.01, qpos.shape), **values)

    monkeypatch.setattr(EpisodeWriter, "append", noisy)
    task = recorded(tmp_path, monkeypatch)
    assert failing_checks(task, record(task, workers=1)) == {"jerk_rms_max"}


def test_a_recorder_that_takes_40_s_an_episode(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = itertools.count(step=40.0)
    monkeypatch.setattr(episode_recorder.time, "perf_counter", lambda: next(clock))
    task = recorded(tmp_path, monkeypatch)
    assert failing_checks(task, record(task, workers=1)) == {"episodes_per_min"}


class LaggingRig(ToyRig):
    """The arms are 150 ms behind the leader."""

    behind_s = 0.15


def test_arms_that_lag_behind_the_leader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    task = recorded(tmp_path, monkeypatch, LaggingRig)
    attempts = record(task, workers=1)
    assert failing_checks(task, attempts) == {"lag_p50_s"}
    assert attempts.attempts[0].measures["lag_s"] == pytest.approx(0.15, abs=0.005)


class SlowLeader(ScriptedLeader):
    """Each reading takes 110 ms."""

    def read(self, now_s: float) -> LeaderSample | None:
        """Read late."""
        time.sleep(0.11)
        return super().read(now_s)


def test_a_leader_that_answers_late(
    world: World,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    trial = sample_trial(world.scene, 7, "demonstrations", 0, widen=1.3)
    demonstration = ScriptedOperator(world.scene).plan(trial, seed=7)
    demonstration = replace(demonstration, q=demonstration.q[:4])
    stack = ControlStack(world, Kinematics(), rate_hz=TeleopConfig().rate_hz)
    session = TeleopSession(stack, TeleopConfig())
    result = session.run(carry_task(world.scene), trial, SlowLeader(demonstration))
    task = recorded(tmp_path, monkeypatch)
    attempts = record(task, workers=1)
    late_attempt = replace(attempts.attempts[0], latencies_s=result.latencies_s)
    late_attempts = attempts._replace(attempts=(late_attempt, *attempts.attempts[1:]))
    assert failing_checks(task, late_attempts) == {"latency_p99_s"}


def test_a_dataset_that_loses_an_episode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The conversion does not see the last demonstration; the stage counts what is there."""
    real = lerobot_adapter.convert

    def convert(paths: Iterable[Path], *others: Any) -> Any:
        return real(list(paths)[:-1], *others)

    monkeypatch.setattr(teleop_recording, "Rig", ToyRig)
    monkeypatch.setattr("minidual.demos.lerobot_adapter.convert", convert)
    monkeypatch.setattr(teleop_record, "film_demonstration", lambda *_: None)
    teleop = {"episodes_n": 3, "episodes_per_min": 1e-3}
    config = Config.model_validate({"teleop": teleop})
    context = StageContext(folder=tmp_path, config=config, seed=11, profile="smoke")
    result = teleop_record.run(context)
    assert failing(result.checks) == {"dataset_rows", "dataset_episodes"}
