"""Timing: speed profiles, their samples, the limits of a trajectory; each held to a slower way of saying the same."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import PPoly

from minidual.collision.errors import TimingError
from minidual.config.planning import MotionLimits
from minidual.errors import DataError
from minidual.motion import timing
from minidual.motion.blend import SmoothPath, rounded
from minidual.motion.timing import fastest_profile, sample_parameters
from minidual.proof.scene_engines import limit_use
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA
from minidual.robot.trajectory import Trajectory

HOME = DUAL_PANDA.home
Q_LOWER = DUAL_PANDA.q_lower
Q_UPPER = DUAL_PANDA.q_upper
JERK_MAX = DUAL_PANDA.jerk_max
H = 0.001


@pytest.fixture(scope="module")
def kinematics():
    return Kinematics()


def states(rng, n):
    """Random states of both arms, beyond what the limits allow."""
    q = rng.uniform(Q_LOWER - 1.0, Q_UPPER + 1.0, (n, 14))
    return q, rng.normal(0.0, 3.0, (n, 14)), rng.normal(0.0, 20.0, (n, 14))


@pytest.mark.parametrize("n", [1, 300])
def test_torques_in_one_call_are_those_of_the_states(kinematics, n):
    q, v, a = states(np.random.default_rng(n), n)
    truth = np.array([kinematics.rnea(*state) for state in zip(q, v, a, strict=True)])
    assert np.abs(kinematics.torques(q, v, a) - truth).max() < 1e-10
    resting = q.copy(), v.copy(), a.copy()
    resting[0][:, 7:], resting[1][:, 7:], resting[2][:, 7:] = (
        q[0, 7:],
        0.0,
        0.0,
    )  # one arm stands still
    truth = np.array([kinematics.rnea(*state) for state in zip(*resting, strict=True)])
    assert np.abs(kinematics.torques(*resting) - truth).max() < 1e-10
    a[n // 2, 3] = np.nan
    spoiled = kinematics.torques(q, v, a)
    assert np.isnan(spoiled[n // 2]).any()
    assert np.isfinite(spoiled[np.arange(n) != n // 2]).all()


def test_what_happens_only_between_two_samples_is_seen(kinematics):
    """Samples at the velocity limit, and at the position limit while they move outwards."""
    q = np.tile(HOME, (3, 1))
    v = np.zeros((3, 14))
    a = np.zeros((3, 14))
    q[2, 7] += 0.002
    use, _ = limit_use(Trajectory(np.arange(3) * H, q, v, a, "both_arms"), kinematics)
    assert use["velocity_ratio"] == pytest.approx(3.0 / DUAL_PANDA.v_max[7])
    q, v[0, 5], v[1, 5] = np.tile(HOME, (3, 1)), 1.0, -1.0
    q[:, 5] = Q_UPPER[5]
    use, broken = limit_use(Trajectory(np.arange(3) * H, q, v, a, "both_arms"), kinematics)
    assert (
        -H / 3.0 - 1e-12 <= use["limit_margin_rad"] <= -0.25 * H
    )  # its control points contain the cubic
    assert "position limit" in broken


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("dt_s", [0.001, 0.05])
def test_limits_hold_on_the_whole_cubic_between_samples(kinematics, seed, dt_s):
    """Against samples a hundred times as dense, of position, speed and acceleration."""
    rng = np.random.default_rng(seed)
    q = HOME + np.cumsum(rng.normal(0.0, dt_s, (6, 14)), axis=0)
    v = rng.normal(0.0, 1.0, (6, 14))
    motion = Trajectory(np.arange(6) * dt_s, q, v, np.zeros_like(q), "both_arms")
    use, _ = limit_use(motion, kinematics)
    fine = np.linspace(0.0, motion.duration_s, 501)
    x, speed, _ = motion.sample_many(fine)
    acceleration = np.abs(np.diff(speed, axis=0)) / (0.01 * dt_s)
    assert use["velocity_ratio"] == pytest.approx(
        (np.abs(speed) / DUAL_PANDA.v_max).max(),
        rel=2e-3,
    )
    assert use["acceleration_ratio"] == pytest.approx(
        (acceleration / DUAL_PANDA.a_max).max(),
        rel=0.02,
    )
    margin = np.minimum(x - Q_LOWER, Q_UPPER - x).min()
    assert margin - dt_s <= use["limit_margin_rad"] <= margin + 1e-9


def test_a_motion_that_starts_or_ends_with_an_acceleration_needs_its_jerk(kinematics):
    """Before, the arms' rest before and after it did not count."""
    x = np.linspace(0.0, 1.0, 201)[:, None]
    q = HOME + 0.02 * (3 * x**2 - 2 * x**3)
    v = 0.02 * (6 * x - 6 * x**2) / 0.2 + 0.0 * q
    a = 0.02 * (6 - 12 * x) / 0.04 + 0.0 * q
    use, _ = limit_use(Trajectory(np.arange(201) * H, q, v, a, "both_arms"), kinematics)
    assert use["jerk_ratio"] == pytest.approx((3.0 / H / JERK_MAX).max(), rel=1e-6)
    limits = MotionLimits(smoothing_s=0.0)
    line = rounded(np.vstack([HOME, HOME + np.eye(14)[0] * 0.5]), 0.1)
    motion, _ = timing.time_path(line, "left_arm", limits, kinematics)
    ends = np.abs(motion.a[[0, -1]]) / H / JERK_MAX
    assert 0.5 < ends.max() <= 0.95 + 1e-6
    assert limit_use(motion, kinematics)[1] == ""


def wave(n=201, fastest=40.0):
    """A trajectory of sines, each joint its own."""
    t = np.arange(n)[:, None] * H
    rng = np.random.default_rng(3)
    w = rng.uniform(1.0, fastest, 14)
    size = rng.uniform(0.01, 0.2, 14)
    phase = rng.uniform(0.0, 6.0, 14)
    q = HOME + size * np.sin(w * t + phase)
    return Trajectory(
        t[:, 0],
        q,
        size * w * np.cos(w * t + phase),
        -size * w**2 * np.sin(w * t + phase),
        "both_arms",
    )


@pytest.mark.parametrize("what", ["q", "v", "a"])
@pytest.mark.parametrize("k", [0, 1, 100, 200])
def test_a_sample_that_is_no_number_is_refused(kinematics, what, k):
    motion = wave(fastest=4.0)
    assert "still move" in limit_use(motion, kinematics)[1]  # all limits are kept
    spoiled = getattr(motion, what).copy()
    spoiled[k, 4] = np.nan
    with pytest.raises(DataError, match="not finite"):
        dataclasses.replace(motion, **{what: spoiled})
    object.__setattr__(motion, what, spoiled)  # past the constructor, which refuses it itself
    use, broken = limit_use(motion, kinematics)
    assert "left_panda_joint5" in broken
    assert "nan" in broken
    assert not all(np.isfinite(x) for x in use.values())


def curve(seed=4, n=5, d=14):
    rng = np.random.default_rng(seed)
    return rounded(np.vstack([np.zeros(d), rng.uniform(-0.5, 0.5, (n - 1, d))]), 0.2)


@pytest.mark.parametrize("d", [3, 14])
@pytest.mark.parametrize("order", [0, 1, 2, 3, 4])
def test_a_smooth_path_is_its_piecewise_polynomial(d, order):
    path = curve(d=d)
    truth = PPoly(path.coefficients, path.knots)
    rng = np.random.default_rng(0)
    s = np.concatenate(
        [path.knots, rng.uniform(-0.1, path.length + 0.1, 300), [np.nan]],
    )  # in any order
    np.testing.assert_allclose(
        path.at(s, order),
        truth(s, order),
        atol=1e-9 * np.abs(truth(s[:-1], order)).max(),
    )


def test_a_path_that_is_no_number_gives_no_trajectory(kinematics, monkeypatch):
    path = curve()
    s = np.linspace(0.0, path.length, 50)
    sd = np.sqrt(np.minimum(s, path.length - s))
    broken = path.coefficients.copy()
    broken[4, 3, 2] = np.nan
    monkeypatch.setattr(timing, "fastest_profile", lambda *_: (s, sd))
    with pytest.raises(DataError, match="not finite"):
        timing.time_path(SmoothPath(broken, path.knots), "both_arms", MotionLimits(), kinematics)


def by_arrays(s, sd, smoothing_s):
    """What `sample_parameters` says, step by step on whole arrays."""
    passed = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(s) / (sd[1:] + sd[:-1]))])
    n = int(np.ceil(passed[-1] / H - 1e-9))
    stretch = n * H / passed[-1]
    t = np.arange(n + 1) * H / stretch
    i = np.clip(np.searchsorted(passed, t, side="right") - 1, 0, len(s) - 2)
    u = (sd[i + 1] ** 2 - sd[i] ** 2) / (2.0 * (s[i + 1] - s[i]))
    x = t - passed[i]
    position = np.clip(s[i] + sd[i] * x + 0.5 * u * x**2, 0.0, s[-1])
    speed = np.maximum(0.0, sd[i] + u * x) / stretch
    acceleration = u / stretch**2
    position[-1] = s[-1]
    speed[-1] = 0.0
    copies = max(1, round(smoothing_s / H))
    if copies > 1:
        acceleration[-1] = 0.0
    out = []
    for values, at_end in ((position, s[-1]), (speed, 0.0), (acceleration, 0.0)):
        shifted = [
            np.concatenate([np.zeros(k), values, np.full(copies - 1 - k, at_end)])
            for k in range(copies)
        ]
        out.append(np.mean(shifted, axis=0))
    return out


@pytest.mark.parametrize("smoothing_s", [0.0, 0.001, 0.002, 0.04])
def test_samples_of_a_profile_are_means_of_its_shifted_copies(smoothing_s):
    rng = np.random.default_rng(2)
    s = np.concatenate([[0.0], np.cumsum(rng.uniform(0.005, 0.02, 80))])
    sd = np.sqrt(np.minimum(4.0 * s, 3.0 * (s[-1] - s)) * rng.uniform(0.7, 1.0, len(s)))
    times, *found = sample_parameters(s, sd, smoothing_s)
    assert np.abs(times - np.arange(len(times)) * H).max() < 1e-12
    for mine, truth in zip(found, by_arrays(s, sd, smoothing_s), strict=True):
        assert np.abs(mine[:-1] - truth[:-1]).max() < 1e-11
    assert found[0][-1] == s[-1]
    assert found[1][-1] == 0.0


def test_the_grid_hits_every_knot_and_is_fine_enough():
    path = curve()
    grid = timing._grid(path)
    assert np.isin(path.knots, grid).all()
    assert np.diff(grid).max() <= path.length / 100.0 * (1.0 + 1e-12)
    assert np.diff(grid).min() > 0.0
    for a, b in pairwise(path.knots):
        inside = grid[(grid >= a) & (grid <= b)]
        assert len(inside) >= 9
        assert np.abs(inside - np.linspace(a, b, len(inside))).max() < 1e-14


@pytest.mark.filterwarnings("ignore::SyntaxWarning")  # unescaped backslashes in its docstrings
@pytest.mark.parametrize("dof", [1, 6, 14, 21])
def test_the_fastest_profile_is_that_of_toppra(dof):
    import toppra  # slow to import
    from toppra.algorithm import TOPPRA
    from toppra.constraint import (
        DiscretizationType,
        JointAccelerationConstraint,
        JointVelocityConstraint,
    )
    from toppra.interpolator import AbstractGeometricPath

    class Path(AbstractGeometricPath):
        dof = property(lambda _: dof)
        waypoints = None
        path_interval = property(lambda _: np.array([0.0, path.length]))

        def __call__(self, s, order=0):
            found = path.at(np.atleast_1d(s), order)
            return found if np.ndim(s) else found[0]

    toppra.setup_logging("ERROR")
    for seed in range(5):
        rng = np.random.default_rng([dof, seed])
        path = curve(seed=seed, n=2 + seed, d=dof)
        v_max = rng.uniform(1.0, 3.0, dof)
        a_max = rng.uniform(5.0, 20.0, dof)
        s, sd = fastest_profile(path, np.arange(dof), v_max, a_max)
        both = DiscretizationType.Interpolation
        limits = [
            JointVelocityConstraint(np.column_stack([-v_max, v_max])),
            JointAccelerationConstraint(np.column_stack([-a_max, a_max]), both),
        ]
        truth = TOPPRA(
            limits,
            Path(),
            gridpoints=s,
            solver_wrapper="seidel",
        ).compute_parameterization(0, 0)[1]
        assert np.abs(sd - truth).max() < 1e-5
        assert (sd[[0, -1]] == 0.0).all()


@pytest.mark.parametrize("spoil", [np.nan, np.inf])
def test_a_path_whose_derivative_is_not_finite_has_no_profile(spoil):
    path = curve()
    path.coefficients[3, 2, 5] = spoil
    with pytest.raises(TimingError, match="not finite"), np.errstate(invalid="ignore"):
        fastest_profile(path, np.arange(14), np.ones(14), np.ones(14))


@pytest.mark.parametrize("spoil", [0.0, np.nan])
def test_a_profile_that_never_arrives_is_refused(spoil):
    s = np.linspace(0.0, 1.0, 11)
    sd = np.concatenate([[0.0], np.full(9, 0.5), [0.0]])
    assert len(sample_parameters(s, sd)[0]) > 2000
    sd[4:6] = spoil
    with pytest.raises(TimingError, match="no finite time"):
        sample_parameters(s, sd)


@pytest.mark.parametrize("values", [[np.inf, -np.inf], [np.nan, 0.0], [0.0, np.inf]])
def test_infinite_samples_are_refused_and_great_ones_are_not(values):
    motion = wave(n=5)
    a = motion.a.copy()
    a[[1, 3], 6] = values
    with pytest.raises(DataError, match="not finite"):
        dataclasses.replace(motion, a=a)
    a[[1, 3], 6] = 1.5e308  # finite, though their sum is not
    assert dataclasses.replace(motion, a=a).a[1, 6] == 1.5e308
