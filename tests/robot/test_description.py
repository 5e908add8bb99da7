"""The description of the robot: one source, the limits it states, two engines that agree."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from minidual.config.scene import RobotConfig, SceneConfig
from minidual.errors import EnvironmentMissingError, UsageError
from minidual.plant.model import build_model
from minidual.plant.world import World
from minidual.robot import description
from minidual.robot.kinematics import Kinematics
from minidual.robot.models import ARM_MODELS, PANDA
from minidual.robot.pair import DUAL_PANDA, Robot, robot_from
from minidual.robot.visuals import FACES_PER_ARM, arm_visuals

ROBOTS = [robot_from(RobotConfig(arm=name)) for name in ("panda", "xarm7", "ur5")]
each_robot = pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.arm.name)


@each_robot
def test_the_limits_are_those_of_the_urdf(robot):
    root = ET.parse(description.file_at(robot.arm.urdf)).getroot()
    source = {joint.attrib["name"]: joint for joint in root.findall("joint")}
    for i, name in enumerate(robot.arm.joints):
        limit = source[name].find("limit").attrib
        assert float(limit["lower"]) == pytest.approx(robot.arm.q_lower[i], abs=1e-9)
        assert float(limit["upper"]) == pytest.approx(robot.arm.q_upper[i], abs=1e-9)
        assert float(limit["velocity"]) == robot.arm.v_max[i]
        assert float(limit["effort"]) == robot.arm.tau_max[i]


@each_robot
def test_pinocchio_has_the_limits_order_and_rotor_inertia(robot):
    model = Kinematics(robot).model
    assert tuple(model.names)[1:] == robot.joint_names
    assert np.allclose(model.lowerPositionLimit, robot.q_lower, atol=1e-9, rtol=0.0)
    assert np.allclose(model.upperPositionLimit, robot.q_upper, atol=1e-9, rtol=0.0)
    assert np.array_equal(model.velocityLimit, robot.v_max)
    assert np.array_equal(model.effortLimit, robot.tau_max)
    assert np.array_equal(model.armature, np.full(robot.dof, robot.arm.armature))


@each_robot
def test_mujoco_has_the_limits_damping_and_rotor_inertia(robot):
    model = build_model(SceneConfig(), robot, visuals=False)
    for i, name in enumerate(robot.joint_names):
        joint = model.joint(name)
        dof = int(joint.dofadr[0])
        assert int(joint.type[0]) == int(mujoco.mjtJoint.mjJNT_HINGE)
        assert tuple(joint.range) == pytest.approx((robot.q_lower[i], robot.q_upper[i]), abs=1e-9)
        assert model.jnt_limited[joint.id]
        assert model.dof_armature[dof] == robot.arm.armature
        assert float(np.max(model.dof_damping[dof])) == robot.arm.damping
        assert float(np.max(model.dof_frictionloss[dof])) == robot.arm.friction
        motor = model.actuator(f"{name}_motor")
        assert tuple(motor.forcerange) == (-robot.tau_max[i], robot.tau_max[i])
        assert tuple(motor.ctrlrange) == (-robot.tau_max[i], robot.tau_max[i])
    for name in robot.finger_joint_names:
        assert tuple(model.joint(name).range) == (0.0, robot.hand.travel_m)


@each_robot
def test_masses_and_inertias_are_those_of_the_urdf(robot):
    model = build_model(SceneConfig(), robot, visuals=False)
    full = pin.buildModelFromXML(description.pair_urdf(robot))
    arms = [i for i in range(model.nbody) if model.body(i).name.startswith(("left_", "right_"))]
    # Pinocchio folds both fixed bases into the universe, whose mass it does not count.
    bases = sum(float(model.body(name).mass[0]) for name in robot.both(robot.arm.base_link))
    assert sum(model.body_mass[arms]) - bases == pytest.approx(
        pin.computeTotalMass(full, full.createData()),
        abs=1e-9,
    )


@each_robot
def test_nothing_but_the_rod_touches_at_home_and_motors_hold_the_arms(robot):
    world = World(SceneConfig(), robot)
    kinematics = Kinematics(robot)
    assert {frozenset(pair[:2]) for pair in world.contact_pairs()} == {frozenset(("rod", "table"))}
    assert (np.abs(kinematics.gravity(robot.home)) < 0.6 * robot.tau_max).all()
    for T in kinematics.tcp_poses(robot.home):
        assert np.allclose(
            T[:3, :3],
            np.diag([1.0, -1.0, -1.0]),
            atol=1e-3,
        )  # hands down, fingers open along x


@each_robot
def test_named_postures_touch_nothing_and_lie_inside_the_limits(robot):
    world = World(SceneConfig(), robot)
    for name, posture in robot.arm.postures.items():
        world.reset(np.hstack(posture))  # refuses what lies outside
        touching = {frozenset(pair[:2]) for pair in world.contact_pairs()}
        assert touching == {frozenset(("rod", "table"))}, name


@each_robot
def test_home_lies_well_inside_the_limits(robot):
    assert (robot.home > robot.q_lower + 0.3).all()
    assert (robot.home < robot.q_upper - 0.3).all()


def test_an_unknown_arm_is_answered_with_what_exists():
    with pytest.raises(UsageError, match="xarm7"):
        robot_from(RobotConfig(arm="xarm8"))


def test_a_link_that_the_urdf_does_not_have_is_named():
    arm = dataclasses.replace(PANDA, flange_link="panda_link9")
    with pytest.raises(UsageError, match="panda_link8"):
        description.pair_urdf(Robot(arm))
    with pytest.raises(UsageError, match="does not hang on"):
        description.pair_urdf(
            Robot(dataclasses.replace(PANDA, base_link="panda_link3", flange_link="panda_link1")),
        )


def test_groups_partition_the_joints():
    for robot in ROBOTS:
        names = robot.joint_names
        assert all(name.startswith("left_") for name in names[robot.groups["left_arm"]])
        assert all(name.startswith("right_") for name in names[robot.groups["right_arm"]])
        assert names[robot.groups["both_arms"]] == names


def test_constants_cannot_be_changed_by_accident():
    with pytest.raises(ValueError, match="read-only"):
        DUAL_PANDA.home[0] = 1.0


def test_the_urdf_has_two_prefixed_arms_on_one_world():
    robot = ET.fromstring(description.pair_urdf(DUAL_PANDA))
    links = [link.attrib["name"] for link in robot.iter("link")]
    assert len(links) == len(set(links))
    assert links[0] == "world"
    for arm, place in zip(DUAL_PANDA.sides, DUAL_PANDA.base_positions_m, strict=True):
        base = robot.find(f"joint[@name='{arm}_base']")
        assert base.find("parent").attrib["link"] == "world"
        xyz = tuple(float(v) for v in base.find("origin").attrib["xyz"].split())
        assert xyz == place
    assert set(DUAL_PANDA.tcp_names) <= set(links)
    assert not list(robot.iter("mimic"))
    for mesh in robot.iter("mesh"):
        assert mesh.attrib["filename"].startswith("/")


def test_a_missing_description_package_is_named_with_its_remedy(monkeypatch):
    def missing(_name):
        raise importlib.metadata.PackageNotFoundError

    monkeypatch.setattr(importlib.metadata, "distribution", missing)
    with pytest.raises(EnvironmentMissingError, match="example-robot-data") as caught:
        description.file_at.__wrapped__(PANDA.urdf)
    assert "pip install" in caught.value.remedy
    assert caught.value.exit_code == 4


def test_an_empty_description_package_is_named(monkeypatch):
    class Empty:
        def locate_file(self, path):
            return f"/nowhere/{path}"

    monkeypatch.setattr(importlib.metadata, "distribution", lambda _name: Empty())
    with pytest.raises(EnvironmentMissingError, match=r"panda\.urdf"):
        description.file_at.__wrapped__(PANDA.urdf)


def test_visual_meshes_are_few_whole_and_cover_every_link():
    visuals = arm_visuals(PANDA)
    assert {link for link, *_ in visuals} == {
        *(f"panda_link{i}" for i in range(8)),
        "panda_hand",
        "panda_leftfinger",
        "panda_rightfinger",
    }
    assert 0.5 * FACES_PER_ARM < sum(len(faces) for _, _, faces, _ in visuals) < 1.3 * FACES_PER_ARM
    for _, vertices, faces, rgba in visuals:
        assert faces.max() < len(vertices)
        assert np.isfinite(vertices).all()
        assert all(0.0 <= c <= 1.0 for c in rgba)


def test_no_link_is_cut_by_the_simplification():
    """The shoulder of the xArm 7 loses its upper half to the first, hasty simplification."""
    import trimesh

    arm = ARM_MODELS["xarm7"]
    sizes = {link: np.ptp(vertices, axis=0) for link, vertices, _, _ in arm_visuals(arm)}
    folder = description.file_at(arm.urdf).parents[1] / "meshes" / "xarm7" / "visual"
    for joint in range(1, 8):
        whole = np.ptp(trimesh.load_mesh(folder / f"link{joint}.stl").vertices, axis=0)
        assert (sizes[f"link{joint}"] > whole - 0.01).all()


def test_visuals_add_nothing_to_the_physics(compiled_model, visual_model):
    assert visual_model.ngeom > compiled_model.ngeom
    assert np.array_equal(visual_model.body_mass, compiled_model.body_mass)
    assert np.array_equal(visual_model.body_inertia, compiled_model.body_inertia)
    for i in range(visual_model.ngeom):
        if visual_model.geom(i).name == "" and visual_model.geom_group[i] == 1:
            assert (visual_model.geom_contype[i], visual_model.geom_conaffinity[i]) == (0, 0)
