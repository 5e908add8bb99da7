"""The compiled kernels: the corners that the laws' own tests do not reach."""

import numpy as np
import pytest

from minidual.control import kernels
from minidual.control.joint_control import Motors
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import rotation_log


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, 3.0, np.pi - 1e-3])
def test_turn_at_every_angle(angle):
    rng = np.random.default_rng(3)
    for _ in range(50):
        axis = rng.standard_normal(3)
        axis /= np.linalg.norm(axis)
        K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
        R = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K
        np.testing.assert_allclose(kernels.turn(R, np.eye(3)), angle * axis, atol=2e-8)
        np.testing.assert_allclose(kernels.turn(np.eye(3), R), -angle * axis, atol=2e-8)
        if angle < 3.1:
            np.testing.assert_allclose(kernels.turn(R, np.eye(3)), rotation_log(R), atol=1e-9)


@pytest.mark.parametrize("low_high", [(-1.0, 1.0), (0.0, 0.5)])
def test_bounds_hold_and_nan_stays(low_high):
    low, high = low_high
    assert kernels.within(2.0, low, high) == high
    assert kernels.within(-2.0, low, high) == low
    assert kernels.within(0.25, low, high) == 0.25
    assert np.isnan(kernels.within(float("nan"), low, high))


def test_a_nan_reaches_the_torque():
    """A guard downstream can only refuse what it is shown."""
    kinematics, a = Kinematics(), np.zeros(14)
    a[3] = np.nan
    tau = Motors(kinematics).torque(kinematics.robot.home, np.zeros(14), a)
    assert np.isnan(tau[3])
