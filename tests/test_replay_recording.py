"""A recording repeats to the bit; a changed one does not and says where; a damaged one is one clear message."""

from __future__ import annotations

import json
import zipfile

import av
import numpy as np
import pytest
from panda import DOF, HOME

from minidual.cli.app import run_command_line
from minidual.config.supervisor import SupervisorConfig
from minidual.control.loop import JointLoop
from minidual.control.reflexes import ReflexError
from minidual.control.supervisor import Supervisor, dumping
from minidual.errors import DataError, UsageError
from minidual.plant import recording as module
from minidual.plant.recorder import Recorder
from minidual.plant.recording import read_recording, write_recording
from minidual.plant.replay import replay
from minidual.plant.world import SimulationDivergedError, World
from minidual.robot.arms import ARM_MODELS
from minidual.robot.pair import Robot
from minidual.stages.registry import STAGES, TOOLS

STEPS = 700


def move(world, kinematics, steps=STEPS, **kept):
    """Drive the arms, close the hands, push the rod; return the recorder."""
    world.reset()
    world.recorder = Recorder(world, seed=5, **kept)
    loop = JointLoop(world, kinematics)
    rod = world.model.body("rod").id
    target = HOME + 0.3 * np.eye(DOF)[3]
    for k in range(steps):
        world.data.xfrc_applied[rod, 1] = 3.0 if 300 <= k < 350 else 0.0
        loop.step(target, np.array([0.0, 1.0]))
    world.data.xfrc_applied[:] = 0.0
    return world.recorder


def stand(loop, steps):
    for _ in range(steps):
        loop.step(HOME, np.ones(2))


def speed_up(loop):
    """Accelerate a wrist for ever."""
    wrist = np.eye(DOF)[6]
    for k in range(1500):
        t = 1e-3 * k
        loop.follow(HOME + 2.0 * t**2 * wrist, 4.0 * t * wrist, 4.0 * wrist, np.ones(2))


@pytest.fixture(scope="module")
def trial(tmp_path_factory, scene, compiled_model):
    from minidual.robot.kinematics import Kinematics

    world = World(scene, model=compiled_model)
    path = tmp_path_factory.mktemp("replay") / "trial.npz"
    recorder = move(world, Kinematics())
    write_recording(path, recorder.recording("a test", details={"index": 3}))
    return path, world.q, world.object_pose()


class TestRepeating:
    def test_a_trial_repeats_to_the_bit(self, trial):
        path, q_end, T_end = trial
        recorded = read_recording(path)
        assert (recorded.steps, recorded.seed, recorded.kind) == (STEPS, 5, "trial")
        assert recorded.details == {"index": 3}
        ends = []
        found = replay(recorded, on_step=lambda world: ends.append((world.q, world.object_pose())))
        assert found.exact
        assert found.largest_deviation == 0.0
        assert found.compared == len(recorded.keyframes) - 1 == STEPS // 100  # the start agrees by itself
        assert found.first == ()
        assert (found.from_s, found.to_s) == (0.0, pytest.approx(0.7))
        assert (ends[-1][0] == q_end).all()
        assert (ends[-1][1] == T_end).all()

    def test_it_may_begin_and_end_in_the_middle(self, trial):
        path, *_ = trial
        found = replay(read_recording(path), from_s=0.33, to_s=0.5)
        assert found.from_s == pytest.approx(0.3)  # the keyframe before
        assert found.to_s == pytest.approx(0.5)
        assert found.exact
        for times in ({"from_s": -0.1}, {"to_s": 0.9}, {"from_s": 0.5, "to_s": 0.5}):
            with pytest.raises(UsageError, match=r"runs from 0\.000 s to 0\.700 s"):
                replay(read_recording(path), **times)

    def test_it_runs_on_the_arm_that_it_was_made_with(self, scene, tmp_path):
        robot = Robot(ARM_MODELS["ur5"])
        world = World(scene, robot)
        recorder = Recorder(world)
        world.recorder, tau = recorder, np.linspace(-5.0, 5.0, robot.dof)
        for _ in range(150):
            world.command(tau, np.zeros(2))
            world.step()
        recorded = read_recording(write_recording(tmp_path / "ur5.npz", recorder.recording("another arm")))
        assert recorded.arm == "ur5"
        assert replay(recorded).exact

    def test_the_push_is_part_of_it(self, trial):
        recorded = read_recording(trial[0])
        assert recorded.push_steps.tolist() == [300, 350]
        without = module.Recording(**{**vars(recorded), "pushes": np.zeros_like(recorded.pushes)})
        off = replay(without).deviates
        assert off.time_s == pytest.approx(0.4)
        assert "rod_free" in off.what
        assert off.size > 1e-3

    def test_a_changed_control_is_found_with_its_joint(self, trial):
        recorded = read_recording(trial[0])
        controls = recorded.controls.copy()
        controls[450, 4] += 1e-6
        found = replay(module.Recording(**{**vars(recorded), "controls": controls}))
        assert not found.exact
        assert found.deviates.time_s == pytest.approx(0.5)
        assert "panda_joint" in found.deviates.what
        assert 0.0 < found.largest_deviation < 1e-3

    def test_a_change_in_the_last_step_is_seen(self, trial):
        recorded = read_recording(trial[0])
        assert recorded.keyframe_steps[-1] == STEPS
        controls = recorded.controls.copy()
        controls[-1, 4] += 1e-3
        found = replay(module.Recording(**{**vars(recorded), "controls": controls}))
        assert not found.exact
        assert found.deviates.time_s == pytest.approx(0.7)
        assert "left_panda_joint5" in found.deviates.what

    def test_a_file_without_a_last_state_is_read_and_its_end_is_not_claimed(self, trial, tmp_path):
        recorded = read_recording(trial[0])
        before = {"keyframe_steps": recorded.keyframe_steps[:-1], "keyframes": recorded.keyframes[:-1]}
        path = write_recording(tmp_path / "old.npz", module.Recording(**{**vars(recorded), **before}))
        found = replay(read_recording(path))
        assert found.exact
        assert found.compared == STEPS // 100 - 1
        assert replay(read_recording(path), from_s=0.65).compared == 0

    def test_where_nothing_was_compared_nothing_is_exact(self, trial):
        found = replay(read_recording(trial[0]), from_s=0.31, to_s=0.39)
        assert found.compared == 0
        assert found.deviates is None
        assert not found.exact

    def test_a_world_that_was_reset_leaves_no_last_state(self, world, kinematics):
        recorder = move(world, kinematics, 150)
        world.reset()
        recorded = recorder.recording("after the reset")
        assert recorded.keyframe_steps.tolist() == [0, 100]
        assert replay(recorded).exact

    def test_a_state_that_was_written_between_steps_is_found(self, world, kinematics):
        recorder = move(world, kinematics, 150)
        world.data.qpos[world.joints.qpos[0]] += 0.01
        for _ in range(100):
            world.step()
        found = replay(recorder.recording("tampered"))
        assert found.deviates.time_s == pytest.approx(0.2)
        assert found.largest_deviation > 0.005

    def test_a_changed_model_is_kept_with_it(self, scene, kinematics):
        from minidual.plant.model import build_model

        heavy = World(scene, model=build_model(scene, visuals=False))
        heavy.model.body_mass[heavy.model.body("rod").id] *= 2.0
        found = replay(move(heavy, kinematics, 200).recording("heavy"))
        assert found.exact
        assert found.model_changed == ("body_mass",)

    def test_a_visual_model_gives_the_same_recording(self, visual_world, kinematics, trial):
        found = replay(move(visual_world, kinematics, 200).recording("seen"))
        assert found.exact
        assert found.model_changed == ()

    def test_the_window_keeps_the_last_second_and_still_repeats(self, world, kinematics):
        recorder = move(world, kinematics, 1730, window_s=0.5)
        last = recorder.recording("window", kind="dump")
        assert 480 <= last.steps <= 500
        assert last.end_s == pytest.approx(1.730)
        found = replay(last)
        assert found.exact
        assert found.compared >= 24

    def test_a_reset_begins_anew(self, world, kinematics):
        recorder = move(world, kinematics, 50)
        world.reset()
        for _ in range(30):
            world.step()
        recorded = recorder.recording("after the reset")
        assert recorded.steps == 30
        assert replay(recorded).exact


class TestDumps:
    def test_nan_is_dumped_and_the_replay_names_the_motor(self, world, kinematics, tmp_path, quiet_mujoco):
        world.recorder = Recorder(world, window_s=1.0, folder=tmp_path)
        loop = JointLoop(world, kinematics)
        torque, tick = loop.controller.torque, iter(range(10_000))

        def fails(*state):
            tau = torque(*state)
            tau[9] = np.nan if next(tick) == 1234 else tau[9]
            return tau

        loop.controller.torque = fails
        with pytest.raises(SimulationDivergedError, match="commands not finite") as caught:
            stand(loop, 2000)
        path = next(tmp_path.iterdir())
        assert f"minidual replay {path}" in caught.value.remedy
        assert path.stat().st_size < 2 * 2**20
        dump = read_recording(path)
        assert 980 <= dump.steps <= 1000
        found = replay(dump)
        assert found.exact
        assert found.ended == "the command of right_panda_joint3_motor is not finite at 1.234 s"

    def test_an_exploding_state_is_dumped_and_what_came_first_is_named(self, world, kinematics, tmp_path, quiet_mujoco):
        world.recorder = Recorder(world, window_s=1.0, folder=tmp_path)
        loop = JointLoop(world, kinematics)
        stand(loop, 100)
        world.data.qvel[world.joints.qvel[2]] = 1e12
        with pytest.raises(SimulationDivergedError):
            stand(loop, 100)
        found = replay(read_recording(next(tmp_path.iterdir())))
        assert not found.exact  # somebody wrote into the state, and that is what it says
        assert found.deviates.what in ("velocity of left_panda_joint3", "position of left_panda_joint3")

    def test_a_reflex_writes_its_last_second(self, world, kinematics, tmp_path):
        world.recorder = Recorder(world, window_s=1.0, folder=tmp_path)
        supervisor = Supervisor(SupervisorConfig(), on_reflex=dumping(world.recorder))
        loop = JointLoop(world, kinematics)
        world_command = world.command
        world.command = lambda tau, fingers: world_command(supervisor.guard(world.time, world.q, world.v, tau), fingers)
        with pytest.raises(ReflexError) as caught:
            speed_up(loop)
        path = caught.value.dump
        assert path is not None
        assert path.name.startswith("joint_velocity-")
        dump = read_recording(path)
        assert dump.reason == caught.value.reflex.text
        assert replay(dump).exact
        assert supervisor.reflex is not None

    def test_two_dumps_do_not_overwrite_each_other(self, world, kinematics, tmp_path):
        recorder = move(world, kinematics, 30, folder=tmp_path)
        assert recorder.dump("same", "first") != recorder.dump("same", "second")
        assert len(list(tmp_path.iterdir())) == 2

    def test_a_full_disk_does_not_stop_the_stop(self, world, kinematics, tmp_path, monkeypatch):
        recorder = move(world, kinematics, 30, folder=tmp_path)

        def full(*_args):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("minidual.plant.recorder.write_recording", full)
        assert recorder.dump("reflex", "why") is None
        assert "No space" in str(recorder.write_error)

    def test_without_a_folder_nothing_is_written(self, world, kinematics):
        assert move(world, kinematics, 30).dump("reflex", "why") is None


class TestFiles:
    def test_every_number_comes_back_to_the_bit(self, trial, tmp_path):
        recorded = read_recording(trial[0])
        controls = recorded.controls.copy()
        controls[3, :3] = np.nan, np.inf, -0.0
        controls[4, :3] = 5e-324, 1.7e308, -1e-300
        path = write_recording(tmp_path / "odd.npz", module.Recording(**{**vars(recorded), "controls": controls}))
        restored = read_recording(path).controls
        assert (restored.view(np.uint64) == controls.view(np.uint64)).all()

    def test_a_carry_takes_about_a_megabyte(self, trial):
        path, *_ = trial
        assert path.stat().st_size < 2**20 / 7.0 * 1.5  # 0.7 s; at most 1.5 MB for 7 s

    def test_nothing_else_is_left_beside_the_file(self, trial):
        assert [p.name for p in trial[0].parent.iterdir()] == ["trial.npz"]

    @pytest.mark.parametrize("keep", [0, 10, 1000, 0.5, 0.999])
    def test_a_truncated_file_is_one_message(self, trial, tmp_path, keep):
        content = trial[0].read_bytes()
        cut = tmp_path / "cut.npz"
        cut.write_bytes(content[: round(keep * len(content)) if isinstance(keep, float) else keep])
        with pytest.raises(DataError, match=r"cut\.npz is no whole recording"):
            read_recording(cut)

    def test_flipped_bytes_are_noticed(self, trial, tmp_path):
        content = trial[0].read_bytes()
        rng = np.random.default_rng(1)
        harmless, messages = 0, []
        for _ in range(40):
            damaged = bytearray(content)
            damaged[int(rng.integers(len(content)))] ^= 0xFF
            path = tmp_path / "damaged.npz"
            path.write_bytes(damaged)
            try:
                read_recording(path)
                harmless += 1  # names and dates inside the archive are not covered by its check sums
            except DataError as error:
                messages.append(error.message)
        assert harmless < 10
        assert all("damaged.npz" in message for message in messages)

    def test_foreign_files_are_told_apart(self, trial, tmp_path):
        foreign = tmp_path / "foreign.npz"
        np.savez(foreign, weights=np.zeros(3))
        with pytest.raises(DataError, match="no recording: it lacks 'header'"):
            read_recording(foreign)
        np.savez(foreign, header=np.frombuffer(b'{"format": "other", "version": 2}', np.uint8))
        with pytest.raises(DataError, match="its format is 'other'"):
            read_recording(foreign)
        np.savez(foreign, header=np.frombuffer(b"not json", np.uint8))
        with pytest.raises(DataError, match="no whole recording: Expecting value"):
            read_recording(foreign)
        with pytest.raises(DataError, match="there is no file"):
            read_recording(tmp_path / "missing.npz")

    def test_a_pickle_inside_is_not_opened(self, tmp_path):
        path = tmp_path / "evil.npz"
        np.savez(path, header=np.array([{"format": "minidual-recording"}], dtype=object))
        with pytest.raises(DataError, match="no whole recording: Object arrays"):
            read_recording(path)

    def test_another_version_of_the_format_is_named(self, trial, tmp_path):
        path = edit_header(trial[0], tmp_path, version=99)
        with pytest.raises(DataError, match="version 99 of the format; this minidual reads version 2") as caught:
            read_recording(path)
        assert "minidual 0." in caught.value.remedy

    def test_a_scene_of_another_version_is_named(self, trial, tmp_path):
        path = edit_header(trial[0], tmp_path, scene={"planet": "Mars"})
        with pytest.raises(DataError, match="a scene that this version does not know"):
            read_recording(path)

    def test_another_robot_is_refused(self, trial):
        recorded = read_recording(trial[0])
        other = module.Recording(**{**vars(recorded), "model": {**recorded.model, "body_mass": np.ones(7)}})
        with pytest.raises(DataError, match="body_mass has shape"):
            replay(other)


def edit_header(path, folder, **changes):
    """Write a copy of a recording whose header says something else."""
    with np.load(path) as stored:
        arrays = dict(stored)
    header = json.loads(arrays["header"].tobytes()) | changes
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), np.uint8)
    edited = folder / "edited.npz"
    np.savez(edited, **arrays)
    return edited


class TestCommand:
    @pytest.fixture
    def run(self, tmp_path, capsys):
        def call(*words):
            code = run_command_line(["replay", *map(str, words), "--runs-dir", str(tmp_path)], STAGES, TOOLS)
            return code, *capsys.readouterr()

        return call

    def test_it_says_that_it_repeats(self, run, trial, tmp_path):
        code, out, _ = run(trial[0])
        assert code == 0
        assert "repeats   to the bit, at 7 of 7 check points" in out
        assert "nothing went out of bounds" in out
        assert "mujoco 4." in out
        assert list(tmp_path.iterdir()) == []  # it looks, it does not write

    def test_it_shows_the_tick_of_the_reflex_though_the_motors_never_saw_it(self, run, world, kinematics, tmp_path):
        recorder = move(world, kinematics, 150, folder=tmp_path / "dumps")
        supervisor = Supervisor(SupervisorConfig(), on_reflex=dumping(recorder))
        tau = np.full(14, 0.25)
        tau[4] = np.nan
        with pytest.raises(ReflexError) as caught:
            supervisor.guard(world.time, world.q, world.v, tau)
        assert "FILE" not in caught.value.remedy
        assert str(caught.value.dump) in caught.value.remedy
        code, out, _ = run(caught.value.dump)
        assert code == 0
        assert "nothing went out of bounds" in out
        assert f"asked_torque_nm: {'0.25 ' * 4}nan{' 0.25' * 9}\n" in out
        assert read_recording(caught.value.dump).details["measured_position_rad"] == world.q.tolist()

    def test_it_says_that_nothing_was_compared(self, run, trial):
        code, out, _ = run(trial[0], "--from-s", "0.31", "--to-s", "0.39")
        assert code == 0
        assert "repeats   nothing compared" in out
        assert "to the bit" not in out

    def test_json_is_one_document(self, run, trial):
        code, out, _ = run(trial[0], "--from-s", "0.2", "--json")
        document = json.loads(out)
        assert code == 0
        assert document["exact"] is True
        assert document["from_s"] == pytest.approx(0.2)
        assert document["details"] == {"index": 3}

    def test_physics_that_does_not_repeat_exits_1_and_another_version_explains_it(self, run, trial, tmp_path):
        recorded = read_recording(trial[0])
        controls = recorded.controls.copy()
        controls[450, 4] += 1e-3
        changed = {**vars(recorded), "controls": controls}
        path = write_recording(tmp_path / "changed.npz", module.Recording(**changed))
        code, out, _ = run(path)
        assert code == 1
        assert "repeats   no: " in out
        changed["libraries"] = {**recorded.libraries, "mujoco": "3.9.0"}
        path = write_recording(tmp_path / "older.npz", module.Recording(**changed))
        code, out, _ = run(path)
        assert code == 0
        assert "mujoco: was 3.9.0, is 4." in out
        assert "another version may round differently" in out

    def test_wrong_files_and_options_exit_2(self, run, trial, tmp_path):
        broken = tmp_path / "broken.npz"
        broken.write_bytes(trial[0].read_bytes()[:5000])
        assert run(broken)[0] == 2
        assert run(tmp_path / "missing.npz")[0] == 2
        for words in (
            ("--video", "film.avi"),
            ("--picture", tmp_path / "no" / "p.png"),
            ("--camera", "left eye"),
            ("--frames", "0"),
            ("--slowdown", "1e9"),
            ("--from-s", "5"),
        ):
            code, out, err = run(trial[0], *words)
            assert (code, out) == (2, "")
            assert err.startswith("minidual: ")

    def test_it_draws_a_film_and_a_sheet(self, run, trial, tmp_path):
        film, sheet = tmp_path / "film.mp4", tmp_path / "sheet.png"
        words = ("--from-s", "0.4", "--to-s", "0.6", "--slowdown", "2", "--frames", "3")
        assert run(trial[0], *words, "--video", film, "--picture", sheet)[0] == 0
        with av.open(str(film)) as container:
            assert len(list(container.decode(video=0))) == 11
        assert sheet.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
        assert not zipfile.is_zipfile(sheet)
