"""Shortcuts, rounded corners, timing and the trajectory itself."""

import json
from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import PPoly

from minidual.collision.errors import TimingError
from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Box
from minidual.config.planning import MotionLimits
from minidual.errors import DataError, UsageError
from minidual.motion.blend import blended_path, rounded
from minidual.motion.budget import Budget
from minidual.motion.search import EdgeChecker, search
from minidual.motion.shortcut import shortcut
from minidual.motion.speed_profile import sample_parameters
from minidual.motion.timing import time_path
from minidual.proof.scene_engines import SceneEngines
from minidual.robot.kinematics import Kinematics, path_length
from minidual.robot.pair import DUAL_PANDA
from minidual.robot.trajectory import Trajectory
from tests.support.panda import A_MAX, HOME, JERK_MAX, TAU_MAX, V_MAX


@pytest.fixture(scope="module")
def engine():
    return SceneEngines(PlanningScene())


@pytest.fixture(scope="module")
def kinematics():
    return Kinematics()


def zigzag(rng, count=5, size=0.35):
    """A polyline round home, near enough to it to be free."""
    return np.vstack([HOME, HOME + rng.uniform(-size, size, (count - 1, 14)) * 0.5])


def free_checker(engine):
    return EdgeChecker(engine, 0.0, (), 0.03)


def test_shortcut_keeps_ends_and_is_never_longer(engine):
    rng = np.random.default_rng(0)
    for _ in range(3):
        path = zigzag(rng)
        checker = free_checker(engine)
        assert all(checker.edge_free(a, b) for a, b in pairwise(path))
        short = shortcut(path, checker, np.random.default_rng(1), 30)
        assert np.array_equal(short[[0, -1]], path[[0, -1]])
        assert path_length(short) <= path_length(path) + 1e-12
        assert len(short) == 2  # nothing stands between


def test_shortcut_goes_round_what_stands_between():
    """A post between two hand positions: the straight line is blocked, the shortened path is not."""
    scene = PlanningScene().with_obstacles(Box("post", (0.36, 0.25, 0.4), size_m=(0.06, 0.06, 0.8)))
    engine = SceneEngines(scene)
    left = HOME.copy()
    right = HOME.copy()
    left[0] = 0.8
    right[0] = -0.8
    checker = EdgeChecker(engine, 0.01, (), 0.02)
    assert not checker.edge_free(left, right)
    checker.allow(100_000, Budget())
    path = search(checker, np.array([left, right]), slice(0, 7), seed=1)
    short = shortcut(path, checker, np.random.default_rng(0), 60)
    assert path_length(short) < path_length(path)
    assert np.array_equal(short[[0, -1]], np.array([left, right]))
    exact = EdgeChecker(engine, 0.0, (), 0.002)
    assert all(exact.edge_free(a, b) for a, b in pairwise(short))


def test_rounded_corners_are_smooth_and_cut_inside():
    path = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [2.0, 1.5]])
    curve = rounded(path, 0.3)
    assert np.abs(curve.at(np.array([0.0, curve.length])) - path[[0, -1]]).max() < 1e-12
    for knot in curve.knots[1:-1]:
        for order in range(3):  # position, direction and curvature are continuous
            below, above = curve.at(np.array([knot - 1e-9, knot + 1e-9]), order)
            assert np.abs(below - above).max() < 1e-6
    s = np.linspace(0.0, curve.length, 2000)
    numeric = np.gradient(curve.at(s), s, axis=0)
    assert np.abs(numeric - curve.at(s, 1))[1:-1].max() < 1e-4
    corner = curve.at(np.linspace(curve.knots[1], curve.knots[2], 50))
    assert (corner[:, 0] <= 1.0 + 1e-12).all()
    assert (corner[:, 1] >= -1e-12).all()
    assert (
        corner[:, 0] - corner[:, 1] >= 0.7 - 1e-12
    ).all()  # within the triangle that the corner cuts off
    assert np.linalg.norm(curve.at(s, 1), axis=1).max() <= 1.0 + 1e-12


@pytest.mark.parametrize("order", [0, 1, 2])
def test_a_curve_is_the_piecewise_polynomial_of_its_coefficients(order):
    """Against scipy's, at places in no order, on knots, and beyond both ends."""
    rng = np.random.default_rng(5)
    curve = rounded(rng.normal(size=(5, 3)), 0.3)
    s = rng.permutation(np.concatenate([curve.knots, rng.uniform(-0.2, curve.length + 0.2, 200)]))
    other = (
        PPoly(curve.coefficients, curve.knots).derivative(order)
        if order
        else PPoly(curve.coefficients, curve.knots)
    )
    np.testing.assert_allclose(curve.at(s, order), other(s), atol=1e-9)
    assert np.isnan(curve.at(np.array([np.nan, 0.1]), order)).all(axis=1).tolist() == [True, False]


def test_a_blocked_corner_is_rounded_less():
    class OnlyNear:
        """Allows points nearer than 0.02 to the vertex or to one of the straight pieces."""

        def all_free(self, Q):
            return all(
                min(q[0] - 0.0, 1.0 - q[1]) < 2.0 and (q[0] > 0.98 or q[1] < 0.02) for q in Q
            )

    path = np.zeros((3, 14))
    path[1, 0] = path[2, 0] = path[2, 1] = 1.0
    curve = blended_path(path, OnlyNear(), 0.3, 0.01)
    widths = np.diff(curve.knots)
    assert 0.001 < widths[1] < 0.3

    class Never:
        def all_free(self, Q):
            return False

    assert blended_path(path, Never(), 0.3, 0.01) is None


@pytest.fixture(scope="module")
def timed(engine, kinematics):
    path = zigzag(np.random.default_rng(5))
    curve = blended_path(path, free_checker(engine), 0.3, 0.01)
    return path, time_path(curve, "both_arms", MotionLimits(), kinematics)[0]


def test_timing_keeps_limits_on_a_finer_grid_than_it_solved(timed, kinematics):
    _, trajectory = timed
    times = np.arange(0.0, trajectory.duration_s, 0.0001)  # ten times finer than its samples
    q, v, a = trajectory.sample_many(times)
    assert (np.abs(v) <= 0.95 * V_MAX * (1 + 1e-6)).all()
    assert (np.abs(a) <= 0.9 * A_MAX * (1 + 1e-6)).all()
    assert np.max(np.abs(v) / V_MAX) > 0.3 or np.max(np.abs(a) / A_MAX) > 0.8  # it is fast, too
    for k in range(0, len(times), 37):
        assert (np.abs(kinematics.rnea(q[k], v[k], a[k])) <= TAU_MAX).all()


def test_derivatives_are_those_of_the_positions(timed):
    _, t = timed
    assert np.abs(np.gradient(t.q, t.dt_s, axis=0) - t.v)[1:-1].max() < 1e-3
    assert np.abs(np.gradient(t.v, t.dt_s, axis=0) - t.a)[1:-1].max() < 0.5
    assert np.abs(t.v[[0, -1]]).max() == 0.0


def test_acceleration_does_not_jump(timed):
    _, t = timed
    jerk = np.abs(np.diff(t.a, axis=0)) / t.dt_s
    assert (jerk.max(axis=0) < JERK_MAX).all()


def test_timing_starts_and_ends_where_the_path_does(timed):
    path, t = timed
    assert np.abs(t.q[[0, -1]] - path[[0, -1]]).max() < 1e-12


def test_smoothing_keeps_the_path_and_adds_its_window(engine, kinematics):
    curve = blended_path(zigzag(np.random.default_rng(6)), free_checker(engine), 0.3, 0.01)
    plain = time_path(
        curve,
        "both_arms",
        MotionLimits.model_construct(smoothing_s=0.0, jerk_scale=1e6, torque_scale=1e6),
        kinematics,
    )[0]
    smooth = time_path(
        curve,
        "both_arms",
        MotionLimits.model_construct(smoothing_s=0.1, torque_scale=1e6),
        kinematics,
    )[0]
    assert 0.05 < smooth.duration_s - plain.duration_s < 0.4
    s = np.linspace(0.0, curve.length, 4000)
    on_path = curve.at(s)
    for q in smooth.q[:: len(smooth.q) // 20]:
        assert np.abs(on_path - q).max(axis=1).min() < 2e-3
    assert np.abs(np.diff(plain.a, axis=0)).max() > 5 * np.abs(np.diff(smooth.a, axis=0)).max()


def test_jerk_limit_slows_a_path_down(engine, kinematics):
    """The same path under a tenth of the jerk: the limit is kept on the 1 kHz samples, and it costs time."""
    curve = blended_path(zigzag(np.random.default_rng(8)), free_checker(engine), 0.3, 0.01)
    fast = time_path(curve, "both_arms", MotionLimits(), kinematics)[0]
    slow = time_path(curve, "both_arms", MotionLimits(jerk_scale=0.05), kinematics)[0]
    for trajectory, scale in ((fast, 0.95), (slow, 0.05)):
        jerk = np.abs(np.diff(trajectory.a, axis=0)) / trajectory.dt_s
        assert np.max(jerk / JERK_MAX) <= scale * (1 + 1e-6)
    assert slow.duration_s > fast.duration_s


def test_torque_limit_slows_a_path_down(engine, kinematics):
    def used_by(t):
        return kinematics.torque_use(t.q, t.v, t.a, t.dt_s, every=1)[0].max()

    curve = blended_path(zigzag(np.random.default_rng(7)), free_checker(engine), 0.3, 0.01)
    fast = time_path(curve, "both_arms", MotionLimits(), kinematics)[0]
    used = used_by(fast)
    held = max(
        float(np.max(np.abs(kinematics.gravity(q)) / TAU_MAX)) for q in fast.q[::50]
    )  # what gravity alone needs
    limit = 0.5 * (used + held)
    slow = time_path(curve, "both_arms", MotionLimits(torque_scale=limit), kinematics)[0]
    assert used_by(slow) <= limit * 1.01
    assert slow.duration_s > fast.duration_s
    with pytest.raises(TimingError, match="slower"):
        time_path(curve, "both_arms", MotionLimits(torque_scale=0.5 * held), kinematics)[0]


def test_torque_rate_limit_slows_a_path_down(engine, kinematics):
    """Mean rates over 8 ms by Pinocchio, at every sample; without the limit the same path exceeds it."""

    def rate(t):
        tau = np.array([kinematics.rnea(*state) for state in zip(t.q, t.v, t.a, strict=True)])
        return np.abs(tau[8:] - tau[:-8]).max() / 0.008

    curve = blended_path(zigzag(np.random.default_rng(7)), free_checker(engine), 0.3, 0.01)
    unlimited = MotionLimits.model_construct(torque_scale=1e6)
    assert rate(time_path(curve, "both_arms", unlimited, kinematics)[0]) > 1100.0
    assert rate(time_path(curve, "both_arms", MotionLimits(), kinematics)[0]) <= 1000.0


def test_sample_parameters_end_on_the_grid_at_rest():
    s = np.linspace(0.0, 1.0, 50)
    sd = np.sqrt(np.minimum(2.0 * s, 2.0 * (1.0 - s)))
    times, position, speed, _ = sample_parameters(s, sd, smoothing_s=0.05)
    assert position[0] == 0.0
    assert position[-1] == pytest.approx(1.0, abs=1e-12)
    assert speed[-1] == 0.0
    assert (np.diff(position) >= -1e-12).all()
    assert np.abs(np.gradient(position, times) - speed)[1:-1].max() < 1e-3


def make(n=11, **change):
    times = np.arange(n) * 0.001
    values = {
        "times": times,
        "q": np.zeros((n, 14)),
        "v": np.zeros((n, 14)),
        "a": np.zeros((n, 14)),
    }
    return Trajectory(**{**values, **change}, group="both_arms")


@pytest.mark.parametrize(
    ("change", "error", "says"),
    [
        ({"q": np.zeros((11, 7))}, UsageError, "shape"),
        ({"v": np.full((11, 14), np.nan)}, DataError, "not finite"),
        ({"times": np.arange(11) * 0.001 + 0.1}, UsageError, "start at 0"),
        ({"times": np.arange(11)[::-1] * 0.001}, UsageError, "start at 0"),
        ({"times": (np.arange(11) * 0.03) ** 2}, UsageError, "equal steps"),
    ],
)
def test_bad_trajectories_are_refused(change, error, says):
    with pytest.raises(error, match=says):
        make(**change)


def test_sampling_outside_holds_the_ends(timed):
    _, t = timed
    for when, row in ((-1.0, 0), (t.duration_s + 5.0, -1)):
        q, v, _ = t.sample(when)
        assert np.array_equal(q, t.q[row])
        assert np.abs(v).max() < 1e-12
    k = len(t.times) // 2
    assert np.abs(t.sample(float(t.times[k]))[0] - t.q[k]).max() < 1e-12


def test_files_hold_the_trajectory(timed, tmp_path):
    _, t = timed
    t.write_csv(tmp_path / "t.csv", DUAL_PANDA.joint_names)
    table = np.loadtxt(tmp_path / "t.csv", delimiter=",", skiprows=1)
    assert table.shape == (len(t.times), 43)
    assert np.abs(table[:, 1:15] - t.q).max() < 1e-8
    t.write_json(tmp_path / "t.json", DUAL_PANDA.joint_names, every=10)
    data = json.loads((tmp_path / "t.json").read_text())
    assert data["joint_names"][0] == "left_panda_joint1"
    assert np.abs(np.array(data["q_rad"])[-1] - t.q[-1]).max() < 1e-8
