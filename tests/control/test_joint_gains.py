"""Joint gains come from inertia, and what is documented of them is what is computed; friction is cancelled."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from minidual.control.joint_control import ComputedTorque, JointLoop, motor_torque
from minidual.plant.model import build_spec
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Robot
from minidual.stages.env_check.tracking import sine_reference
from tests.support.panda import A_MAX, DOF, HOME, JOINT_ARMATURE, JOINT_DAMPING, JOINT_NAMES

ZERO = np.zeros(DOF)


WN = 20.0
"""Natural frequency of the joint loop [rad/s]."""


def inertia(kinematics):
    """M_jj at home (n,) [kg m^2]: what joint j moves while the others hold still, rotor included."""
    return np.diag(kinematics.mass_matrix(HOME)).copy()


def table(kinematics):
    """One arm at home, in Markdown; `alone` is what a joint moves while the others are free."""
    M = inertia(kinematics)
    alone = 1.0 / np.diag(np.linalg.inv(kinematics.mass_matrix(HOME)))
    return [
        f"| {j + 1} | {M[j]:.3f} | {JOINT_ARMATURE / M[j]:.0%} | {alone[j]:.3f} "
        f"| {WN**2 * M[j]:.1f} | {2.0 * WN * M[j]:.2f} | {A_MAX[j] / WN**2:.3f} |"
        for j in range(DOF // 2)
    ]


def test_the_inertia_is_what_mujoco_sees(world, kinematics):
    world.reset()
    full = np.zeros((world.model.nv, world.model.nv))
    mujoco.mj_fullM(world.model, world.data, full)
    assert inertia(kinematics) == pytest.approx(np.diag(full)[world.joints.qvel], abs=1e-10)


def test_the_controller_has_these_gains(kinematics):
    """Columns of its answer to errors of one joint at a time, far from the motors' limits."""
    controller = ComputedTorque(kinematics)
    M = inertia(kinematics)
    h = 1e-4
    rest = controller.torque(HOME, ZERO, HOME, ZERO, ZERO)
    for j in range(DOF):
        e = h * np.eye(DOF)[j]
        stiffness = (controller.torque(HOME, ZERO, HOME + e, ZERO, ZERO) - rest)[j] / h
        damping = (controller.torque(HOME, ZERO, HOME, e, ZERO) - rest)[j] / h
        assert stiffness == pytest.approx(WN**2 * M[j], rel=1e-8)
        assert damping == pytest.approx(2.0 * WN * M[j], rel=1e-8)


def test_one_number_for_all_would_not_do(kinematics):
    M = inertia(kinematics)
    assert M.max() / M.min() > 10.0


def test_the_bounds_on_the_natural_frequency_hold(world):
    assert 0.1 / world.dt >= WN
    assert np.sqrt(A_MAX.min() / 0.018) >= WN


def test_the_documented_table_is_the_computed_one(kinematics):
    page = (Path(__file__).parents[2] / "docs" / "force-control.md").read_text()
    for line in table(kinematics):
        assert line in page, f"docs/force-control.md lacks: {line}"


class TestFriction:
    @pytest.fixture(scope="class")
    @classmethod
    def stiff_model(cls, scene):
        spec = build_spec(scene, visuals=False)
        for name in JOINT_NAMES:
            spec.joint(name).frictionloss = 0.5
        return spec.compile()

    @staticmethod
    def _knowing(dry_nm):
        return Robot(replace(DUAL_PANDA.arm, friction=dry_nm))

    def _rms(self, scene, model, dry_nm):
        world = World(scene, model=model)
        loop = JointLoop(world, Kinematics())
        loop.controller = ComputedTorque(Kinematics(self._knowing(dry_nm)))
        world.reset(sine_reference(DUAL_PANDA, 0.3, 0.5, 0.0)[0])
        loop.reset()
        errors = []
        for k in range(1000):
            loop.follow(*sine_reference(DUAL_PANDA, 0.3, 0.5, k * world.dt), np.ones(2))
            errors.append(world.q - sine_reference(DUAL_PANDA, 0.3, 0.5, (k + 1) * world.dt)[0])
        return np.linalg.norm(errors)

    def test_dry_friction_is_cancelled_where_the_controller_knows_of_it(self, scene, stiff_model):
        assert self._rms(scene, stiff_model, 0.5) < 0.3 * self._rms(scene, stiff_model, 0.0)

    def test_the_model_has_the_simulated_friction(self, world):
        dofs = world.joints.qvel
        assert np.all(world.model.dof_damping[dofs] == DUAL_PANDA.arm.damping)
        assert np.all(world.model.dof_frictionloss[dofs] == DUAL_PANDA.arm.friction)
        assert DUAL_PANDA.arm.damping == JOINT_DAMPING

    def test_it_is_odd_bounded_and_gentle_at_rest(self):
        with_friction = Kinematics(self._knowing(0.5))
        without = Kinematics()

        def friction(v):
            return motor_torque(with_friction, HOME, v, ZERO) - motor_torque(without, HOME, v, ZERO)

        v = np.linspace(-1.0, 1.0, DOF)
        assert np.allclose(friction(v), -friction(-v))
        assert np.abs(friction(v)).max() == pytest.approx(0.5)
        assert not friction(ZERO).any()
