"""Joints are mapped to addresses by their transmissions; other actuators are refused."""

from __future__ import annotations

import mujoco
import pytest

from minidual.errors import UsageError
from minidual.plant.addresses import map_joints
from minidual.plant.model import build_spec
from minidual.plant.world import World
from tests.support.panda import FINGER_JOINT_NAMES, JOINT_NAMES


def edited(scene, edit):
    spec = build_spec(scene, visuals=False)
    edit(spec)
    return spec.compile()


def test_addresses_follow_the_transmission(compiled_model):
    addresses = map_joints(compiled_model, JOINT_NAMES, torque=True)
    for name, qpos, qvel, ctrl in zip(
        JOINT_NAMES,
        addresses.qpos,
        addresses.qvel,
        addresses.ctrl,
        strict=True,
    ):
        joint = compiled_model.joint(name)
        assert qpos == joint.qposadr[0]
        assert qvel == joint.dofadr[0]
        assert compiled_model.actuator_trnid[ctrl, 0] == joint.id


def test_the_order_asked_for_is_the_order_given(compiled_model):
    names = JOINT_NAMES[::-1]
    forward, backward = (map_joints(compiled_model, n, torque=True) for n in (JOINT_NAMES, names))
    assert forward.ctrl.tolist() == backward.ctrl.tolist()[::-1]


def test_the_actuators_name_is_not_what_counts(scene):
    def swap_names(spec):
        first = spec.actuator("left_panda_joint1_motor")
        second = spec.actuator("left_panda_joint2_motor")
        first.name = "spare"
        second.name = "left_panda_joint1_motor"
        first.name = "left_panda_joint2_motor"

    model = edited(scene, swap_names)
    addresses = map_joints(model, JOINT_NAMES, torque=True)
    assert model.actuator(int(addresses.ctrl[0])).name == "left_panda_joint2_motor"
    assert model.actuator_trnid[addresses.ctrl[0], 0] == model.joint("left_panda_joint1").id


def test_a_model_without_actuators_is_named():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="j"/><geom size=".1"/></body></worldbody></mujoco>',
    )
    with pytest.raises(UsageError, match=r"model\.nu == 0") as caught:
        map_joints(model, ["j"], torque=True)
    assert "motor" in caught.value.remedy


def test_an_unknown_joint_is_reported_with_those_that_exist(compiled_model):
    with pytest.raises(
        UsageError,
        match=r"no position for joint 'panda_joint1'.*left_panda_finger_joint1",
    ) as caught:
        map_joints(compiled_model, ["panda_joint1"], torque=True)
    assert "prefix" in caught.value.remedy


def test_a_lost_motor_is_named(scene):
    model = edited(scene, lambda spec: spec.delete(spec.actuator("right_panda_joint4_motor")))
    with pytest.raises(UsageError, match="no actuator for joint 'right_panda_joint4'"):
        World(scene, model=model)


def test_a_position_servo_under_a_torque_command_is_refused(scene):
    def servo(spec):
        spec.actuator("left_panda_joint3_motor").set_to_position(kp=100.0)

    with pytest.raises(
        UsageError,
        match=r"left_panda_joint3_motor.*is a position servo; this needs a torque motor",
    ):
        World(scene, model=edited(scene, servo))


def test_a_torque_motor_where_a_servo_belongs_is_refused(compiled_model):
    with pytest.raises(UsageError, match="is a torque motor; this needs a position servo"):
        map_joints(compiled_model, JOINT_NAMES[:1], torque=False)
    assert len(map_joints(compiled_model, FINGER_JOINT_NAMES, torque=False).ctrl) == 4


def test_a_geared_motor_is_refused(scene):
    def gear(spec):
        spec.actuator("left_panda_joint3_motor").gear = [2.0, 0, 0, 0, 0, 0]

    with pytest.raises(UsageError, match="scales its torque"):
        World(scene, model=edited(scene, gear))
