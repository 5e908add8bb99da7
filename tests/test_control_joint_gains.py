"""Joint gains come from inertia, and what is documented of them is what is computed; friction is cancelled."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from minidual.control.joint_control import ComputedTorque, JointFriction
from minidual.control.joint_gains import DAMPING_RATIO, NATURAL_FREQUENCY_RAD_S, joint_gains, table
from minidual.control.loop import JointLoop
from minidual.plant.model import build_spec
from minidual.plant.world import World
from minidual.robot.constants import A_MAX, DOF, HOME, JOINT_DAMPING, JOINT_NAMES
from minidual.robot.kinematics import Kinematics
from minidual.stages.env_check.tracking import sine_response

ZERO = np.zeros(DOF)


def test_the_inertia_is_what_mujoco_sees(world, kinematics):
    world.reset()
    full = np.zeros((world.model.nv, world.model.nv))
    mujoco.mj_fullM(world.model, world.data, full)
    gains = joint_gains(kinematics)
    assert gains.inertia == pytest.approx(np.diag(full)[world.joints.qvel], abs=1e-10)
    assert (gains.alone <= gains.inertia + 1e-12).all()  # freed neighbours give way, they never resist more


def test_the_controller_has_these_gains(kinematics):
    """Columns of its answer to errors of one joint at a time, far from the motors' limits."""
    controller, gains, h = ComputedTorque(kinematics), joint_gains(kinematics), 1e-4
    rest = controller.torque(HOME, ZERO, HOME, ZERO, ZERO)
    for j in range(DOF):
        e = h * np.eye(DOF)[j]
        stiffness = (controller.torque(HOME, ZERO, HOME + e, ZERO, ZERO) - rest)[j] / h
        damping = (controller.torque(HOME, ZERO, HOME, e, ZERO) - rest)[j] / h
        assert stiffness == pytest.approx(gains.stiffness[j], rel=1e-8)
        assert damping == pytest.approx(gains.damping[j], rel=1e-8)


def test_one_number_for_all_would_not_do(kinematics):
    inertia = joint_gains(kinematics).inertia[:7]
    assert inertia.max() / inertia.min() > 10.0


def test_the_bounds_on_the_natural_frequency_hold(world):
    assert 0.1 / world.dt >= NATURAL_FREQUENCY_RAD_S
    assert np.sqrt(A_MAX.min() / 0.018) >= NATURAL_FREQUENCY_RAD_S
    assert DAMPING_RATIO == 1.0


def test_the_documented_table_is_the_computed_one():
    page = (Path(__file__).parents[1] / "docs" / "force-control.md").read_text()
    for line in table():
        assert line in page, f"docs/force-control.md lacks: {line}"


class TestFriction:
    @pytest.fixture(scope="class")
    @classmethod
    def stiff_model(cls, scene):
        spec = build_spec(scene, visuals=False)
        for name in JOINT_NAMES:
            spec.joint(name).frictionloss = 0.5
        return spec.compile()

    def _rms(self, scene, model, friction):
        world = World(scene, model=model)
        loop = JointLoop(world, Kinematics())
        loop.controller = ComputedTorque(Kinematics(), friction=friction)
        return sine_response(loop, 0.3, 0.5, 1.0).rms

    def test_dry_friction_is_cancelled_where_the_controller_knows_of_it(self, scene, stiff_model):
        unaware = self._rms(scene, stiff_model, None)
        aware = self._rms(scene, stiff_model, JointFriction(dry=np.full(DOF, 0.5)))
        assert aware < 0.3 * unaware

    def test_the_default_is_the_models_own(self, world):
        friction = JointFriction()
        dofs = world.joints.qvel
        assert np.array_equal(friction.viscous, world.model.dof_damping[dofs])
        assert np.array_equal(friction.dry, world.model.dof_frictionloss[dofs])
        assert friction.is_dry == bool(world.model.dof_frictionloss[dofs].any())
        assert np.all(friction.viscous == JOINT_DAMPING)

    def test_it_is_odd_bounded_and_gentle_at_rest(self):
        friction = JointFriction(dry=np.full(DOF, 0.5))
        v = np.linspace(-1.0, 1.0, DOF)
        assert np.allclose(friction.dry_torque(v), -friction.dry_torque(-v))
        assert np.abs(friction.dry_torque(100.0 * v)).max() <= 0.5
        assert not friction.dry_torque(ZERO).any()
