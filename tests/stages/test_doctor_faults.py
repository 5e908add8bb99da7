"""Faults that are put into the simulated robot: `doctor` names each as one cause, whatever follows."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import pytest

from minidual.config.loader import load_config
from minidual.config.scene import SceneConfig
from minidual.gate.stage import ToolContext
from minidual.plant.model import build_spec
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.stages import doctor
from minidual.stages.env_check import stage as env_check
from minidual.stages.registry import STAGES
from minidual.stages.troubles.diagnosis import Fault, diagnose
from tests.support.env_check_samples import HOME

Change = Callable[[mujoco.MjSpec], object]


class Stages:
    """What a tool needs of a gate here: the table."""

    table = STAGES


def without_a_motor(spec: mujoco.MjSpec) -> None:
    spec.delete(spec.actuator("left_panda_joint6_motor"))


def with_a_stuck_joint(spec: mujoco.MjSpec) -> None:
    spec.joint("left_panda_joint5").frictionloss = 50.0


def with_another_rotor(spec: mujoco.MjSpec) -> None:
    spec.joint("left_panda_joint1").armature = 0.5


def with_a_ball_at_a_hand(spec: mujoco.MjSpec) -> None:
    spec.worldbody.add_geom(
        name="forgotten",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[0.06, 0.0, 0.0],
        pos=Kinematics().tcp_poses(HOME)[0][:3, 3],
    )


def with_a_camera_turned_away(spec: mujoco.MjSpec) -> None:
    spec.camera("high").pos = [0.0, 0.0, -5.0]
    spec.camera("high").quat = [0.0, 1.0, 0.0, 0.0]


def examined(folder: Path, change: Change, monkeypatch: pytest.MonkeyPatch) -> list[Fault]:
    """Return the diagnosis of `env-check` on a changed robot."""

    def build(scene: SceneConfig, *_: object, visuals: bool) -> mujoco.MjModel:
        spec = build_spec(scene, visuals=visuals)
        change(spec)
        return spec.compile()

    monkeypatch.setattr(env_check, "build_model", build)
    loaded = load_config("standard")
    context = ToolContext(
        config=loaded.config,
        seed=3,
        profile="standard",
        run_folder=folder,
        name="doctor",
        gate=Stages(),
    )
    context.begin()
    return diagnose(doctor.stage("env-check", context).faults, {})


def causes(faults: list[Fault]) -> list[str]:
    return [fault.name for fault in faults if not fault.follows]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "cause", "trouble"),
    [
        (without_a_motor, "joints.count", "no-actuators"),
        (with_a_stuck_joint, "joints.mapped", "joint-order"),
        (with_another_rotor, "model.agreement_max", "explosion"),
        (with_a_ball_at_a_hand, "contacts.home", "false-collision"),
        (with_a_camera_turned_away, "cameras.object_share", ""),
    ],
)
def test_a_fault_of_the_robot_is_one_cause(
    change: Change,
    cause: str,
    trouble: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    faults = examined(tmp_path, change, monkeypatch)
    assert causes(faults) == [cause], [(fault.name, fault.detail) for fault in faults]
    assert faults[0].trouble == trouble


@pytest.mark.slow
def test_two_motors_with_swapped_wires_are_one_cause(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def swapped(*arguments: object, **words: object) -> World:
        world = World(*arguments, **words)  # type: ignore[arg-type]
        ctrl = world.joints.ctrl.copy()
        ctrl[[4, 6]] = ctrl[[6, 4]]
        world.joints = world.joints._replace(ctrl=ctrl)
        return world

    monkeypatch.setattr(env_check, "World", swapped)
    faults = examined(tmp_path, lambda _: None, monkeypatch)
    assert causes(faults) == ["joints.mapped"], [(fault.name, fault.detail) for fault in faults]
    assert len(faults) >= 8, "a swap is seen by many checks"
    assert faults[0].trouble == "joint-order"
