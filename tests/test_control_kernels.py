"""The compiled kernels: the corners that the laws' own tests do not reach."""

import numpy as np
import pytest

from minidual.control import kernels
from minidual.robot.poses import rot_x, rot_z, rotation_log


def turn(R: np.ndarray) -> np.ndarray:
    rows = [tuple(float(x) for x in row) for row in R]
    return np.array(kernels.rotation_vector(*rows))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, 3.0, np.pi - 1e-3, np.pi - 1e-6, np.pi - 1e-9])
def test_rotation_vector_at_every_angle(angle):
    rng = np.random.default_rng(3)
    for _ in range(50):
        axis = rng.standard_normal(3)
        axis /= np.linalg.norm(axis)
        K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
        R = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K
        np.testing.assert_allclose(turn(R), angle * axis, atol=2e-8)
        if angle < 3.1:
            np.testing.assert_allclose(turn(R), rotation_log(R), atol=1e-9)


def test_half_turns_about_the_axes():
    for R in (rot_x(np.pi), rot_z(np.pi)):
        assert np.linalg.norm(turn(R)) == pytest.approx(np.pi)


@pytest.mark.parametrize("low_high", [(-1.0, 1.0), (0.0, 0.5)])
def test_bounds_hold_and_nan_stays(low_high):
    low, high = low_high
    assert kernels.within(2.0, low, high) == high
    assert kernels.within(-2.0, low, high) == low
    assert kernels.within(0.25, low, high) == 0.25
    assert np.isnan(kernels.within(float("nan"), low, high))


def test_a_nan_reaches_the_torque():
    """A guard downstream can only refuse what it is shown."""
    tau, v = np.zeros(14), np.zeros(14)
    v[3] = np.nan
    kernels.add_friction(tau, v, np.vstack([np.full(14, 0.1), np.zeros(14), np.full(14, 87.0)]), 0.01)
    assert np.isnan(tau[3])
    assert np.isfinite(np.delete(tau, 3)).all()


def test_least_norm_is_the_pseudo_inverse_and_refuses_what_has_no_rank():
    rng = np.random.default_rng(4)
    J, b, x = rng.standard_normal((6, 7)), rng.standard_normal(6), np.empty(7)
    assert kernels.least_norm(J, b, x)
    np.testing.assert_allclose(x, np.linalg.pinv(J) @ b, atol=1e-10)
    J[5] = 0.0
    assert not kernels.least_norm(J, b, x)
    J[5, 0] = np.nan
    assert not kernels.least_norm(J, b, x)
