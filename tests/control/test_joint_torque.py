"""Computed torque does what its law says, to the last digit, and the plant follows."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from minidual.control.joint_control import ComputedTorque, JointLoop
from minidual.plant.model import build_spec
from minidual.plant.world import World
from tests.support.panda import (
    DOF,
    FINGER_JOINT_NAMES,
    HOME,
    JOINT_DAMPING,
    Q_LOWER,
    Q_UPPER,
    TAU_MAX,
    V_MAX,
)

RNG = np.random.default_rng(5)
ZERO = np.zeros(DOF)


def test_the_torque_is_the_law(kinematics):
    controller = ComputedTorque(kinematics, natural_frequency_rad_s=15.0)
    q = HOME + 0.05 * RNG.normal(size=DOF)
    v = 0.1 * RNG.normal(size=DOF)
    q_ref = HOME
    v_ref = 0.1 * RNG.normal(size=DOF)
    a_ref = RNG.normal(size=DOF)
    a = a_ref + 2 * 15.0 * (v_ref - v) + 15.0**2 * (q_ref - q)
    law = kinematics.mass_matrix(q) @ a + kinematics.bias(q, v) + JOINT_DAMPING * v
    assert (np.abs(law) < TAU_MAX).all()
    assert controller.torque(q, v, q_ref, v_ref, a_ref) == pytest.approx(law, abs=1e-10)


def test_mujoco_accelerates_exactly_as_asked(scene, kinematics):
    """With fingers too heavy to move in their joints, as the controller's model has them."""
    spec = build_spec(scene, visuals=False)
    for name in FINGER_JOINT_NAMES:
        spec.joint(name).armature = 1e12
    world = World(scene, model=spec.compile())
    controller = ComputedTorque(kinematics)
    for _ in range(5):
        q = np.clip(HOME + 0.3 * RNG.normal(size=DOF), Q_LOWER, Q_UPPER)
        v = 0.2 * RNG.uniform(-V_MAX, V_MAX)
        a = RNG.uniform(-2.0, 2.0, DOF)
        world.reset(q)
        world.data.qvel[world.joints.qvel] = v
        tau = controller.torque(q, v, q, v, a)
        assert (np.abs(tau) < TAU_MAX).all()
        world.command(tau, np.full(2, 0.04))
        mujoco.mj_forward(world.model, world.data)
        assert world.data.qacc[world.joints.qvel] == pytest.approx(a, abs=1e-8)


def test_torques_are_clipped_to_the_motors(kinematics):
    tau = ComputedTorque(kinematics).torque(HOME, ZERO, Q_UPPER, ZERO, ZERO)
    assert (np.abs(tau) <= TAU_MAX).all()
    assert (np.abs(tau) == TAU_MAX).any()


def test_every_joint_closes_its_error_alike(world, kinematics):
    """One natural frequency for all: equal errors decay together, a shoulder as fast as a wrist."""
    controller = ComputedTorque(kinematics, natural_frequency_rad_s=20.0)
    world.reset(HOME - 0.01)
    for _ in range(150):
        world.command(controller.torque(world.q, world.v, HOME, ZERO, ZERO), np.full(2, 0.04))
        world.step()
    t = 0.15
    expected = 0.01 * (1 + 20.0 * t) * np.exp(-20.0 * t)  # critically damped, from rest
    assert HOME - world.q == pytest.approx(np.full(DOF, expected), rel=0.05)


def test_arms_held_at_home_do_not_sag(world, kinematics):
    loop = JointLoop(world, kinematics)
    for _ in range(500):
        loop.step(HOME, np.ones(2))
    assert np.abs(world.q - HOME).max() < 1e-10


def test_without_gravity_in_the_model_they_do(world, kinematics):
    kinematics.model = kinematics.model.copy()
    kinematics.model.gravity.linear = np.zeros(3)
    loop = JointLoop(world, kinematics)
    for _ in range(500):
        loop.step(HOME, np.ones(2))
    assert np.abs(world.q - HOME).max() > 0.01


def test_a_loop_starts_from_where_the_arms_are(world, kinematics):
    world.reset(HOME + 0.1)
    loop = JointLoop(world, kinematics)
    loop.step(HOME + 0.1, np.ones(2))
    assert np.abs(world.v).max() < 1e-5  # the fingers take up their servos
