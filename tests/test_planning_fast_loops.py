"""The planner's compiled loops, held to slower ways of saying the same."""

import dataclasses
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from scipy.interpolate import PPoly

from minidual.collision.errors import TimingError
from minidual.errors import DataError
from minidual.motion import timing
from minidual.motion.blend import rounded
from minidual.motion.smooth_path import SmoothPath
from minidual.motion.timing import MotionLimits, drive, sample_parameters, time_path
from minidual.proof import extremes as loops
from minidual.proof.dynamics import torques
from minidual.proof.extremes import extremes, largest, motion_peaks
from minidual.proof.limits import _acceleration_misfit, _velocity_misfit, limit_use
from minidual.proof.rnea import LANES, arm_torques, link_table
from minidual.robot.constants import GROUPS, HOME, Q_LOWER, Q_UPPER
from minidual.robot.kinematics import Kinematics
from minidual.robot.trajectory import Trajectory

H = 0.001


@pytest.fixture(scope="module")
def kinematics():
    return Kinematics()


def states(rng, n):
    """Random states of both arms, beyond what the limits allow."""
    q = rng.uniform(Q_LOWER - 1.0, Q_UPPER + 1.0, (n, 14))
    return q, rng.normal(0.0, 3.0, (n, 14)), rng.normal(0.0, 20.0, (n, 14))


@pytest.mark.parametrize("n", [1, LANES - 1, LANES, LANES + 1, 300])
def test_torques_are_those_of_pinocchio(kinematics, n):
    q, v, a = states(np.random.default_rng(n), n)
    truth = np.array([kinematics.rnea(*state) for state in zip(q, v, a, strict=True)])
    assert np.abs(torques(q, v, a) - truth).max() < 1e-10
    assert np.abs(truth).max() > 30.0


def test_torques_at_the_corners_of_sine_and_cosine(kinematics):
    """Quarter and half turns, where the reduction to half a turn changes sides, and many turns."""
    turns = np.pi * np.array([-4.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.5, 9.0])
    q = np.repeat(np.concatenate([turns, turns - 1e-12, turns + 1e-12])[:, None], 14, axis=1)
    _, v, a = states(np.random.default_rng(0), len(q))
    truth = np.array([kinematics.rnea(*state) for state in zip(q, v, a, strict=True)])
    assert np.abs(torques(q, v, a) - truth).max() < 1e-10


def test_states_that_repeat_are_skipped_and_only_those(kinematics):
    """An arm that stands, moves for three samples in the middle of a block, and stands again elsewhere."""
    n, moves = 6 * LANES, slice(2 * LANES + 5, 2 * LANES + 8)
    q, v, a = np.tile(HOME, (n, 1)), np.zeros((n, 14)), np.zeros((n, 14))
    v[moves, 3], a[moves, 9] = 1.0, -2.0
    q[moves.stop :, 1] += 0.3
    truth = np.array([kinematics.rnea(*state) for state in zip(q, v, a, strict=True)])
    assert np.abs(torques(q, v, a) - truth).max() < 1e-10
    assert len(np.unique(truth.round(9), axis=0)) >= 3


def test_a_state_that_is_no_number_has_no_torque(kinematics):
    for k in (0, 7, 2 * LANES - 1):
        for what in range(3):
            state = states(np.random.default_rng(1), 2 * LANES)
            state[what][k, 2] = np.nan
            tau = torques(*state)
            assert np.isnan(tau[k, :7]).any()
            assert np.isfinite(np.delete(tau, k, axis=0)).all()
            assert np.isfinite(tau[k, 7:]).all()
    held = np.tile(HOME, (2 * LANES, 1))
    held[:, 0] = np.nan  # repeats, but is no number
    assert np.isnan(torques(held, 0.0 * held[:1].repeat(len(held), 0), np.zeros_like(held))[:, 0]).all()


def test_states_may_be_read_only_lists_or_pieces_but_not_of_another_shape():
    """HOME is read-only; what compiled code takes is a detail that no caller need know."""
    q = np.broadcast_to(HOME, (3, 14))
    still = np.zeros((3, 28))[:, ::2]
    tau = torques(q, still, still)
    assert np.array_equal(tau, torques(np.array(q), np.zeros((3, 14)), np.zeros((3, 14)).tolist()))
    trajectory = wave(fastest=4.0)
    for x in (trajectory.q, trajectory.v, trajectory.a):
        x.setflags(write=False)
    assert "still move" in limit_use(trajectory)[1]
    for bad in (q[:2], q[:, :7]):
        with pytest.raises(ValueError, match="shape"):
            torques(q, bad, still)


def test_an_arm_of_another_build_is_refused(kinematics):
    with pytest.raises(ValueError, match="a chain of hinges is needed"):
        link_table(kinematics.model, slice(3, 10))
    model = pin.buildSampleModelManipulator()  # its hinges turn about other axes, too
    with pytest.raises(ValueError, match=r"is a JointModel\w+ on joint"):
        link_table(model, slice(0, 6))


def test_gravity_is_counted_once(kinematics):
    q = HOME[None].copy()
    still, tau = np.zeros((1, 14)), np.zeros((1, 14))
    for arm in ("left_arm", "right_arm"):
        arm_torques(link_table(kinematics.model, GROUPS[arm]), 0.0, q, still, still, GROUPS[arm].start, tau)
    assert np.abs(tau).max() == 0.0
    assert np.abs(torques(q, still, still)[0] - kinematics.gravity(HOME)).max() < 1e-10


def wave(n=201, fastest=40.0):
    """A trajectory of sines, each joint its own."""
    t = np.arange(n)[:, None] * H
    rng = np.random.default_rng(3)
    w, size, phase = rng.uniform(1.0, fastest, 14), rng.uniform(0.01, 0.2, 14), rng.uniform(0.0, 6.0, 14)
    q = HOME + size * np.sin(w * t + phase)
    return Trajectory(t[:, 0], q, size * w * np.cos(w * t + phase), -size * w**2 * np.sin(w * t + phase), "both_arms")


@pytest.mark.parametrize("n", [2, 3, 8, 9, 10, 17, 201])
def test_extremes_are_those_of_the_samples_and_of_the_middles(n):
    trajectory = wave(n)
    q, v, a = trajectory.sample_many(np.arange(2 * n - 1) * 0.5 * H)
    found = extremes(trajectory.q, trajectory.v, trajectory.a, H)
    changes = np.abs(np.diff(trajectory.a, axis=0))
    for row, truth in (
        (loops.Q_MIN, q.min(axis=0)),
        (loops.Q_MAX, q.max(axis=0)),
        (loops.SPEED, np.abs(v).max(axis=0)),
        (loops.ACCELERATION, np.abs(a).max(axis=0)),
        (loops.CHANGE, changes.max(axis=0)),
        (loops.JUMP, np.abs(np.diff(trajectory.q, axis=0)).max(axis=0)),
        (loops.OFF_VELOCITY, _velocity_misfit(trajectory).max(axis=0)),
        (loops.OFF_ACCELERATION, _acceleration_misfit(trajectory).max(axis=0)),
    ):
        assert np.abs(found[row] - truth).max() < 1e-9, row
    assert np.array_equal(largest(trajectory.v), np.abs(trajectory.v).max(axis=0))


def test_what_happens_only_between_two_samples_is_seen():
    """Ends of a step at the limit, moving outwards: only the middle is beyond."""
    q, v, a = np.zeros((3, 14)), np.zeros((3, 14)), np.zeros((3, 14))
    v[0, 5], v[1, 5] = 1.0, -1.0
    q[2, 7], v[2, 7] = 0.002, 0.0
    found = extremes(q, v, a, H)
    assert found[loops.Q_MAX, 5] == pytest.approx(0.25 * H)
    assert found[loops.SPEED, 7] == pytest.approx(3.0)
    assert np.abs(v[:, 7]).max() == 0.0


@pytest.mark.parametrize("what", ["q", "v", "a"])
@pytest.mark.parametrize("k", [0, 1, 100, 200])
def test_a_sample_that_is_no_number_is_refused(what, k):
    motion = wave(fastest=4.0)
    assert "still move" in limit_use(motion)[1]  # all limits are kept
    spoiled = getattr(motion, what).copy()
    spoiled[k, 4] = np.nan
    with pytest.raises(DataError, match="not finite"):
        dataclasses.replace(motion, **{what: spoiled})
    object.__setattr__(motion, what, spoiled)  # past the constructor, which refuses it itself
    found = extremes(motion.q, motion.v, motion.a, H)
    assert np.isnan(found[:, 4]).any()
    assert np.isfinite(np.delete(found, 4, axis=1)).all()
    use, broken = limit_use(motion)
    assert "left_panda_joint5" in broken
    assert "nan" in broken
    assert np.isnan(use.torque_ratio)


def curve(seed=4, n=5, d=14):
    rng = np.random.default_rng(seed)
    return rounded(np.vstack([np.zeros(d), rng.uniform(-0.5, 0.5, (n - 1, d))]), 0.2)


@pytest.mark.parametrize("d", [3, 14])
@pytest.mark.parametrize("order", [0, 1, 2, 3, 4])
def test_a_smooth_path_is_its_piecewise_polynomial(d, order):
    path = curve(d=d)
    truth = PPoly(path.coefficients, path.knots)
    rng = np.random.default_rng(0)
    s = np.concatenate([path.knots, rng.uniform(-0.1, path.length + 0.1, 300), [np.nan]])  # in any order
    assert np.array_equal(path.at(s, order), truth(s, order), equal_nan=True)


def test_driving_a_path_is_the_chain_rule():
    """Against differences of the path itself, as it is driven along s(t) = length sin^2."""
    path = curve()
    t = np.linspace(0.0, 1.0, 40001)
    s = path.length * np.sin(0.5 * np.pi * t) ** 2
    speed = path.length * 0.5 * np.pi * np.sin(np.pi * t)
    acceleration = path.length * 0.5 * np.pi**2 * np.cos(np.pi * t)
    q, v, a = path.driven(s, speed, acceleration)
    assert np.array_equal(q, path.at(s))
    assert np.array_equal(v, path.at(s, 1) * speed[:, None])
    assert np.abs(np.gradient(q, t, axis=0) - v)[1:-1].max() < 1e-5
    assert np.abs(np.gradient(v, t, axis=0) - a)[1:-1].max() < 1e-3 * np.abs(a).max()


def test_only_curves_of_all_joints_are_driven():
    s = np.linspace(0.0, 0.1, 5)
    with pytest.raises(ValueError, match="3 columns"):
        curve(d=3).driven(s, s, s)
    with pytest.raises(ValueError, match="5 parameters with 4 speeds"):
        curve().driven(s, s[:4], s)


def test_a_path_that_is_no_number_gives_no_trajectory(kinematics):
    path = curve()
    s = np.linspace(0.0, path.length, 50)
    sd = np.sqrt(np.minimum(s, path.length - s))
    broken = path.coefficients.copy()
    broken[4, 3, 2] = np.nan
    with pytest.raises(DataError, match="not finite"):
        drive(SmoothPath(broken, path.knots), s, sd, "both_arms", MotionLimits(), kinematics)


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
    speed, acceleration = np.maximum(0.0, sd[i] + u * x) / stretch, u / stretch**2
    position[-1], speed[-1] = s[-1], 0.0
    copies = max(1, round(smoothing_s / H))
    if copies > 1:
        acceleration[-1] = 0.0
    out = []
    for values, at_end in ((position, s[-1]), (speed, 0.0), (acceleration, 0.0)):
        shifted = [np.concatenate([np.zeros(k), values, np.full(copies - 1 - k, at_end)]) for k in range(copies)]
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


def test_timing_is_the_same_for_any_curve_that_runs_the_same(kinematics):
    """A curve that is only known by its values takes the long way and arrives at the same numbers."""

    class Values:
        def __init__(self, path):
            self.at, self.length, self.knots = path.at, path.length, path.knots

    path = curve()
    short, long = (time_path(x, "both_arms", MotionLimits(), kinematics) for x in (path, Values(path)))
    assert short.digest() == long.digest()


@pytest.mark.parametrize("dof", [1, 7, 14, 21])
def test_acceleration_limits_are_those_of_toppra(dof):
    from toppra.constraint import DiscretizationType, JointAccelerationConstraint  # slow to import

    rng = np.random.default_rng(dof)
    a_max, grid = rng.uniform(1.0, 9.0, dof), np.cumsum(rng.uniform(0.1, 1.0, 30))
    path = timing._OnGrid(rng.standard_normal((30, dof)), rng.standard_normal((30, dof)))
    theirs = JointAccelerationConstraint(np.column_stack([-a_max, a_max]), DiscretizationType.Interpolation)
    mine = timing._accelerations()(a_max)
    assert mine.get_constraint_type() == theirs.get_constraint_type()
    assert mine.identical == theirs.identical
    for x, y in zip(
        mine.compute_constraint_params(path, grid), theirs.compute_constraint_params(path, grid), strict=True
    ):
        assert np.array_equal(x, y) or (x is None and y is None)


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


@pytest.mark.parametrize("n", [2, 8, 9, 10, 201])
def test_peaks_of_a_motion(n):
    t = wave(n)
    truth = [np.abs(x).max(axis=0) for x in (t.v, t.a, np.diff(t.a, axis=0))]
    assert np.array_equal(motion_peaks(t.v, t.a), truth)
    for what, k in (("v", 0), ("v", n - 1), ("a", n // 2)):
        spoiled = {"v": t.v.copy(), "a": t.a.copy()}
        spoiled[what][k, 3] = np.nan
        found = motion_peaks(**spoiled)
        assert np.isnan(found[0 if what == "v" else 1, 3])
        assert np.isfinite(np.delete(found, 3, axis=1)).all()


@pytest.mark.parametrize("spoil", [0.0, np.nan])
def test_a_profile_that_never_arrives_is_refused(spoil):
    s, sd = np.linspace(0.0, 1.0, 11), np.concatenate([[0.0], np.full(9, 0.5), [0.0]])
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
