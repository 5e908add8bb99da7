"""Kinematics and dynamics against MuJoCo, finite differences and each other."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from minidual.config.scene import RobotConfig, SceneConfig
from minidual.plant.world import World
from minidual.robot import pair
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, robot_from

DOF = DUAL_PANDA.dof
ARMS = DUAL_PANDA.sides

RNG_SEED = 11
ARM_NAMES = ("panda", "xarm7", "ur5")


def random_states(n, robot=DUAL_PANDA):
    rng = np.random.default_rng(RNG_SEED)
    return [
        (rng.uniform(robot.q_lower, robot.q_upper), rng.uniform(-robot.v_max, robot.v_max))
        for _ in range(n)
    ]


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_mujoco_and_pinocchio_agree_to_rounding(arm):
    robot = robot_from(RobotConfig(arm=arm))
    world = World(SceneConfig(), robot)
    kinematics = Kinematics(robot)
    for q, v in random_states(5, robot):
        world.reset(q)
        world.data.qvel[world.joints.qvel] = v
        mujoco.mj_forward(world.model, world.data)
        for name, T in zip(robot.tcp_names, kinematics.tcp_poses(q), strict=True):
            body = world.data.body(name)
            assert np.abs(T[:3, 3] - body.xpos).max() < 1e-12
            assert np.abs(T[:3, :3] - body.xmat.reshape(3, 3)).max() < 1e-12
        M = np.zeros((world.model.nv, world.model.nv))
        mujoco.mj_fullM(world.model, world.data, M)
        assert (
            np.abs(
                M[np.ix_(world.joints.qvel, world.joints.qvel)] - kinematics.mass_matrix(q),
            ).max()
            < 1e-12
        )
        assert np.abs(world.data.qfrc_bias[world.joints.qvel] - kinematics.bias(q, v)).max() < 1e-10


@pytest.mark.parametrize("state", random_states(3))
def test_jacobians_are_the_derivative_of_the_poses(kinematics, state):
    q, _ = state
    analytic = [J.copy() for J in kinematics.tcp_jacobians(q)]
    h = 1e-6
    for arm in range(2):
        numeric = np.empty((6, DOF))
        for j in range(DOF):
            plus = kinematics.tcp_poses(q + h * np.eye(DOF)[j])[arm].copy()
            minus = kinematics.tcp_poses(q - h * np.eye(DOF)[j])[arm].copy()
            numeric[:3, j] = (plus[:3, 3] - minus[:3, 3]) / (2 * h)
            turn = plus[:3, :3] @ minus[:3, :3].T  # a rotation in world axes
            numeric[3:, j] = pin.log3(turn) / (2 * h)
        assert np.abs(numeric - analytic[arm]).max() < 1e-7


def test_jacobians_match_mujocos(world, kinematics):
    q, _ = random_states(1)[0]
    world.reset(q)
    for arm, J in zip(ARMS, kinematics.tcp_jacobians(q), strict=True):
        linear = np.zeros((3, world.model.nv))
        angular = np.zeros((3, world.model.nv))
        body = world.model.body(f"{arm}_panda_hand_tcp").id
        mujoco.mj_jacBody(world.model, world.data, linear, angular, body)
        assert np.abs(np.vstack([linear, angular])[:, world.joints.qvel] - J).max() < 1e-12


def test_an_arm_moves_its_own_hand_only(kinematics):
    left, right = kinematics.tcp_jacobians(random_states(1)[0][0])
    assert not left[:, 7:].any()
    assert not right[:, :7].any()


def test_inverse_dynamics_is_mass_times_acceleration_plus_bias(kinematics):
    q, v = random_states(1)[0]
    a = np.linspace(-3.0, 3.0, DOF)
    tau = kinematics.rnea(q, v, a)
    assert np.abs(tau - (kinematics.mass_matrix(q) @ a + kinematics.bias(q, v))).max() < 1e-10
    assert np.abs(kinematics.gravity(q) - kinematics.bias(q, np.zeros(DOF))).max() < 1e-10


def test_gravity_is_the_gradient_of_the_potential_energy(kinematics):
    import pinocchio as pin

    q, _ = random_states(1)[0]
    h = 1e-6
    gradient = [
        (
            pin.computePotentialEnergy(kinematics.model, kinematics.data, q + h * e)
            - pin.computePotentialEnergy(kinematics.model, kinematics.data, q - h * e)
        )
        / (2 * h)
        for e in np.eye(DOF)
    ]
    assert np.abs(kinematics.gravity(q) - gradient).max() < 1e-6


def test_the_mass_matrix_is_symmetric_and_positive(kinematics):
    for q, _ in random_states(5):
        M = kinematics.mass_matrix(q)
        assert np.array_equal(M, M.T)
        assert np.linalg.eigvalsh(M).min() > 0.1  # at least the rotors


def test_at_home_both_hands_point_down_in_front_of_their_bases(kinematics):
    from tests.support.panda import BASE_POSITIONS_M, HOME

    for arm, T in zip(ARMS, kinematics.tcp_poses(HOME), strict=True):
        assert T[:3, 2] == pytest.approx([0.0, 0.0, -1.0], abs=2e-3)
        assert T[1, 3] == pytest.approx(BASE_POSITIONS_M[arm][1], abs=1e-3)
        assert 0.25 < T[0, 3] < 0.4
        assert T[2, 3] > 0.3


class TestPoses:
    rotations = Rotation.random(20, random_state=3)

    def test_inverse(self):
        for R in self.rotations:
            T = pair.pose(R.as_matrix(), (0.3, -0.2, 0.9))
            assert np.abs(pair.inverse(T) @ T - np.eye(4)).max() < 1e-14

    @pytest.mark.parametrize("angle", [-3.0, -0.4, 0.0, 1e-9, 2.0, np.pi])
    def test_elementary_rotations(self, angle):
        assert pair.rot_x(angle) == pytest.approx(
            Rotation.from_euler("x", angle).as_matrix(),
            abs=1e-15,
        )
        assert pair.rot_z(angle) == pytest.approx(
            Rotation.from_euler("z", angle).as_matrix(),
            abs=1e-15,
        )
