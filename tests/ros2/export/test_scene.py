"""The MuJoCo scene: it loads from the package, holds the home posture and follows its servos."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from minidual.robot.pair import DUAL_PANDA
from minidual.ros2.names import PackageNames


@pytest.fixture(scope="module")
def model(workspace) -> mujoco.MjModel:
    folder = workspace / "src" / PackageNames("dual_panda").description
    return mujoco.MjModel.from_xml_path(str(folder / "mjcf" / "scene.xml"))


def at_home(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    return data


def positions(data: mujoco.MjData, names: tuple[str, ...]) -> np.ndarray:
    return np.array([data.joint(name).qpos[0] for name in names])


def test_each_commanded_joint_has_a_servo_of_its_name(model) -> None:
    names = [model.actuator(k).name for k in range(model.nu)]
    leading = [name for name in DUAL_PANDA.finger_joint_names if name.endswith("1")]
    assert sorted(names) == sorted((*DUAL_PANDA.joint_names, *leading))
    for k in range(model.nu):
        assert model.joint(model.actuator_trnid[k, 0]).name == names[k]
        assert model.actuator_biasprm[k, 1] < 0.0  # what makes it a position servo


def test_the_arms_stay_at_home(model) -> None:
    data = at_home(model)
    for _ in range(500):
        mujoco.mj_step(model, data)
    drift = positions(data, DUAL_PANDA.joint_names) - DUAL_PANDA.home
    assert np.abs(drift).max() < 1e-3


def test_the_arms_reach_a_posture_within_their_torque(model) -> None:
    data = at_home(model)
    goal = np.array(DUAL_PANDA.arm.postures["ready"]).ravel()
    targets = dict(zip(DUAL_PANDA.joint_names, goal, strict=True))
    start = dict(zip(DUAL_PANDA.joint_names, DUAL_PANDA.home, strict=True))
    steps_n = 1500
    for step in range(steps_n + 500):
        share = min(1.0, step / steps_n)
        for name, target in targets.items():
            data.actuator(name).ctrl[0] = start[name] + share * (target - start[name])
        mujoco.mj_step(model, data)
        assert np.abs(data.actuator_force[: DUAL_PANDA.dof]).max() <= DUAL_PANDA.tau_max.max()
    assert np.abs(positions(data, DUAL_PANDA.joint_names) - goal).max() < 2e-3


def test_the_second_finger_follows_the_first(model) -> None:
    data = at_home(model)
    leading, following, *_ = DUAL_PANDA.finger_joint_names
    data.actuator(leading).ctrl[0] = 0.01
    for _ in range(800):
        mujoco.mj_step(model, data)
    assert data.joint(leading).qpos[0] == pytest.approx(0.01, abs=1e-3)
    assert data.joint(following).qpos[0] == pytest.approx(data.joint(leading).qpos[0], abs=1e-3)


def test_the_cameras_have_the_size_of_the_recording(model) -> None:
    for name in ("high", "left", "right"):
        assert tuple(model.cam_resolution[model.camera(name).id]) == (128, 96)
