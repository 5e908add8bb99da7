"""Motors move their own joints, and both engines describe one robot."""

import numpy as np
import pytest

from minidual.config.control import SupervisorConfig
from minidual.control.supervisor import Supervisor
from minidual.plant.model import build_spec
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA
from minidual.stages.env_check.model import (
    drivable_joints,
    model_agreement,
    torque_pulse_mapping,
)
from tests.support.env_check_samples import DOF, HOME


class TestMapping:
    def test_all_motors_move_their_own_joint(self, world, kinematics):
        assert torque_pulse_mapping(
            world,
            Supervisor(),
            kinematics,
            tolerance=1e-3,
        ) == tuple(range(DOF))

    def test_every_pulse_passes_the_supervisor(self, world, kinematics, monkeypatch):
        applied = []
        command = world.command
        monkeypatch.setattr(
            world,
            "command",
            lambda tau, fingers: (applied.append(tau), command(tau, fingers)),
        )
        supervisor = Supervisor()
        torque_pulse_mapping(world, supervisor, kinematics)
        pulses = np.array(applied) - kinematics.gravity(HOME)
        assert len(pulses) == DOF + 1
        assert np.abs(pulses).max() == pytest.approx(supervisor.bounds.tau_step, abs=1e-9)

        # A supervisor that stops the arms leaves no joint mapped, instead of being passed by.
        supervisor = Supervisor(SupervisorConfig(torque_scale=0.01))
        assert -1 in torque_pulse_mapping(world, supervisor, kinematics)

    @pytest.mark.parametrize(("a", "b"), [(0, 1), (4, 6), (2, 9), (0, 7)])
    def test_two_swapped_commands_are_found(self, world, kinematics, a, b):
        ctrl = world.joints.ctrl.copy()
        ctrl[[a, b]] = ctrl[[b, a]]
        world.joints = world.joints._replace(ctrl=ctrl)
        expected = list(range(DOF))
        expected[a], expected[b] = b, a
        assert torque_pulse_mapping(world, Supervisor(), kinematics) == tuple(expected)

    def test_a_dead_motor_moves_nothing(self, scene, kinematics):
        spec = build_spec(scene, visuals=False)
        spec.actuator("right_panda_joint2_motor").gainprm[0] = 1.0
        model = spec.compile()
        world = World(scene, model=model)
        model.actuator_forcerange[world.joints.ctrl[8]] = 0.0
        moved = torque_pulse_mapping(world, Supervisor(), kinematics)
        assert moved == (*range(8), -1, *range(9, DOF))

    def test_a_reversed_motor_is_found(self, scene, kinematics, compiled_model):
        world = World(scene, model=compiled_model)
        sign = np.ones(DOF)
        sign[3] = -1.0
        command = world.command
        world.command = lambda tau, fingers: command(sign * tau, fingers)
        assert torque_pulse_mapping(world, Supervisor(), kinematics)[3] == -1

    def test_motors_are_counted_through_the_transmission(self, scene, compiled_model):
        assert len(drivable_joints(compiled_model, DUAL_PANDA)) == DOF
        spec = build_spec(scene, visuals=False)
        spec.delete(spec.actuator("left_panda_joint1_motor"))
        spec.actuator("left_panda_joint2_motor").set_to_position(kp=10.0)
        drivable = drivable_joints(spec.compile(), DUAL_PANDA)
        assert len(drivable) == DOF - 2
        assert not {"left_panda_joint1", "left_panda_joint2"} & set(drivable)


class TestAgreement:
    def test_the_engines_agree(self, world, kinematics):
        differences = model_agreement(world, kinematics, np.random.default_rng(0), 10)
        assert set(differences) == {"position_m", "rotation", "inertia_kg_m2", "bias_nm"}
        assert max(differences.values()) < 1e-11

    def test_a_changed_rotor_inertia_shows_in_the_inertia_alone(self, scene, kinematics):
        spec = build_spec(scene, visuals=False)
        spec.joint("left_panda_joint1").armature = 0.11
        differences = model_agreement(
            World(scene, model=spec.compile()),
            kinematics,
            np.random.default_rng(0),
            2,
        )
        assert differences["inertia_kg_m2"] == pytest.approx(0.01)
        assert max(differences["position_m"], differences["bias_nm"]) < 1e-11

    def test_a_moved_base_shows_in_the_position(self, scene, kinematics):
        spec = build_spec(scene, visuals=False)
        spec.body("right_panda_link0").pos += [0.001, 0.0, 0.0]
        differences = model_agreement(
            World(scene, model=spec.compile()),
            kinematics,
            np.random.default_rng(0),
            2,
        )
        assert differences["position_m"] == pytest.approx(0.001)

    def test_a_changed_mass_shows_in_gravity(self, world):
        other = Kinematics()
        other.model = other.model.copy()
        other.model.inertias[5].mass += 0.1
        other.data = other.model.createData()
        assert model_agreement(world, other, np.random.default_rng(0), 2)["bias_nm"] > 1e-3
