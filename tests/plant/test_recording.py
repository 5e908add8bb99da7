"""A recording repeats to the bit; a changed one says where it differs; a damaged one is refused."""

from __future__ import annotations

import json
import zipfile
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import av
import numpy as np
import pytest

from minidual.cli.app import run_command_line
from minidual.config.control import SupervisorConfig
from minidual.config.scene import ObstacleConfig
from minidual.control.joint_control import JointLoop
from minidual.control.measurement import Reader
from minidual.control.reflexes import ReflexError
from minidual.control.supervisor import Supervisor, dumping
from minidual.errors import DataError, UsageError
from minidual.plant import recording as module
from minidual.plant.recorder import Recorder
from minidual.plant.recording import read_recording, write_recording
from minidual.plant.replay import replay
from minidual.plant.world import SimulationDivergedError, World
from minidual.robot.kinematics import Kinematics
from minidual.robot.models import ARM_MODELS
from minidual.robot.pair import Robot
from minidual.show.figures.film import FILM_FPS
from minidual.stages.registry import STAGES, TOOLS
from tests.support import replay_mutations
from tests.support.panda import DOF, HOME
from tests.support.replay_mutations import mutate, write

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
        assert (
            found.compared == len(recorded.keyframes) - 1 == STEPS // 100
        )  # the start agrees by itself
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
        world.recorder = recorder
        tau = np.linspace(-5.0, 5.0, robot.dof)
        for _ in range(150):
            world.command(tau, np.zeros(2))
            world.step()
        recorded = read_recording(
            write_recording(tmp_path / "ur5.npz", recorder.recording("another arm")),
        )
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
        before = {
            "keyframe_steps": recorded.keyframe_steps[:-1],
            "keyframes": recorded.keyframes[:-1],
        }
        path = write_recording(
            tmp_path / "old.npz",
            module.Recording(**{**vars(recorded), **before}),
        )
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
    def test_nan_is_dumped_and_the_replay_names_the_motor(
        self,
        world,
        kinematics,
        tmp_path,
        quiet_mujoco,
    ):
        world.recorder = Recorder(world, window_s=1.0, folder=tmp_path)
        loop = JointLoop(world, kinematics)
        torque = loop.controller.torque
        tick = iter(range(10_000))

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

    def test_an_exploding_state_is_dumped_and_what_came_first_is_named(
        self,
        world,
        kinematics,
        tmp_path,
        quiet_mujoco,
    ):
        world.recorder = Recorder(world, window_s=1.0, folder=tmp_path)
        loop = JointLoop(world, kinematics)
        stand(loop, 100)
        world.data.qvel[world.joints.qvel[2]] = 1e12
        with pytest.raises(SimulationDivergedError):
            stand(loop, 100)
        found = replay(read_recording(next(tmp_path.iterdir())))
        assert not found.exact  # somebody wrote into the state, and that is what it says
        assert found.deviates.what in (
            "velocity of left_panda_joint3",
            "position of left_panda_joint3",
        )

    def test_a_reflex_writes_its_last_second(self, world, kinematics, tmp_path):
        world.recorder = Recorder(world, window_s=1.0, folder=tmp_path)
        supervisor = Supervisor(SupervisorConfig(), on_reflex=dumping(world.recorder))
        loop = JointLoop(world, kinematics)
        world_command = world.command
        world.command = lambda tau, fingers: world_command(
            supervisor.guard(
                Reader(world, supervisor.config).reset(), tau, Kinematics().gravity(world.q)
            ),
            fingers,
        )
        with pytest.raises(ReflexError) as caught:
            speed_up(loop)
        supervisor.tell(caught.value)
        path = caught.value.dump
        assert path is not None
        assert path.name.startswith("speed.joint-")
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
        path = write_recording(
            tmp_path / "odd.npz",
            module.Recording(**{**vars(recorded), "controls": controls}),
        )
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
        harmless = 0
        messages = []
        for _ in range(40):
            damaged = bytearray(content)
            damaged[int(rng.integers(len(content)))] ^= 0xFF
            path = tmp_path / "damaged.npz"
            path.write_bytes(damaged)
            try:
                read_recording(path)
                harmless += (
                    1  # names and dates inside the archive are not covered by its check sums
                )
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
        with pytest.raises(
            DataError,
            match="version 99 of the format; this minidual reads version 3",
        ) as caught:
            read_recording(path)
        assert "minidual 0." in caught.value.remedy

    def test_a_scene_of_another_version_is_named(self, trial, tmp_path):
        path = edit_header(trial[0], tmp_path, scene={"planet": "Mars"})
        with pytest.raises(
            DataError,
            match=r"values that this version does not know: scene\.planet",
        ):
            read_recording(path)

    def test_another_robot_is_refused(self, trial):
        recorded = read_recording(trial[0])
        other = module.Recording(
            **{**vars(recorded), "model": {**recorded.model, "body_mass": np.ones(7)}},
        )
        with pytest.raises(DataError, match="body_mass has shape"):
            replay(other)


class TestHostileFiles:
    @pytest.mark.parametrize(
        ("field", "value", "said"),
        [
            ("opt.cone", 9.0, "opt.cone is 9; it must be one of 0, 1"),  # a SIGSEGV
            ("opt.cone", 0.5, "opt.cone is 0.5"),
            ("opt.integrator", 7.0, "opt.integrator is 7; it must be one of 0, 1, 2, 3, 4"),
            ("opt.solver", -1.0, "opt.solver is -1"),
            ("opt.iterations", 1e9, "opt.iterations is 1e[+]09"),
            ("opt.timestep", 0.0, "opt.timestep is 0; it must be the scene's 0.001"),
            ("opt.timestep", np.nan, "opt.timestep is nan"),
            ("opt.tolerance", np.inf, "opt.tolerance is inf"),
            ("opt.gravity", np.nan, "opt.gravity is nan"),
            ("body_mass", np.nan, "body_mass is nan; it must be from 0 to 1e[+]10"),
            ("body_mass", -1.0, "body_mass is -1"),
            ("body_inertia", 1e300, "body_inertia is 1e[+]300"),
            ("geom_condim", 5.0, "geom_condim is 5; it must be one of 1, 3, 4, 6"),
            ("geom_size", -0.1, "geom_size is -0.1"),
            ("actuator_gainprm", np.inf, "actuator_gainprm is inf"),
        ],
    )
    def test_physics_that_no_model_has_is_refused_by_name(self, trial, field, value, said):
        recorded = read_recording(trial[0])
        values = recorded.model[field].copy()
        values.flat[-1] = value
        changed = module.Recording(**{**vars(recorded), "model": {**recorded.model, field: values}})
        with pytest.raises(DataError, match=f"the recording's {said}"):
            replay(changed)

    def test_a_change_that_physics_allows_is_told_by_the_digest(self, trial, tmp_path):
        """Every array and the header, changed as little as possible: only the digest shows it."""
        with np.load(trial[0]) as stored:
            arrays = dict(stored)
        read = []
        for name, values in arrays.items():
            bytes_ = bytearray(values.tobytes())
            bytes_[len(bytes_) // 2] ^= 1
            changed = np.frombuffer(bytes(bytes_), values.dtype).reshape(values.shape)
            np.savez(tmp_path / "changed.npz", **{**arrays, name: changed})
            with pytest.raises(DataError, match=r"changed\.npz"):
                read_recording(tmp_path / "changed.npz")
            read.append(name)
        assert {
            "controls",
            "keyframes",
            "pushes",
            "header",
            "digest",
            "model.body_mass",
            "model.opt.cone",
        } <= {*read}
        np.savez(tmp_path / "changed.npz", **{**arrays, "model.opt.cone": np.array(0.0)})
        with pytest.raises(DataError, match="its content does not fit its digest") as caught:
            read_recording(tmp_path / "changed.npz")
        assert "record it again" in caught.value.remedy
        del arrays["digest"]
        np.savez(tmp_path / "changed.npz", **arrays)
        with pytest.raises(DataError, match="it lacks 'digest'"):
            read_recording(tmp_path / "changed.npz")

    @pytest.mark.parametrize(
        ("name", "change", "said"),
        [
            ("controls", lambda a: a[:0], "lacks controls"),
            ("controls", lambda a: a.astype(np.complex128), "controls is 2-dimensional complex128"),
            ("controls", lambda a: a[:, None], "controls is 3-dimensional"),
            ("keyframe_steps", lambda a: a[:0], "or the state before the first"),
            (
                "keyframe_steps",
                lambda a: np.r_[a[:1], a[:0:-1]],
                "its keyframe steps do not grow from 0 to 700",
            ),
            ("keyframe_steps", lambda a: np.r_[a[:-1], 2**62], "its keyframe steps do not grow"),
            ("keyframes", lambda a: a[1:], "one for each of 7 rows"),
            ("keyframes", lambda a: a[:, :0], "lacks controls, or the state before the first"),
            (
                "keyframes",
                lambda a: a * 1e300,
                "the times of its keyframes are not 0.001 s a step apart",
            ),
            ("push_steps", lambda a: a - 1000, "its push steps do not grow"),
            ("pushes", lambda a: a[..., 0], "pushes is 2-dimensional"),
        ],
    )
    def test_arrays_that_do_not_fit_each_other_are_refused_by_name(
        self,
        trial,
        tmp_path,
        name,
        change,
        said,
    ):
        recorded = read_recording(trial[0])
        with np.errstate(all="ignore"):
            changed = {**vars(recorded), name: change(getattr(recorded, name))}
        path = write_recording(tmp_path / "forged.npz", module.Recording(**changed))
        with pytest.raises(DataError, match=said):
            read_recording(path)

    @pytest.mark.parametrize(
        ("name", "change", "said"),
        [
            ("controls", lambda a: a[:, :3], "a row of the model's controls has shape"),
            ("keyframes", lambda a: a[:, :9], "a row of the model's keyframes has shape"),
            ("pushes", lambda a: a[:, :2], "a row of the model's pushes has shape"),
            (
                "keyframes",
                lambda a: np.where(np.arange(a.shape[1]) == 3, np.nan, a),
                "the state at 0 s is not finite",
            ),
        ],
    )
    def test_states_that_do_not_fit_the_model_are_refused_by_name(self, trial, name, change, said):
        recorded = read_recording(trial[0])
        with pytest.raises(DataError, match=said):
            replay(module.Recording(**{**vars(recorded), name: change(getattr(recorded, name))}))

    def test_physics_of_another_type_is_refused_by_name(self, trial, tmp_path):
        recorded = read_recording(trial[0])
        mass = {"body_mass": recorded.model["body_mass"].astype("S8")}
        path = write_recording(
            tmp_path / "forged.npz",
            module.Recording(**{**vars(recorded), "model": {**recorded.model, **mass}}),
        )
        with pytest.raises(DataError, match=r"model\.body_mass is 1-dimensional \|S8"):
            read_recording(path)

    def test_a_scene_that_mujoco_cannot_build_is_one_message(self, trial):
        recorded = read_recording(trial[0])
        block = ObstacleConfig.model_construct(size_m=(-1.0, 0.04, 0.1), xy_m=(0.5, 0.0))
        scene = recorded.scene.model_copy(
            update={"task": recorded.scene.task.model_copy(update={"obstacle": block})},
        )
        with pytest.raises(DataError, match="the recording's scene cannot be built"):
            replay(module.Recording(**{**vars(recorded), "scene": scene}))

    def test_a_state_that_ends_where_the_recording_goes_on_does_not_repeat(
        self,
        trial,
        tmp_path,
        monkeypatch,
    ):
        monkeypatch.chdir(tmp_path)
        recorded = read_recording(trial[0])
        mass = recorded.model["body_mass"].copy()
        mass[:] = 0.0
        inertia = np.zeros_like(recorded.model["body_inertia"])
        armature = np.zeros_like(recorded.model["dof_armature"])
        weightless = {"body_mass": mass, "body_inertia": inertia, "dof_armature": armature}
        found = replay(
            module.Recording(**{**vars(recorded), "model": {**recorded.model, **weightless}}),
        )
        assert found.ended.startswith("the state is not finite")
        assert not found.exact
        assert found.deviates.what == "the state, which goes on in the recording,"
        assert found.compared == 0  # and the command exits with 1, not with 5
        assert list(tmp_path.iterdir()) == []  # MuJoCo would write its warnings to a file here

    @pytest.mark.parametrize(
        "header",
        [
            {"kind": "\x1b[2J"},
            {"seed": "x"},
            {"libraries": {"minidual": 3}},
            {"details": [1]},
            {"reason": None},
        ],
    )
    def test_headers_of_another_type_are_refused_by_name(self, trial, tmp_path, header):
        with pytest.raises(DataError, match=f"does not know: {next(iter(header))}"):
            read_recording(edit_header(trial[0], tmp_path, **header))

    def test_archives_that_no_one_writes_are_one_message(self, trial, tmp_path, monkeypatch):
        path = tmp_path / "odd.npz"
        for compression in (zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2):
            with zipfile.ZipFile(path, "w", compression) as archive:
                archive.writestr("header.npy", b"\x93NUMPY" + bytes(300))
            content = bytearray(path.read_bytes())
            content[60:90] = bytes(30)
            path.write_bytes(content)
            with pytest.raises(DataError, match="is no whole recording"):
                read_recording(path)
        deep = np.frombuffer(b"[" * 100_000, np.uint8)
        np.savez(path, header=deep)
        with pytest.raises(DataError, match="is no whole recording"):
            read_recording(path)
        monkeypatch.setattr(module, "_BYTES_MAX", 1000)
        with pytest.raises(DataError, match=r"unpacked it has \d+ bytes, more than 1000"):
            read_recording(trial[0])


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("forged", [False, True])
def test_no_mutation_kills_the_command_or_passes_unseen(trial, tmp_path, forged):
    """300 mutations of arrays and header, with the old digest or a new one, in own processes."""
    with np.load(trial[0]) as stored:
        arrays = dict(stored)
    cases = []
    files = []
    for seed in range(300):
        mutated, what = mutate(arrays, [seed, forged])
        files.append(tmp_path / f"{seed}.npz")
        write(files[-1], mutated, forged=forged)
        same = all(
            np.array_equal(arrays[n], mutated[n]) and arrays[n].dtype == mutated[n].dtype
            for n in arrays
        )
        cases.append((what, same))
    with ProcessPoolExecutor(
        2,
        get_context("spawn"),
    ) as pool:  # raises if a signal ends one of them
        found = list(pool.map(replay_mutations.run, files))
    for (what, same), (code, out) in zip(cases, found, strict=True):
        assert code in ({0, 1, 2, 5} if forged else {0} if same else {2}), (what, code, out)
        assert "\x1b" not in out
        model_changed = what.startswith("model.") and not same
        assert not (code == 0 and model_changed) or "changed from the scene's" in out, (what, out)


def edit_header(path, folder, **changes):
    """Write a copy of a recording whose header says something else."""
    with np.load(path) as stored:
        arrays = dict(stored)
    header = json.loads(arrays["header"].tobytes()) | changes
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), np.uint8)
    arrays["digest"] = module._digest(
        {name: values for name, values in arrays.items() if name != "digest"},
    )
    edited = folder / "edited.npz"
    np.savez(edited, **arrays)
    return edited


class TestCommand:
    @pytest.fixture
    def run(self, tmp_path, capsys):
        def call(*words):
            code = run_command_line(
                ["replay", *map(str, words), "--runs-dir", str(tmp_path)],
                STAGES,
                TOOLS,
            )
            return code, *capsys.readouterr()

        return call

    def test_it_says_that_it_repeats(self, run, trial, tmp_path):
        code, out, _ = run(trial[0])
        assert code == 0
        assert "repeats   to the bit, at 7 of 7 check points" in out
        assert "nothing went out of bounds" in out
        assert "mujoco 4." in out
        assert list(tmp_path.iterdir()) == []  # it looks, it does not write

    def test_it_shows_the_tick_of_the_reflex_though_the_motors_never_saw_it(
        self,
        run,
        world,
        kinematics,
        tmp_path,
    ):
        recorder = move(world, kinematics, 150, folder=tmp_path / "dumps")
        supervisor = Supervisor(SupervisorConfig(), on_reflex=dumping(recorder))
        tau = np.full(14, 0.25)
        tau[4] = np.nan
        with pytest.raises(ReflexError) as caught:
            supervisor.guard(
                Reader(world, supervisor.config).reset(), tau, Kinematics().gravity(world.q)
            )
        supervisor.tell(caught.value)
        assert "FILE" not in caught.value.remedy
        assert str(caught.value.dump) in caught.value.remedy
        code, out, _ = run(caught.value.dump)
        assert code == 0
        assert "nothing went out of bounds" in out
        assert f"asked_torque_nm: {'0.25 ' * 4}nan{' 0.25' * 9}\n" in out
        assert (
            read_recording(caught.value.dump).details["measured_position_rad"] == world.q.tolist()
        )

    def test_it_says_that_nothing_was_compared(self, run, trial):
        code, out, _ = run(trial[0], "--from-s", "0.31", "--to-s", "0.39")
        assert code == 5
        assert "repeats   nothing compared" in out
        assert "to the bit" not in out

    def test_what_a_file_says_does_not_steer_the_terminal(self, run, trial, tmp_path):
        told = {
            "reason": "\x1b]0;owned\x07\u202e",
            "kind": "dump",
            "details": {"\x1b[2J": ["\x9b31m"]},
        }
        code, out, err = run(edit_header(trial[0], tmp_path, **told))
        assert code == 0
        assert "why       \\u001b]0;owned\\u0007\\u202e" in out
        assert "\\u001b[2J: \\u009b31m" in out
        assert not set("\x1b\x07\x9b\u202e") & set(out + err)

    def test_json_is_one_document(self, run, trial):
        code, out, _ = run(trial[0], "--from-s", "0.2", "--json")
        document = json.loads(out)
        assert code == 0
        assert document["exact"] is True
        assert document["from_s"] == pytest.approx(0.2)
        assert document["details"] == {"index": 3}

    def test_physics_that_does_not_repeat_exits_1_and_another_version_explains_it(
        self,
        run,
        trial,
        tmp_path,
    ):
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
        for path, said in (
            (tmp_path / "missing.npz", "there is no file"),
            (tmp_path, "is a folder, not a recording"),
            ("/dev/zero", "/dev/zero is a device, not a recording"),
            (tmp_path / "episode_000000.hdf5", "is an episode; a recording of a trial is an .npz"),
        ):
            code, _, err = run(path)
            assert (code, said in err) == (2, True), err
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
        for option, value, of in (("--frames", "4", "--picture"), ("--slowdown", "2", "--video")):
            assert f"{option} goes with {of}" in run(trial[0], option, value)[2]

    def test_it_draws_a_film_and_a_sheet(self, run, trial, tmp_path):
        film = tmp_path / "film.mp4"
        sheet = tmp_path / "sheet.png"
        words = ("--from-s", "0.4", "--to-s", "0.6", "--slowdown", "2", "--frames", "3")
        assert run(trial[0], *words, "--video", film, "--picture", sheet)[0] == 0
        with av.open(str(film)) as container:
            frames_n = len(list(container.decode(video=0)))
        assert frames_n == pytest.approx(2 * 0.2 * FILM_FPS, abs=1.0)
        assert sheet.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
        assert not zipfile.is_zipfile(sheet)
