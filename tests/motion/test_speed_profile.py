"""The fastest speed along a path and its samples, each held to a slower way to compute it."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import PPoly

from minidual.collision.errors import TimingError
from minidual.config.planning import MotionLimits
from minidual.errors import DataError
from minidual.motion import timing
from minidual.motion.blend import SmoothPath
from minidual.motion.speed_profile import (
    DT_S,
    PathSamples,
    fastest_profile,
    path_grid,
    sample_parameters,
)
from minidual.robot.kinematics import Kinematics
from tests.support.planning_oracles import rounded_polyline, toppra_profile


@pytest.mark.parametrize("d", [3, 14])
@pytest.mark.parametrize("order", [0, 1, 2, 3, 4])
def test_a_smooth_path_is_its_piecewise_polynomial(d, order):
    path = rounded_polyline(d=d)
    truth = PPoly(path.coefficients, path.knots)
    rng = np.random.default_rng(0)
    anywhere = rng.uniform(-0.1, path.length + 0.1, 300)
    s = np.concatenate([path.knots, anywhere, [np.nan]])  # in any order
    scale = np.abs(truth(s[:-1], order)).max()
    np.testing.assert_allclose(path.at(s, order), truth(s, order), atol=1e-9 * scale)


def test_a_path_with_a_nan_coefficient_gives_no_trajectory(monkeypatch):
    path = rounded_polyline()
    s = np.linspace(0.0, path.length, 50)
    speeds = np.sqrt(np.minimum(s, path.length - s))
    coefficients = path.coefficients.copy()
    coefficients[4, 3, 2] = np.nan
    broken = SmoothPath(coefficients, path.knots)
    monkeypatch.setattr(timing, "fastest_profile", lambda *_: (s, speeds))
    with pytest.raises(DataError, match="not finite"):
        timing.time_path(broken, "both_arms", MotionLimits(), Kinematics())


def sampled_step_by_step(s, speeds, smoothing_s):
    """Return position, speed and acceleration as `sample_parameters` defines them."""
    grid_times = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(s) / (speeds[1:] + speeds[:-1]))])
    n = int(np.ceil(grid_times[-1] / DT_S - 1e-9))
    stretch = n * DT_S / grid_times[-1]
    t = np.arange(n + 1) * DT_S / stretch
    i = np.clip(np.searchsorted(grid_times, t, side="right") - 1, 0, len(s) - 2)
    u = (speeds[i + 1] ** 2 - speeds[i] ** 2) / (2.0 * (s[i + 1] - s[i]))
    x = t - grid_times[i]
    position = np.clip(s[i] + speeds[i] * x + 0.5 * u * x**2, 0.0, s[-1])
    speed = np.maximum(0.0, speeds[i] + u * x) / stretch
    acceleration = u / stretch**2
    position[-1] = s[-1]
    speed[-1] = 0.0
    copies = max(1, round(smoothing_s / DT_S))
    if copies > 1:
        acceleration[-1] = 0.0
    means = []
    for values, at_end in ((position, s[-1]), (speed, 0.0), (acceleration, 0.0)):
        shifted = [
            np.concatenate([np.zeros(k), values, np.full(copies - 1 - k, at_end)])
            for k in range(copies)
        ]
        means.append(np.mean(shifted, axis=0))
    return means


@pytest.mark.parametrize("smoothing_s", [0.0, 0.001, 0.002, 0.04])
def test_samples_of_a_profile_are_means_of_its_shifted_copies(smoothing_s):
    rng = np.random.default_rng(2)
    s = np.concatenate([[0.0], np.cumsum(rng.uniform(0.005, 0.02, 80))])
    highest = np.sqrt(np.minimum(4.0 * s, 3.0 * (s[-1] - s)))
    speeds = highest * rng.uniform(0.7, 1.0, len(s))
    samples = sample_parameters(s, speeds, smoothing_s)
    assert np.abs(samples.times - np.arange(len(samples.times)) * DT_S).max() < 1e-12
    truths = sampled_step_by_step(s, speeds, smoothing_s)
    for values, truth in zip(samples[1:], truths, strict=True):
        assert np.abs(values[:-1] - truth[:-1]).max() < 1e-11
    assert samples.s[-1] == s[-1]
    assert samples.speed[-1] == 0.0


def test_samples_end_on_the_grid_at_rest():
    s = np.linspace(0.0, 1.0, 11)
    speeds = np.concatenate([[0.0], np.full(9, 0.5), [0.0]])
    samples = sample_parameters(s, speeds)
    assert isinstance(samples, PathSamples)
    assert np.abs(np.diff(samples.times) - DT_S).max() < 1e-12
    assert samples.s[0] == 0.0
    assert samples.s[-1] == 1.0
    assert samples.speed[-1] == 0.0
    assert (np.diff(samples.s) >= 0.0).all()


def test_the_grid_hits_every_knot_and_is_fine_enough():
    path = rounded_polyline()
    grid = path_grid(path)
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
    for seed in range(5):
        rng = np.random.default_rng([dof, seed])
        path = rounded_polyline(seed=seed, n=2 + seed, d=dof)
        v_max = rng.uniform(1.0, 3.0, dof)
        a_max = rng.uniform(5.0, 20.0, dof)
        s, speeds = fastest_profile(path, np.arange(dof), v_max, a_max)
        assert np.abs(speeds - toppra_profile(path, s, v_max, a_max)).max() < 1e-5
        assert (speeds[[0, -1]] == 0.0).all()


@pytest.mark.parametrize("spoil", [np.nan, np.inf])
def test_a_path_whose_derivative_is_not_finite_has_no_profile(spoil):
    path = rounded_polyline()
    path.coefficients[3, 2, 5] = spoil
    with pytest.raises(TimingError, match="not finite"), np.errstate(invalid="ignore"):
        fastest_profile(path, np.arange(14), np.ones(14), np.ones(14))


@pytest.mark.parametrize("spoil", [0.0, np.nan])
def test_a_profile_that_never_arrives_is_refused(spoil):
    s = np.linspace(0.0, 1.0, 11)
    speeds = np.concatenate([[0.0], np.full(9, 0.5), [0.0]])
    assert len(sample_parameters(s, speeds).times) > 2000
    speeds[4:6] = spoil
    with pytest.raises(TimingError, match="no finite time"):
        sample_parameters(s, speeds)
