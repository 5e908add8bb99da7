"""Pictures without a screen, and films that are whole."""

from __future__ import annotations

import multiprocessing
import os
from concurrent.futures import ThreadPoolExecutor

import av
import mujoco
import numpy as np
import pytest

from minidual.config.loader import load_config
from minidual.control.joint_control import JointLoop
from minidual.errors import EnvironmentMissingError, UsageError
from minidual.plant import render
from minidual.plant.cameras import CAMERAS
from minidual.plant.model import build_model
from minidual.plant.render import Camera, write_video
from minidual.stages.env_check.pictures import check_cameras
from minidual.tasks.catalogue import TASKS, make_task
from minidual.tasks.task import pose_of
from tests.support.arm_scripts import pinch_rod


def test_every_camera_sees_something_and_each_something_else(visual_world):
    with Camera(visual_world.model, 128, 96) as camera:
        pictures = [camera.picture(visual_world.data, name) for name in (*CAMERAS, "overview")]
    for picture in pictures:
        assert picture.shape == (96, 128, 3)
        assert picture.dtype == np.uint8
        assert picture.std() > 10.0
    assert len({picture.tobytes() for picture in pictures}) == 4


def test_the_same_state_gives_the_same_picture(visual_world):
    with Camera(visual_world.model, 64, 48) as camera:
        first = camera.picture(visual_world.data, "high")
        camera.picture(visual_world.data, "left")
        assert np.array_equal(camera.picture(visual_world.data, "high"), first)


def test_a_picture_bears_the_time_of_the_state_that_it_shows(visual_world):
    """The stamp is that of the rendered state, not of the moment at which somebody asks."""
    past = mujoco.MjData(visual_world.model)
    past.qpos[:] = visual_world.data.qpos
    past.time = visual_world.time
    mujoco.mj_forward(visual_world.model, past)
    for _ in range(25):
        visual_world.step()
    with Camera(visual_world.model, 64, 48) as camera:
        now = camera.stamped(visual_world.data, "high")
        late = camera.stamped(past, "high")
    assert now.stamp_s == visual_world.time
    assert now.stamp_s - late.stamp_s == pytest.approx(0.025)


def test_supersampling_keeps_the_size_and_smooths(visual_world):
    with (
        Camera(visual_world.model, 64, 48) as plain,
        Camera(visual_world.model, 64, 48, supersample=3) as smooth,
    ):
        coarse, fine = (
            c.picture(visual_world.data, "overview").astype(float) for c in (plain, smooth)
        )
    assert coarse.shape == fine.shape
    assert np.abs(np.diff(fine, axis=1)).mean() < np.abs(np.diff(coarse, axis=1)).mean()


def test_an_unknown_camera_is_named(visual_world):
    with (
        Camera(visual_world.model, 64, 48) as camera,
        pytest.raises(UsageError, match="no camera 'hihg'") as caught,
    ):
        camera.picture(visual_world.data, "hihg")
    assert "high" in caught.value.remedy


def test_no_gl_is_an_environment_error_with_a_remedy(visual_world, monkeypatch):
    def broken(*_args):
        raise RuntimeError("Cannot initialize a EGL device display.")

    monkeypatch.setattr(render.mujoco, "Renderer", broken)
    with pytest.raises(EnvironmentMissingError, match="EGL device display") as caught:
        Camera(visual_world.model, 64, 48)
    assert "libegl1 libgl1-mesa-dri" in caught.value.remedy
    assert caught.value.exit_code == 4


def test_shares_of_a_picture_are_those_of_its_bodies(visual_world):
    with Camera(visual_world.model, 160, 120) as camera:
        seen = camera.bodies_seen(visual_world.data, "high")
        picture = camera.picture(visual_world.data, "high").astype(int)
    colour = float(np.mean((picture[..., 0] - picture[..., 2] > 90) & (picture[..., 0] > 140)))
    assert seen["table"] > 0.4
    assert sum(seen.values()) <= 1.0 + 1e-9
    # Orange is the rod but for its two blue bands.
    assert 0.6 * seen["rod"] < colour < 1.1 * seen["rod"]


def test_the_camera_check_notices_a_rod_that_is_not_there(visual_world):
    assert check_cameras(visual_world).object_share > 0.001
    visual_world.reset(poses={"rod": (-3.0, 0.0, 0.0)})
    assert check_cameras(visual_world).object_share == 0.0


def test_the_camera_check_notices_a_wrist_camera_turned_away(scene):
    from minidual.plant.model import build_spec
    from minidual.plant.world import World

    spec = build_spec(scene, visuals=True)
    spec.camera("left").quat = [1.0, 0.0, 0.0, 0.0]
    assert check_cameras(World(scene, model=spec.compile())).fingers_min == 0.0


def test_wrist_cameras_see_both_fingers_and_the_rod_in_a_grasp(visual_world, scene, kinematics):
    pinch_rod(JointLoop(visual_world, kinematics), scene, kinematics)
    with Camera(visual_world.model, 160, 120) as camera:
        for arm in ("left", "right"):
            seen = camera.bodies_seen(visual_world.data, arm)
            assert seen["rod"] > 0.02
            assert (
                min(seen[f"{arm}_panda_{finger}"] for finger in ("leftfinger", "rightfinger"))
                > 0.005
            )


def frames(n, height=48, width=64):
    for k in range(n):
        frame = np.zeros((height, width, 3), np.uint8)
        frame[:, : (k * width) // n] = 200
        yield frame


def test_a_film_has_its_frames_rate_and_pictures(tmp_path):
    path = tmp_path / "film.mp4"
    assert write_video(path, frames(37), fps=30) == 37
    with av.open(str(path)) as film:
        stream = film.streams.video[0]
        decoded = [frame.to_ndarray(format="rgb24") for frame in film.decode(stream)]
        assert stream.average_rate == 30
    assert len(decoded) == 37
    assert np.abs(decoded[20].astype(int) - list(frames(37))[20]).mean() < 10.0


def test_an_interrupted_film_leaves_no_film(tmp_path):
    path = tmp_path / "film.mp4"

    def interrupted():
        yield from frames(5)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_video(path, interrupted(), fps=30)
    assert not path.exists()


def test_rendering_does_not_move_the_world(visual_world):
    before = visual_world.data.qpos.copy(), visual_world.time
    with Camera(visual_world.model, 64, 48) as camera:
        camera.picture(visual_world.data, "high")
        camera.bodies_seen(visual_world.data, "high")
    assert np.array_equal(visual_world.data.qpos, before[0])
    assert visual_world.time == before[1]
    assert isinstance(visual_world.data, mujoco.MjData)


def seen_from(name: str, width_px: int | None = None, opening_deg: float | None = None) -> float:
    """Return how far starts and goals are from the middle of the recorded picture; 1 is its rim."""
    settings = [f"task={name}"] + (
        [] if width_px is None else [f"scene.camera.width_px={width_px}"]
    )
    task = make_task(load_config(overrides=settings).config)
    model = build_model(task.scene)
    camera = model.camera("high")
    size = task.scene.camera
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, camera.quat)
    up = np.tan(np.radians((opening_deg or camera.fovy[0]) / 2.0))
    right = up * size.width_px / size.height_px
    farthest = 0.0
    for index in range(100):
        trial = task.trial(1, "tests", index)
        for where in (trial.start, trial.goal):
            for item in where:
                T = pose_of(task.objects[item].body, where[item])
                for z in (0.0, task.objects[item].body.rest_height_m):
                    x, y, back = (T[:3, 3] + (0.0, 0.0, z) - camera.pos) @ R.reshape(3, 3)
                    farthest = max(farthest, abs(x / back) / right, abs(y / back) / up)
    return farthest


@pytest.mark.parametrize("name", TASKS)
def test_every_start_and_goal_of_a_task_is_well_in_the_recorded_picture(name: str) -> None:
    assert seen_from(name) < 0.9


def test_the_picture_that_cut_bottles_off_is_told() -> None:
    """The negative control: 128 pixels and 64 degrees cut bottles of `handover` off."""
    assert seen_from("handover", 128, 64.1) > 0.97


def test_a_camera_used_in_another_thread_says_so(visual_world):
    with Camera(visual_world.model, 64, 48) as camera, ThreadPoolExecutor(1, "other") as pool:
        drawn = pool.submit(camera.picture, visual_world.data, "high")
        with pytest.raises(UsageError, match=r"made in thread 'MainThread' was used in 'other_0'"):
            drawn.result(timeout=30)
        assert camera.picture(visual_world.data, "high").std() > 10.0


def _draws(model) -> str:
    """Return the error of a camera made here, or ""."""
    try:
        Camera(model, 64, 48).close()
    except UsageError as error:
        return f"{error.message}; {error.remedy}"
    return ""


def test_a_process_forked_after_a_picture_is_told_to_spawn(visual_world):
    """It would hang otherwise; a forked process answers within the time limit of the test."""
    with Camera(visual_world.model, 64, 48) as camera:
        camera.picture(visual_world.data, "high")
        reader, writer = multiprocessing.Pipe(duplex=False)
        fork = multiprocessing.get_context("fork")
        child = fork.Process(target=lambda: writer.send(_draws(visual_world.model)))
        child.start()
        assert reader.poll(60)
        answer = reader.recv()
        child.join(10)
    assert f"forked from process {os.getpid()}" in answer
    assert 'context="spawn"' in answer
    assert _draws(visual_world.model) == ""
