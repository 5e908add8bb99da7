"""Recording to files: its checks can fail, and the files repeat.

A killed recording leaves whole episodes only.
"""

from __future__ import annotations

import dataclasses
import os
import shutil
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

from minidual.cli.app import run_command_line
from minidual.config.learning import TeleopConfig
from minidual.config.root import Config, changed
from minidual.config.scene import SceneConfig
from minidual.demos import recording as teleop_recording
from minidual.demos import rig as teleop_rig
from minidual.demos.episode import inspect_episode, read_episode
from minidual.demos.lerobot_reader import read_dataset
from minidual.demos.recording import PARTS, RecordedAttempts, claim, record
from minidual.demos.rig import Attempt, Job, Rig
from minidual.demos.writer import EpisodeWriter
from minidual.errors import NothingEvaluatedError, UsageError
from minidual.gate.stage import StageContext
from minidual.plant.render import Camera, StampedImage
from minidual.plant.world import World
from minidual.robot.pair import DUAL_PANDA, Robot
from minidual.stages.registry import STAGES, TOOLS
from minidual.stages.teleop_record import READS, record_checks, recording_inputs, run
from minidual.tasks.catalogue import make_task
from minidual.trials.conditions import rooms
from tests.support.children import fork_child
from tests.support.recording_toys import TICKS, ToyRig, hang_in_conversion, job

pytestmark = pytest.mark.torch

CONFIG = Config()
SMALL = Config.model_validate({"scene": {"camera": {"width_px": 48, "height_px": 32}}})
"""An eighth of the pixels: to draw them took as long as control and physics together."""
GOOD: dict[str, float] = {
    "episodes": 120,
    "attempts": 121,
    "success_rate": 120 / 121,
    "schema_ok": True,
    "jerk_rms_max": 21.0,
    "sync_error_max_s": 0.0,
    "latency_p50_s": 0.0003,
    "latency_p99_s": 0.001,
    "lag_p50_s": 0.03,
    "lag_p99_s": 0.05,
    "episodes_per_min": 20.0,
    "recorded_per_min": 30.0,
    "recorded_ticks": 52200,
    "dataset_rows": 52200,
    "dataset_episodes": 120,
}


def _job(folder: Path, **teleop: Any) -> Job:
    settings = CONFIG.teleop.model_copy(update={"episodes_n": 2, **teleop})
    return Job(folder, make_task(SMALL), settings, CONFIG.arbiter, seed=11)


def test_good_numbers_pass() -> None:
    checks = record_checks(GOOD, TeleopConfig())
    assert all(c.passed for c in checks if c.op)
    assert {"episodes", "schema_ok", "jerk_rms_max", "latency_p99_s", "episodes_per_min"} <= {
        c.name for c in checks
    }


@pytest.mark.parametrize(
    ("check", "change"),
    [
        ("episodes", {"episodes": 119, "dataset_episodes": 119}),
        ("schema_ok", {"schema_ok": False}),
        ("jerk_rms_max", {"jerk_rms_max": 200.0}),
        ("jerk_rms_max", {"jerk_rms_max": float("nan")}),
        ("latency_p99_s", {"latency_p99_s": 0.11}),
        ("lag_p50_s", {"lag_p50_s": 0.11}),
        ("lag_p50_s", {"lag_p50_s": float("nan")}),
        ("episodes_per_min", {"episodes_per_min": 2.9}),
        ("sync_error_max_s", {"sync_error_max_s": 0.021}),
        ("sync_error_max_s", {"sync_error_max_s": float("nan")}),
        ("dataset_rows", {"dataset_rows": 52199}),
        ("dataset_episodes", {"dataset_episodes": 119}),
    ],
)
def test_each_check_can_fail(check: str, change: dict[str, Any]) -> None:
    checks = record_checks({**GOOD, **change}, TeleopConfig())
    assert {c.name for c in checks if c.passed is False} == {check}


def _contents(path: Path) -> dict[str, Any]:
    """Return every dataset and attribute of an HDF5 file."""
    found: dict[str, Any] = {}
    with h5py.File(path) as file:
        found["attributes"] = {k: str(v) for k, v in file.attrs.items()}
        file.visititems(
            lambda name, item: found.update(
                {name: item[()]} if isinstance(item, h5py.Dataset) else {},
            ),
        )
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
def recorded(
    tmp_path_factory: pytest.TempPathFactory,
    shared_model: None,
) -> tuple[Job, RecordedAttempts]:
    """Two demonstrations recorded in this process."""
    real = _job(tmp_path_factory.mktemp("recorded"))
    return real, record(real, workers=1)


def test_episodes_take_turns_in_the_rooms(
    tmp_path: Path,
    shared_model: None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each episode is led in a room of its own, the same for the same trial.

    Afterwards the model has its own look again.
    """
    job = dataclasses.replace(_job(tmp_path), rooms=rooms(["clean", "room"]))
    rig = Rig(job, ())
    look = lambda: (rig.world.model.geom_rgba.copy(), rig.world.model.cam_pos.copy())  # noqa: E731
    seen: list[Any] = []
    monkeypatch.setattr(rig.session, "run", lambda *_, **__: seen.append(look()))
    before = look()
    for index in (0, 1, 3, 1):
        rig.lead(job.trial(index), lambda *_: None)
    same = lambda a, b: all(map(np.array_equal, a, b))  # noqa: E731
    assert same(seen[0], before)
    assert same(seen[1], seen[3])
    assert not any(same(a, b) for a, b in [(seen[0], seen[1]), (seen[1], seen[2])])
    assert same(look(), before)


def test_an_episode_may_change_rooms(
    tmp_path: Path,
    shared_model: None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Every 0.2 s, ten ticks, the next room, drawn anew; at the end the model is as before."""
    job = _job(tmp_path)
    teleop = job.teleop.model_copy(update={"room_change_s": 0.2})
    job = dataclasses.replace(job, teleop=teleop, rooms=rooms(["clean", "room", "room"]))
    rig = Rig(job, ())
    look = lambda: rig.world.model.cam_pos.tobytes()  # noqa: E731
    seen: list[bytes] = []

    def run(*_given: Any, on_tick: Any) -> None:
        for _ in range(60):
            seen.append(look())
            on_tick(None)

    monkeypatch.setattr(rig.session, "run", run)
    before = look()
    rig.lead(job.trial(0), lambda *_: None)
    shown = [set(seen[k : k + 10]) for k in range(0, 60, 10)]
    assert all(len(stay) == 1 for stay in shown)
    assert [stay == {before} for stay in shown] == [True, False, False, True, False, False]
    assert len(set.union(*shown)) == 5
    assert look() == before


def test_the_goal_mark_stays_when_the_room_changes(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    job = _job(tmp_path)
    teleop = job.teleop.model_copy(update={"room_change_s": 0.2})
    rig = Rig(dataclasses.replace(job, teleop=teleop, rooms=rooms(["room", "clean", "room"])), ())
    goal = (0.5, -0.33, 0.2)
    trial = dataclasses.replace(job.trial(0), goal={job.task.carried: goal})
    seen: list[np.ndarray] = []

    def run(*_given: Any, on_tick: Any) -> None:
        rig.world.mark_goal(*goal)  # as `begin` does
        for _ in range(40):
            seen.append(rig.world.model.geom("goal_mark").pos[:2].copy())
            on_tick(None)

    monkeypatch.setattr(rig.session, "run", run)
    rig.lead(trial, lambda *_: None)
    assert np.array(seen) == pytest.approx(np.tile(goal[:2], (40, 1)))


def test_only_what_changes_the_model_can_be_recorded_under() -> None:
    with pytest.raises(
        UsageError,
        match=r"cannot be recorded under 'push \+x'; there are clean, .*room",
    ):
        rooms(["clean", "push +x"])
    with pytest.raises(UsageError, match=r"no condition 'rom'.*room"):
        rooms(["rom"])


def test_a_recording_holds_sound_demonstrations_only(
    recorded: tuple[Job, RecordedAttempts],
) -> None:
    real, recording = recorded
    assert [a.trial.index for a in recording.kept] == [0, 1]
    assert sorted(p.name for p in real.folder.rglob("*")) == [
        "000000.json",
        "000001.json",
        "attempts",
        "episode_000000.hdf5",
        "episode_000001.hdf5",
        "episodes",
        "rejected",
    ]
    for attempt in recording.kept:
        assert attempt.path is not None
        assert inspect_episode(attempt.path, cameras=("high",), robot=DUAL_PANDA)[1] == []
        episode = read_episode(attempt.path)
        assert episode.meta.success
        assert episode.meta.trial == attempt.trial.index
        assert episode.images["high"].shape == (len(episode), 32, 48, 3)
        assert episode.meta.extra["start_x_y_yaw"] == list(
            real.trial(attempt.trial.index).start["rod"],
        )
        assert set(np.unique(episode.action_gripper)) == {0.0, 1.0}
        assert 0.05 < episode.gripper.min() < 0.5 < episode.gripper.max() <= 1.001, (
            "measured openings, not commands"
        )
    rows = sum(len(read_episode(path, cameras=())) for path in [a.path for a in recording.kept])
    numbers = recording.numbers() | {"dataset_rows": rows, "dataset_episodes": 2}
    checks = record_checks(
        numbers,
        real.teleop.model_copy(update={"latency_max_s": 1.0, "episodes_per_min": 0.0}),
    )
    assert [c.sentence() for c in checks if c.passed is False] == []
    columns = list(recording.attempts[0].row())
    assert columns[:7] == [
        "trial",
        "start_x_m",
        "start_y_m",
        "start_yaw_rad",
        "success",
        "kept",
        "reason",
    ]


def test_faults_of_a_recording_reach_its_numbers(recorded: tuple[Job, RecordedAttempts]) -> None:
    first, second = recorded[1].attempts
    broken = dataclasses.replace(
        second,
        faults=("cameras_swapped: ...",),
        sync_error_max_s=float("nan"),
    )
    first, broken = (dataclasses.replace(a, wall_s=40.0) for a in (first, broken))
    numbers = RecordedAttempts((first, broken), workers=2).numbers(60.0)
    assert numbers["schema_ok"] is False
    assert np.isnan(numbers["sync_error_max_s"]), "an unknown value must not vanish"
    assert numbers["recorded_per_min"] == pytest.approx(3.0)
    assert numbers["episodes_per_min"] == pytest.approx(2.0), "whatever kept it waiting counts"
    before = dataclasses.replace(first, adopted=True)
    again = dataclasses.replace(broken, wall_s=0.0)
    numbers = RecordedAttempts((before, again), workers=1).numbers(20.0)
    assert numbers["episodes_per_min"] == pytest.approx(2.0), (
        "the time before an interruption counts, too"
    )


class _LateCamera(Camera):
    """Delivers the picture of 25 ms ago."""

    delay_s = 0.025

    def follow(self, world: World) -> None:
        """Keep each state of the world from here on."""
        self._states: list[tuple[float, np.ndarray]] = []
        self._past = mujoco.MjData(world.model)

        def keep(world: World) -> None:
            self._states.append((world.time, world.data.qpos.copy()))

        world.observer = keep

    def stamped(self, data: mujoco.MjData, camera: str) -> StampedImage:
        due_s = data.time - self.delay_s
        due = self._states[0]
        for state in self._states:
            if state[0] <= due_s + 1e-9:
                due = state
        time_s, qpos = due
        self._past.time = time_s
        self._past.qpos[:] = qpos
        mujoco.mj_forward(self._model, self._past)
        return super().stamped(self._past, camera)


@pytest.mark.parametrize(
    ("camera", "error_s", "failing"),
    [(Camera, 0.0, set()), (_LateCamera, 0.025, {"sync_error_max_s"})],
)
def test_a_camera_that_delivers_a_picture_of_25_ms_ago_fails_the_stage(
    recorded: tuple[Job, RecordedAttempts],
    tmp_path: Path,
    shared_model: None,
    monkeypatch: pytest.MonkeyPatch,
    camera: type[Camera],
    error_s: float,
    failing: set[str],
) -> None:
    """The beginning of an episode through the real renderer, session, writer and reader."""
    monkeypatch.setattr(teleop_rig, "Camera", camera)
    config = changed(SMALL, {"scene.task.time_limit_s": 1.2})
    settings = CONFIG.teleop.model_copy(update={"episodes_n": 1})
    rig = Rig(Job(tmp_path, make_task(config), settings, CONFIG.arbiter, seed=11), ("high",))
    if isinstance(rig._eye, _LateCamera):
        rig._eye.follow(rig.world)
    attempt = rig.record(0)
    rig.close()
    assert attempt.sync_error_max_s == pytest.approx(error_s)
    assert any("out_of_sync" in fault for fault in attempt.faults) == bool(failing)
    assert not attempt.kept, "the episode is cut"
    sound = recorded[1].kept[0]
    numbers = RecordedAttempts((sound, attempt), 1).numbers()
    checks = record_checks(
        GOOD | {"sync_error_max_s": numbers["sync_error_max_s"]},
        TeleopConfig(),
    )
    assert {c.name for c in checks if c.passed is False} == failing


def test_images_taken_after_the_joints_are_counted_and_refused(tmp_path: Path) -> None:
    """A camera that delivers 25 ms after the joints were read."""
    rig = ToyRig(job(tmp_path), ())
    rig.late_s = 0.025
    attempt = rig.record(0)
    sound = ToyRig(job(tmp_path / "sound"), ()).record(0)
    assert (attempt.success, attempt.kept, sound.kept) == (True, False, True)
    assert "out_of_sync" in attempt.reason
    late = RecordedAttempts((sound, attempt), 1).numbers()["sync_error_max_s"]
    assert late == pytest.approx(0.025)
    checks = record_checks(GOOD | {"sync_error_max_s": late}, TeleopConfig())
    assert {c.name for c in checks if c.passed is False} == {"sync_error_max_s"}


def test_a_file_that_reads_back_with_a_fault_is_no_demonstration(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real = EpisodeWriter.finish

    def corrupt(self: EpisodeWriter, **facts: Any) -> Path:
        path = real(self, **facts)
        path.write_bytes(path.read_bytes()[:-1000])
        return path

    monkeypatch.setattr(EpisodeWriter, "finish", corrupt)
    attempt = ToyRig(job(tmp_path), ()).record(0)
    assert (attempt.success, attempt.kept) == (True, False)
    assert "file_corrupt" in attempt.reason
    assert attempt.path == tmp_path / "rejected" / "episode_000000.hdf5"
    assert list(tmp_path.glob("*/*.hdf5")) == [attempt.path]


def test_failed_attempts_are_set_aside_with_their_reason(
    tmp_path: Path,
    shared_model: None,
) -> None:
    # Hands that close 12 cm beside the rod: nothing is lifted.
    rig = Rig(_job(tmp_path), ("high",))
    real = rig.world.reset

    def aside(q=None, *, poses):
        ((name, (x, y, yaw)),) = poses.items()
        real(q, poses={name: (x + 0.12, y, yaw)})

    rig.world.reset = aside  # type: ignore[method-assign]
    attempt = rig.record(0)
    rig.close()
    assert not attempt.success
    assert not attempt.kept
    assert "object not lifted (0 of 40 mm)" in attempt.reason
    assert attempt.path == tmp_path / "rejected" / "episode_000000.hdf5"
    meta = read_episode(attempt.path, cameras=()).meta
    assert not meta.success
    assert meta.extra["reason"] == attempt.reason
    assert not (tmp_path / "episodes").exists()


def _fake(patch: pytest.MonkeyPatch, outcomes: list[bool], calls: list[list[int]]) -> None:
    def in_workers(function: Any, indices: Any, workers: int) -> Any:
        calls.append(list(indices))
        yield from map(function, indices)

    def attempt(job: Job, index: int, observe: None) -> Attempt:
        good = outcomes[index]
        return Attempt(job.trial(index), good, "" if good else "held at 3.00 s: left hand")

    patch.setattr(teleop_recording, "in_workers", in_workers)
    patch.setattr(teleop_recording, "_record_in_worker", attempt)


def test_failures_are_made_up_for_in_a_way_that_no_worker_can_change(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    calls: list[list[int]] = []
    outcomes = [True, False, True, False, False, True, True]
    _fake(monkeypatch, outcomes, calls)
    recording = record(_job(tmp_path, episodes_n=4, attempts_max_ratio=2.0), workers=2)
    assert calls == [[0, 1, 2, 3], [4, 5], [6]]
    assert [a.trial.index for a in recording.kept] == [0, 2, 5, 6]


def test_attempts_are_bounded_and_their_commonest_reason_reported(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    calls: list[list[int]] = []
    _fake(monkeypatch, [False] * 50, calls)
    config = CONFIG.model_copy(
        update={"teleop": CONFIG.teleop.model_copy(update={"episodes_n": 4})},
    )
    with pytest.raises(
        NothingEvaluatedError,
        match=r"none of 6 attempts.*6 x held at 3\.00 s: left hand",
    ):
        run(StageContext(folder=tmp_path, config=config, seed=config.seed, profile="standard"))
    assert sum(map(len, calls)) == 6
    assert (tmp_path / "quality.csv").read_text().count("left hand") == 6


def test_a_recording_without_a_demonstration_is_set_aside_so_that_the_command_tries_again(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    toys: None,
) -> None:
    monkeypatch.setattr(ToyRig, "late_s", 1.0)
    config = CONFIG.model_copy(
        update={"teleop": CONFIG.teleop.model_copy(update={"episodes_n": 2})},
    )
    context = StageContext(
        folder=tmp_path / "tmp",
        config=config,
        seed=config.seed,
        profile="standard",
    )
    context.folder.mkdir()
    for earlier in (0, 1):
        assert len(list(tmp_path.glob("set-aside/*/attempts"))) == earlier
        with pytest.raises(NothingEvaluatedError, match=r"none of 3 attempts"):
            run(context)
    assert len(list(tmp_path.glob("set-aside/*/rejected/*.hdf5"))) == 6


def test_an_unknown_leader_is_refused_before_anything_is_built(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"(?s)no leader 'scriptd'.*did you mean 'scripted'"):
        record(_job(tmp_path, leader="scriptd"), workers=1)
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_recording_is_continued_to_the_bit(
    recorded: tuple[Job, RecordedAttempts],
    tmp_path: Path,
) -> None:
    """One episode is adopted, the other is recorded again by a worker process."""
    cut = _job(tmp_path / "again")
    shutil.copytree(recorded[0].folder, cut.folder)
    (cut.folder / "attempts" / "000000.json").unlink()
    (cut.folder / "episodes" / "episode_000000.hdf5").unlink()
    again = record(cut, workers=2)
    assert [a.adopted for a in again.attempts] == [False, True]
    for first, second in zip(recorded[1].kept, again.kept, strict=True):
        assert first.path is not None
        assert second.path is not None
        a = _contents(first.path)
        b = _contents(second.path)
        assert a.keys() == b.keys()
        for key, value in a.items():
            np.testing.assert_array_equal(value, b[key], err_msg=key)
        assert first.row() == second.row()
        assert len(second.latencies_s) == len(first.latencies_s), "the judged latencies survive too"


@pytest.fixture
def toys(monkeypatch: pytest.MonkeyPatch) -> None:
    """Record synthetic episodes."""
    monkeypatch.setattr(teleop_recording, "Rig", ToyRig)


def _files(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.glob("*/*.hdf5"))
    }


def _killed_after(seconds: float, job: Job) -> bool:
    """Record in a child process that is killed; return whether it ended before that."""
    child = fork_child(lambda: record(job, workers=1))
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_25_kills_at_random_instants_lose_no_finished_episode(tmp_path: Path, toys: None) -> None:
    whole = job(tmp_path / "whole", episodes_n=12)
    began = time.perf_counter()
    uninterrupted = record(whole, workers=1)
    lasts_s = time.perf_counter() - began
    assert [a.trial.index for a in uninterrupted.kept] == [0, 2, 3, 4, 6, 7, 8, 10, 11, 12, 14, 15]
    rng = np.random.default_rng(25)
    kills = 0
    rounds = 0
    interrupted = 0
    while kills < 25:
        cut = job(tmp_path / f"cut{rounds}", episodes_n=12)
        rounds = rounds + 1
        cut.folder.mkdir()
        finished: dict[Path, tuple[int, int]] = {}
        ended = False
        while not ended and kills < 25:
            claim(cut.folder, {"seed": 11}, "old")
            ended = _killed_after(rng.uniform(0.0, 0.3) * lasts_s, cut)
            kills = kills + 1
            interrupted += not ended
            now = {
                path: (path.stat().st_ino, path.stat().st_mtime_ns)
                for path in cut.folder.rglob("[!.]*.hdf5")
            }
            assert finished.items() <= now.items(), "a finished episode is never written again"
            finished = now
        claim(cut.folder, {"seed": 11}, "old")
        recording = record(cut, workers=1)
        assert [a.trial.index for a in recording.kept] == [
            a.trial.index for a in uninterrupted.kept
        ]
        assert [a.row() for a in recording.attempts] == [a.row() for a in uninterrupted.attempts]
        assert _files(cut.folder) == _files(whole.folder), "no half-written file either"
        adopted = {a.path for a in recording.attempts if a.adopted}
        assert set(finished) <= adopted
    assert interrupted > 15
    assert not (tmp_path / "set-aside").exists()


def test_a_damaged_file_is_set_aside_and_recorded_again(tmp_path: Path, toys: None) -> None:
    task = job(tmp_path, episodes_n=2)
    before = record(task, workers=1)
    wanted = _files(tmp_path)
    victim = tmp_path / "episodes" / "episode_000000.hdf5"
    victim.write_bytes(victim.read_bytes()[:-500])
    again = record(task, workers=1)
    assert [a.adopted for a in again.attempts] == [False, True, True]
    assert [a.row() for a in again.attempts] == [a.row() for a in before.attempts]
    assert _files(tmp_path) == wanted
    assert len(list((tmp_path / "episodes" / "set-aside").glob("episode_000000.hdf5-*"))) == 1


@pytest.mark.parametrize(
    "content",
    [b"", b"\xff{", b"[1]", b'{"success": true, "path": "../../elsewhere"}'],
)
def test_a_damaged_attempt_is_set_aside_with_its_episode_and_recorded_again(
    tmp_path: Path,
    toys: None,
    content: bytes,
) -> None:
    task = job(tmp_path, episodes_n=2)
    before = record(task, workers=1)
    wanted = _files(tmp_path)
    (tmp_path / "attempts" / "000000.json").write_bytes(content)
    again = record(task, workers=1)
    assert [a.adopted for a in again.attempts] == [False, True, True]
    assert [a.row() for a in again.attempts] == [a.row() for a in before.attempts]
    assert _files(tmp_path) == wanted
    assert len(list(tmp_path.glob("attempts/set-aside/000000.json-*"))) == 1
    assert len(list(tmp_path.glob("*/set-aside/episode_000000.hdf5-*"))) == 1


@pytest.mark.parametrize("content", [b"", b"\xff{", b"[1]"])
def test_damaged_inputs_set_the_recording_aside(tmp_path: Path, toys: None, content: bytes) -> None:
    folder = tmp_path / "work"
    folder.mkdir()
    claim(folder, {"seed": 1}, "old")
    record(job(folder, episodes_n=1), workers=1)
    (folder / "inputs.json").write_bytes(content)
    assert "was moved to" in claim(folder, {"seed": 1}, "old")
    assert not (folder / "episodes").exists()
    assert claim(folder, {"seed": 1}, "old") == ""


def test_a_recording_of_other_inputs_is_set_aside_and_named(tmp_path: Path, toys: None) -> None:
    folder = tmp_path / "new"
    folder.mkdir()
    assert claim(folder, {"seed": 1, "code": {"a": "1"}}, "old") == ""
    record(job(folder, episodes_n=1), workers=1)
    episodes = _files(folder)
    note = claim(folder, {"seed": 1, "code": {"a": "2"}}, "old")
    (aside,) = (tmp_path / "set-aside").iterdir()
    assert note == f"an interrupted recording with other inputs (code) was moved to {aside}"
    assert [path.name for path in folder.iterdir()] == ["inputs.json"]
    assert _files(aside) == episodes
    left = folder / "rejected" / ".episode_000009.hdf5.999999999.partial"
    left.parent.mkdir()
    left.touch()
    note = claim(folder, {"seed": 1, "code": {"a": "2"}}, "old")
    assert (
        "demonstrations so far: 0; "
        "removed .episode_000009.hdf5.999999999.partial, which is half-written" in note
    )
    assert not left.exists()


def test_what_determines_a_recording_is_what_its_verdict_depends_on() -> None:
    inputs = recording_inputs(CONFIG)
    entry = STAGES["teleop-record"]
    assert set(entry.parameters(CONFIG)) == set(READS) == inputs.keys() - {"seed", "code"}
    assert entry.keeps == PARTS
    assert {"minidual.demos.session", "minidual.skills.operator", "minidual.plant.world"} <= inputs[
        "code"
    ].keys()
    assert not any(name.startswith("minidual.show") for name in inputs["code"]), (
        "a new figure changes no episode"
    )


def test_a_recording_depends_on_the_planner_of_its_leader(tmp_path: Path) -> None:
    """A handover is demonstrated as it is planned: one with other settings is another recording."""
    other = changed(CONFIG, {"plan.planner.padding_m": 0.01, "plan.queries_n": 7})
    claim(tmp_path, recording_inputs(CONFIG), "old")
    (tmp_path / "episodes").mkdir()
    assert "is continued" in claim(
        tmp_path,
        recording_inputs(changed(CONFIG, {"plan.queries_n": 7})),
        "old",
    )
    assert "with other inputs (plan.planner)" in claim(tmp_path, recording_inputs(other), "old")


_TYPED = (
    "teleop-record --profile smoke --episodes 3 --workers 1 "
    "--set teleop.episodes_per_min=0 --waive-gate toy --runs-dir"
)


def _wait_for(folder: Path, pattern: str) -> None:
    deadline = time.monotonic() + 120.0
    while not list(folder.glob(pattern)):
        assert time.monotonic() < deadline, f"no {pattern} in {folder}"
        time.sleep(0.02)


def test_the_command_typed_again_after_a_kill_goes_on(
    tmp_path: Path,
    toys: None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Killed in the fourth trial, then while the dataset is made."""
    folder, published = (
        tmp_path / "smoke" / name for name in (".teleop-record.tmp", "teleop-record")
    )
    typed = [*_TYPED.split(), str(tmp_path)]
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.support.recording_toys", *typed],
        env={**os.environ, "HANG_AT": "3"},
        stderr=subprocess.DEVNULL,
    )
    _wait_for(folder, "episodes/episode_000002.hdf5")
    process.kill()
    process.wait()
    finished = {
        path.name: path.stat().st_mtime_ns for path in sorted(folder.glob("episodes/*.hdf5"))
    }
    assert list(finished) == ["episode_000000.hdf5", "episode_000002.hdf5"]

    monkeypatch.setattr(
        "minidual.stages.teleop_record.film_demonstration",
        lambda job, index, path: path.touch(),
    )

    def hang() -> None:
        monkeypatch.setattr("minidual.demos.lerobot_adapter.convert", hang_in_conversion)
        run_command_line(typed, STAGES, TOOLS)

    child = fork_child(hang)
    _wait_for(folder, f".lerobot.{child}.partial")
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)

    assert run_command_line(typed, STAGES, TOOLS) == 0
    assert "continued: demonstrations so far: 3" in capsys.readouterr().err
    now = {path.name: path.stat().st_mtime_ns for path in sorted(published.glob("episodes/*.hdf5"))}
    assert list(now) == ["episode_000000.hdf5", "episode_000002.hdf5", "episode_000003.hdf5"]
    assert finished.items() < now.items()
    assert len(read_dataset(published / "lerobot")) == 3 * TICKS
    assert not folder.exists()
    assert [path.name for path in published.iterdir() if path.name.startswith(".")] == []
