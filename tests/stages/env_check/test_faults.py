"""Faults of the world, the motors and the cameras: each makes its own check of `env-check` say no."""

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from minidual.config.scene import SceneConfig
from minidual.plant.model import build_spec
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA
from minidual.show.figures.film import FILM_FPS, Postures, film_postures
from minidual.stages.env_check import installation, tracking
from minidual.stages.env_check.checks import installation_checks
from minidual.stages.env_check.installation import required_libraries
from minidual.stages.env_check.model import model_agreement, torque_pulse_mapping
from minidual.stages.env_check.pictures import check_cameras
from minidual.stages.env_check.responses import joint_responses
from minidual.stages.env_check.rig import TrackingRig
from minidual.stages.env_check.tracking import arm_contacts
from tests.support.env_check_samples import DOF, HOME, SOUND, failing, judged, rig_of

Change = Callable[[mujoco.MjSpec], object]


def broken_world(scene: SceneConfig, change: Change) -> World:
    """Return a world whose model was changed."""
    spec = build_spec(scene, visuals=False)
    change(spec)
    return World(scene, model=spec.compile())


def post_at(place_m: tuple[float, float, float]) -> Change:
    """Return a change that puts a ball of 12 cm at a place."""

    def add(spec: mujoco.MjSpec) -> None:
        spec.worldbody.add_geom(
            name="forgotten",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[0.06, 0.0, 0.0],
            pos=place_m,
        )

    return add


def test_an_installed_library_that_is_too_old(monkeypatch: pytest.MonkeyPatch) -> None:
    version = installation.importlib.metadata.version

    def installed(name: str) -> str:
        return "2.3.0" if name == "mujoco" else version(name)

    monkeypatch.setattr(installation.importlib.metadata, "version", installed)
    checks = installation_checks(required_libraries(), DOF, DUAL_PANDA)
    assert [check.name for check in checks if not check.passed] == ["libraries.unfit"]


def test_two_motors_with_swapped_wires(
    world: World, kinematics: Kinematics, rig: TrackingRig
) -> None:
    ctrl = world.joints.ctrl.copy()
    ctrl[[4, 6]] = ctrl[[6, 4]]
    world.joints = world.joints._replace(ctrl=ctrl)
    moved = torque_pulse_mapping(world, rig.supervisor, kinematics)
    checks = judged(moved=moved)
    assert failing(checks) == {"joints.mapped"}
    assert "commands 5, 7 move something else" in checks["joints.mapped"].remedy


def test_a_joint_that_is_stuck(scene: SceneConfig, kinematics: Kinematics) -> None:
    def stick(spec: mujoco.MjSpec) -> None:
        spec.joint("left_panda_joint5").frictionloss = 50.0  # more than its motor can

    rig = rig_of(broken_world(scene, stick), kinematics)
    steps = tracking.single_joint_steps(rig, 0.1, 0.6)
    checks = judged(responses=joint_responses(DUAL_PANDA, steps, SOUND.sine))
    assert failing(checks) == {"joints.reached", "joints.rise_max_s"}
    assert "joints 5 do not arrive" in checks["joints.reached"].remedy


def test_a_joint_with_inertia_that_nobody_told_the_controller(
    scene: SceneConfig,
    kinematics: Kinematics,
) -> None:
    def load(spec: mujoco.MjSpec) -> None:
        spec.joint("left_panda_joint1").armature = 0.5

    rig = rig_of(broken_world(scene, load), kinematics)
    steps = tracking.single_joint_steps(rig, 0.1, 0.6)
    checks = judged(responses=joint_responses(DUAL_PANDA, steps, SOUND.sine))
    assert failing(checks) == {"joints.overshoot_max_rad"}
    assert "left_panda_joint1" in checks["joints.overshoot_max_rad"].remedy


def test_motors_without_power(rig: TrackingRig, monkeypatch: pytest.MonkeyPatch) -> None:
    command = rig.world.command
    monkeypatch.setattr(rig.world, "command", lambda tau, fingers: command(0.0 * tau, fingers))
    step = tracking.step_response(rig, tracking.outward_step(DUAL_PANDA, 0.3), 0.6)
    assert failing(judged(step=step)) == {"tracking.step_error_rad", "control.stopped"}


def test_motors_that_give_three_quarters_of_their_torque(
    rig: TrackingRig,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    command = rig.world.command
    monkeypatch.setattr(rig.world, "command", lambda tau, fingers: command(0.75 * tau, fingers))
    sine = tracking.sine_response(rig, 0.3, 0.5, 0.6)
    assert "tracking.sine_rms_rad" in failing(judged(sine=sine))


def test_a_thing_that_stands_in_the_way_of_the_swing(
    scene: SceneConfig,
    kinematics: Kinematics,
) -> None:
    q, _, _ = tracking.sine_reference(DUAL_PANDA, 0.3, 0.5, 0.5)
    hand = kinematics.tcp_poses(q)[0][:3, 3]
    rig = rig_of(broken_world(scene, post_at(tuple(hand))), kinematics)
    sine = tracking.sine_response(rig, 0.3, 0.5, 1.0)
    assert "contacts.sine" in failing(judged(sine=sine))


def test_a_thing_that_touches_an_arm_at_home(scene: SceneConfig, kinematics: Kinematics) -> None:
    hand = kinematics.tcp_poses(HOME)[0][:3, 3]
    world = broken_world(scene, post_at(tuple(hand)))
    mujoco.mj_forward(world.model, world.data)
    checks = judged(contacts=arm_contacts(world))
    assert failing(checks) == {"contacts.home"}
    assert "left_panda" in checks["contacts.home"].remedy


def test_a_simulated_rotor_with_other_inertia(scene: SceneConfig, kinematics: Kinematics) -> None:
    def change(spec: mujoco.MjSpec) -> None:
        spec.joint("left_panda_joint1").armature = 0.11

    rng = np.random.default_rng(0)
    agreement = model_agreement(broken_world(scene, change), kinematics, rng, 2)
    assert failing(judged(agreement=agreement)) == {"model.agreement_max"}


def test_a_cap_on_the_lens(scene: SceneConfig) -> None:
    spec = build_spec(scene, visuals=True)
    high = spec.camera("high")
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, np.array(high.quat))
    spec.worldbody.add_geom(
        name="cap",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[0.3, 0.3, 0.001],
        pos=np.array(high.pos) - 0.05 * R.reshape(3, 3)[:, 2],
        quat=high.quat,
        contype=0,
        conaffinity=0,
    )
    cameras = check_cameras(World(scene, model=spec.compile()))
    assert failing(judged(cameras=cameras)) == {"cameras.contrast_min", "cameras.object_share"}


def test_an_object_that_is_not_in_the_picture(visual_world: World) -> None:
    visual_world.reset(poses={"rod": (-3.0, 0.0, 0.0)})
    assert failing(judged(cameras=check_cameras(visual_world))) == {"cameras.object_share"}


def test_a_wrist_camera_that_looks_away(scene: SceneConfig) -> None:
    spec = build_spec(scene, visuals=True)
    spec.camera("left").quat = [1.0, 0.0, 0.0, 0.0]
    cameras = check_cameras(World(scene, model=spec.compile()))
    assert "cameras.fingers_min" in failing(judged(cameras=cameras))


def test_a_swing_that_freezes_before_its_end(
    visual_world: World, kinematics: Kinematics, tmp_path: Path
) -> None:
    rig = rig_of(visual_world, kinematics)
    postures = Postures(1.0 / FILM_FPS)
    step = visual_world.step

    def freeze() -> None:
        if visual_world.time < 0.2:
            step()

    visual_world.step = freeze
    tracking.sine_response(rig, 0.3, 0.5, 2.0, on_step=postures)
    frames = film_postures(visual_world.model, postures.qpos, tmp_path / "sine.mp4", shadows=False)
    assert failing(judged(frames=frames)) == {"video.frames"}
