"""The compiled kernels: the corners that the laws' own tests do not reach."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from minidual.control import kernels
from minidual.control.joint_control import motor_torque
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, pose

HARD = [
    0.0,
    1e-12,
    1e-9,
    1e-7,
    1e-6,
    1e-5,
    1e-3,
    1.0,
    3.0,
    np.pi - 1e-3,
    np.pi - 1e-5,
    np.pi - 1e-8,
    np.pi,
]


@pytest.mark.parametrize("angle", HARD)
def test_turn_at_the_hard_angles(angle):
    rng = np.random.default_rng(3)
    for axis in (*np.eye(3), *rng.standard_normal((20, 3))):
        axis = axis / np.linalg.norm(axis)
        R = Rotation.from_rotvec(angle * axis).as_matrix()
        turned, found = kernels.turn(R, np.eye(3))
        assert found == pytest.approx(angle, abs=1e-12)
        assert Rotation.from_rotvec(turned).as_matrix() == pytest.approx(R, abs=2e-8)
        if angle < np.pi:  # at pi, either way
            assert turned == pytest.approx(angle * axis, abs=2e-8)
            assert kernels.turn(np.eye(3), R)[0] == pytest.approx(-angle * axis, abs=2e-8)


def drawn(rng: np.random.Generator, angle: float) -> Array:
    axis = rng.standard_normal(3)
    return pose(pin.exp3(angle * axis / np.linalg.norm(axis)), rng.standard_normal(3))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-5, 0.3, 3.0])
def test_poses_are_compared_and_approached_as_with_rotation_vectors(angle):
    rng = np.random.default_rng(4)
    for share in (0.0, 0.2, 1.0):
        T = drawn(rng, 2.0)
        way = np.empty(6)
        moved = np.empty((4, 4))
        goal = T @ drawn(rng, angle)
        turned = pin.log3(goal[:3, :3] @ T[:3, :3].T)
        assert kernels.apart(goal, T, way) == pytest.approx(
            (np.linalg.norm(goal[:3, 3] - T[:3, 3]), angle),
            abs=1e-9,
        )
        np.testing.assert_allclose(way, np.r_[goal[:3, 3] - T[:3, 3], turned], atol=1e-9)
        assert kernels.approach(T, goal, share, moved) == kernels.apart(goal, T, way)
        wanted = pose(pin.exp3(share * turned) @ T[:3, :3], T[:3, 3] + share * (goal - T)[:3, 3])
        np.testing.assert_allclose(moved, wanted, atol=1e-9)


@pytest.mark.parametrize("low_high", [(-1.0, 1.0), (0.0, 0.5)])
def test_bounds_hold_and_nan_stays(low_high):
    low, high = low_high
    assert kernels.within(2.0, low, high) == high
    assert kernels.within(-2.0, low, high) == low
    assert kernels.within(0.25, low, high) == 0.25
    assert np.isnan(kernels.within(float("nan"), low, high))


def test_a_nan_reaches_the_torque():
    """A guard downstream can only refuse what it is shown."""
    kinematics = Kinematics()
    a = np.zeros(14)
    a[3] = np.nan
    tau = motor_torque(kinematics, kinematics.robot.home, np.zeros(14), a)
    assert np.isnan(tau[3])
