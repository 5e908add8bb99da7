"""Use of limits by a trajectory, between its samples too."""

import dataclasses

import numpy as np
import pytest

from minidual.config.planning import MotionLimits
from minidual.errors import DataError
from minidual.motion.blend import rounded
from minidual.motion.timing import time_path
from minidual.proof.limits import limit_use
from minidual.robot.kinematics import Kinematics
from minidual.robot.trajectory import Trajectory
from tests.support.panda import A_MAX, HOME, JERK_MAX, Q_LOWER, Q_UPPER, V_MAX

DT_S = 0.001


@pytest.fixture(scope="module")
def kinematics():
    return Kinematics()


def three_samples(q, v):
    """A trajectory of three samples that claims no acceleration."""
    return Trajectory(np.arange(3) * DT_S, q, v, np.zeros((3, 14)), "both_arms")


def sines(n=201, fastest=40.0):
    """A trajectory of sines, each joint its own."""
    t = np.arange(n)[:, None] * DT_S
    rng = np.random.default_rng(3)
    w = rng.uniform(1.0, fastest, 14)
    size = rng.uniform(0.01, 0.2, 14)
    phase = rng.uniform(0.0, 6.0, 14)
    q = HOME + size * np.sin(w * t + phase)
    v = size * w * np.cos(w * t + phase)
    a = -size * w**2 * np.sin(w * t + phase)
    return Trajectory(t[:, 0], q, v, a, "both_arms")


def test_the_velocity_of_the_cubic_between_two_samples_counts(kinematics):
    q = np.tile(HOME, (3, 1))
    q[2, 7] += 0.002
    use = limit_use(three_samples(q, np.zeros((3, 14))), kinematics)
    assert use.velocity_ratio == pytest.approx(3.0 / V_MAX[7])


def test_a_cubic_that_leaves_the_position_limit_between_two_samples_is_seen(kinematics):
    q = np.tile(HOME, (3, 1))
    q[:, 5] = Q_UPPER[5]
    v = np.zeros((3, 14))
    v[0, 5] = 1.0
    v[1, 5] = -1.0
    use = limit_use(three_samples(q, v), kinematics)
    # Its control points contain the cubic.
    assert -DT_S / 3.0 - 1e-12 <= use.limit_margin_rad <= -0.25 * DT_S
    assert "position limit" in use.broken


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("dt_s", [0.001, 0.05])
def test_use_is_that_of_samples_a_hundred_times_as_dense(kinematics, seed, dt_s):
    rng = np.random.default_rng(seed)
    q = HOME + np.cumsum(rng.normal(0.0, dt_s, (6, 14)), axis=0)
    v = rng.normal(0.0, 1.0, (6, 14))
    motion = Trajectory(np.arange(6) * dt_s, q, v, np.zeros_like(q), "both_arms")
    use = limit_use(motion, kinematics)
    fine_times = np.linspace(0.0, motion.duration_s, 501)
    position, speed, _ = motion.sample_many(fine_times)
    acceleration = np.abs(np.diff(speed, axis=0)) / (0.01 * dt_s)
    assert use.velocity_ratio == pytest.approx((np.abs(speed) / V_MAX).max(), rel=2e-3)
    assert use.acceleration_ratio == pytest.approx((acceleration / A_MAX).max(), rel=0.02)
    margin = np.minimum(position - Q_LOWER, Q_UPPER - position).min()
    assert margin - dt_s <= use.limit_margin_rad <= margin + 1e-9


def test_an_acceleration_at_an_end_counts_as_a_step_from_rest(kinematics):
    x = np.linspace(0.0, 1.0, 201)[:, None]
    q = HOME + 0.02 * (3 * x**2 - 2 * x**3)
    v = 0.02 * (6 * x - 6 * x**2) / 0.2 + 0.0 * q
    a = 0.02 * (6 - 12 * x) / 0.04 + 0.0 * q
    use = limit_use(Trajectory(np.arange(201) * DT_S, q, v, a, "both_arms"), kinematics)
    assert use.jerk_ratio == pytest.approx((3.0 / DT_S / JERK_MAX).max(), rel=1e-6)


def test_timing_keeps_the_jerk_limit_at_its_ends_without_smoothing(kinematics):
    line = rounded(np.vstack([HOME, HOME + np.eye(14)[0] * 0.5]), 0.1)
    limits = MotionLimits(smoothing_s=0.0)
    motion = time_path(line, "left_arm", limits, kinematics).trajectory
    end_jerk = np.abs(motion.a[[0, -1]]) / DT_S / JERK_MAX
    assert 0.5 < end_jerk.max() <= 0.95 + 1e-6
    assert limit_use(motion, kinematics).broken == ""


@pytest.mark.parametrize("array", ["q", "v", "a"])
@pytest.mark.parametrize("k", [0, 1, 100, 200])
def test_nan_breaks_the_limits(kinematics, array, k):
    """Past the constructor, which refuses it itself."""
    motion = sines(fastest=4.0)
    assert "still move" in limit_use(motion, kinematics).broken  # all limits are kept
    spoiled = getattr(motion, array).copy()
    spoiled[k, 4] = np.nan
    with pytest.raises(DataError, match="not finite"):
        dataclasses.replace(motion, **{array: spoiled})
    object.__setattr__(motion, array, spoiled)
    use = limit_use(motion, kinematics)
    assert "left_panda_joint5" in use.broken
    assert "nan" in use.broken
    numbers = use._replace(broken=0.0)
    assert not np.isfinite(numbers).all()


@pytest.mark.parametrize("values", [[np.inf, -np.inf], [np.nan, 0.0], [0.0, np.inf]])
def test_a_trajectory_refuses_samples_that_are_not_finite(values):
    motion = sines(n=5)
    a = motion.a.copy()
    a[[1, 3], 6] = values
    with pytest.raises(DataError, match="not finite"):
        dataclasses.replace(motion, a=a)


def test_a_trajectory_takes_samples_whose_sum_is_not_finite():
    motion = sines(n=5)
    a = motion.a.copy()
    a[[1, 3], 6] = 1.5e308
    assert dataclasses.replace(motion, a=a).a[1, 6] == 1.5e308
