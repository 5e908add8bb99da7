"""Joint torques of many states in one call."""

import numpy as np
import pytest

from minidual.robot.kinematics import Kinematics
from tests.support.panda import Q_LOWER, Q_UPPER


@pytest.fixture(scope="module")
def kinematics():
    return Kinematics()


def random_states(rng, n):
    """Random states of both arms, beyond what the limits allow."""
    q = rng.uniform(Q_LOWER - 1.0, Q_UPPER + 1.0, (n, 14))
    v = rng.normal(0.0, 3.0, (n, 14))
    a = rng.normal(0.0, 20.0, (n, 14))
    return q, v, a


def one_by_one(kinematics, q, v, a):
    return np.array([kinematics.rnea(*state) for state in zip(q, v, a, strict=True)])


@pytest.mark.parametrize("n", [1, 300])
def test_torques_in_one_call_are_those_of_the_states(kinematics, n):
    q, v, a = random_states(np.random.default_rng(n), n)
    truth = one_by_one(kinematics, q, v, a)
    assert np.abs(kinematics.torques(q, v, a) - truth).max() < 1e-10


@pytest.mark.parametrize("n", [1, 300])
def test_torques_are_exact_where_one_arm_stands_still(kinematics, n):
    q, v, a = random_states(np.random.default_rng(n), n)
    q[:, 7:] = q[0, 7:]
    v[:, 7:] = 0.0
    a[:, 7:] = 0.0
    truth = one_by_one(kinematics, q, v, a)
    assert np.abs(kinematics.torques(q, v, a) - truth).max() < 1e-10


@pytest.mark.parametrize("n", [1, 300])
def test_nan_spoils_the_torques_of_its_own_state_alone(kinematics, n):
    q, v, a = random_states(np.random.default_rng(n), n)
    a[n // 2, 3] = np.nan
    torques = kinematics.torques(q, v, a)
    assert np.isnan(torques[n // 2]).any()
    others = np.arange(n) != n // 2
    assert np.isfinite(torques[others]).all()
