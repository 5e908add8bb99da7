"""The description of the robot: one source, the limits it states, two engines that agree."""

from __future__ import annotations

import importlib.metadata
import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from minidual.errors import EnvironmentMissingError
from minidual.robot import description
from minidual.robot.arms import DUAL_PANDA, PANDA
from minidual.robot.constants import (
    ARMS,
    BASE_POSITIONS_M,
    DOF,
    FINGER_JOINT_NAMES,
    FINGER_TRAVEL_M,
    GROUPS,
    HOME,
    JOINT_ARMATURE,
    JOINT_DAMPING,
    JOINT_NAMES,
    Q_LOWER,
    Q_UPPER,
    TAU_MAX,
    TCP_NAMES,
    V_MAX,
)
from minidual.robot.visuals import FACES_PER_ARM, arm_visuals


@pytest.fixture(scope="module")
def source():
    """The untouched URDF of one arm, by joint name."""
    path = description.file_at(PANDA.urdf)
    return {joint.attrib["name"]: joint for joint in ET.parse(path).getroot().iter("joint")}


def test_the_constants_are_the_limits_of_the_urdf(source):
    for i, name in enumerate(JOINT_NAMES):
        limit = source[name.split("_", 1)[1]].find("limit").attrib
        assert float(limit["lower"]) == Q_LOWER[i]
        assert float(limit["upper"]) == Q_UPPER[i]
        assert float(limit["velocity"]) == V_MAX[i]
        assert float(limit["effort"]) == TAU_MAX[i]
    for name in FINGER_JOINT_NAMES:
        assert float(source[name.split("_", 1)[1]].find("limit").attrib["upper"]) == FINGER_TRAVEL_M


def test_pinocchio_has_the_limits_order_and_rotor_inertia(kinematics):
    model = kinematics.model
    assert tuple(model.names)[1:] == JOINT_NAMES
    assert np.array_equal(model.lowerPositionLimit, Q_LOWER)
    assert np.array_equal(model.upperPositionLimit, Q_UPPER)
    assert np.array_equal(model.velocityLimit, V_MAX)
    assert np.array_equal(model.effortLimit, TAU_MAX)
    assert np.array_equal(model.armature, np.full(DOF, JOINT_ARMATURE))


def test_mujoco_has_the_limits_damping_and_rotor_inertia(compiled_model):
    model = compiled_model
    for i, name in enumerate(JOINT_NAMES):
        joint = model.joint(name)
        dof = int(joint.dofadr[0])
        assert int(joint.type[0]) == int(mujoco.mjtJoint.mjJNT_HINGE)
        assert tuple(joint.range) == (Q_LOWER[i], Q_UPPER[i])
        assert model.jnt_limited[joint.id]
        assert model.dof_armature[dof] == JOINT_ARMATURE
        assert float(np.max(model.dof_damping[dof])) == JOINT_DAMPING
        motor = model.actuator(f"{name}_motor")
        assert tuple(motor.forcerange) == (-TAU_MAX[i], TAU_MAX[i])
        assert tuple(motor.ctrlrange) == (-TAU_MAX[i], TAU_MAX[i])


def test_masses_and_inertias_are_those_of_the_urdf(compiled_model, kinematics):
    full = pin.buildModelFromXML(description.pair_urdf(DUAL_PANDA))
    data = full.createData()
    arms = [i for i in range(compiled_model.nbody) if compiled_model.body(i).name.startswith(("left_", "right_"))]
    # Pinocchio folds both fixed bases into the universe, whose mass it does not count.
    bases = sum(float(compiled_model.body(f"{arm}_panda_link0").mass[0]) for arm in ARMS)
    assert sum(compiled_model.body_mass[arms]) - bases == pytest.approx(pin.computeTotalMass(full, data), abs=1e-9)


def test_home_lies_well_inside_the_limits():
    assert (HOME > Q_LOWER + 0.3).all()
    assert (HOME < Q_UPPER - 0.3).all()
    assert HOME.tolist() == [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785] * 2


def test_groups_partition_the_joints():
    assert [JOINT_NAMES[i] for i in range(DOF)[GROUPS["left_arm"]]] == list(JOINT_NAMES[:7])
    assert all(name.startswith("right_") for name in JOINT_NAMES[GROUPS["right_arm"]])
    assert JOINT_NAMES[GROUPS["both_arms"]] == JOINT_NAMES


def test_constants_cannot_be_changed_by_accident():
    with pytest.raises(ValueError, match="read-only"):
        HOME[0] = 1.0


def test_the_urdf_has_two_prefixed_arms_on_one_world():
    robot = ET.fromstring(description.pair_urdf(DUAL_PANDA))
    links = [link.attrib["name"] for link in robot.iter("link")]
    assert len(links) == len(set(links))
    assert links[0] == "world"
    for arm in ARMS:
        base = robot.find(f"joint[@name='{arm}_base']")
        assert base.find("parent").attrib["link"] == "world"
        xyz = tuple(float(v) for v in base.find("origin").attrib["xyz"].split())
        assert xyz == BASE_POSITIONS_M[arm]
    assert set(TCP_NAMES) <= set(links)
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
    assert {v.link for v in visuals} == {
        *(f"panda_link{i}" for i in range(8)),
        "panda_hand",
        "panda_leftfinger",
        "panda_rightfinger",
    }
    faces = sum(len(v.faces) for v in visuals)
    assert 0.5 * FACES_PER_ARM < faces < 1.3 * FACES_PER_ARM
    for mesh in visuals:
        assert mesh.faces.max() < len(mesh.vertices)
        assert np.isfinite(mesh.vertices).all()
        assert all(0.0 <= c <= 1.0 for c in mesh.rgba)


def test_visuals_add_nothing_to_the_physics(compiled_model, visual_model):
    assert visual_model.ngeom > compiled_model.ngeom
    assert np.array_equal(visual_model.body_mass, compiled_model.body_mass)
    assert np.array_equal(visual_model.body_inertia, compiled_model.body_inertia)
    for i in range(visual_model.ngeom):
        if visual_model.geom(i).name == "" and visual_model.geom_group[i] == 1:
            assert (visual_model.geom_contype[i], visual_model.geom_conaffinity[i]) == (0, 0)
