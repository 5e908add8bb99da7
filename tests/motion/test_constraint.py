"""The grasp constraint: its Jacobian against finite differences and a second formula, OMPL's view."""

from functools import partial

import numpy as np
import pinocchio as pin
import pytest

from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Box
from minidual.config.scene import SceneConfig
from minidual.errors import UsageError
from minidual.motion.budget import Budget
from minidual.motion.held.constraint import SPACES, GraspConstraint, search_manifold
from minidual.motion.held.hands import HandsIK
from minidual.motion.held.path import HeldPath
from minidual.motion.held.query import scene_holding
from minidual.motion.search import EdgeChecker
from minidual.proof.scene_engines import SceneEngines
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, inverse, rot_z
from minidual.skills.things import thing_of
from minidual.tasks.task import grasp_offsets
from tests.support.panda import Q_LOWER, Q_UPPER

GRASPS = grasp_offsets(SceneConfig())
ROD = thing_of(SceneConfig().object).shape
HELD = {"left": GRASPS[0], "right": GRASPS[1]}
T_LEFT_RIGHT = inverse(GRASPS[0]) @ GRASPS[1]


@pytest.fixture(scope="module")
def constraint():
    return GraspConstraint(T_LEFT_RIGHT, Kinematics())


@pytest.fixture(scope="module")
def q_held():
    left = (0.0253, -0.6431, -0.2768, -2.3208, -0.2559, 1.7128, 0.2325)
    q = np.array([*left, 0.3514, -0.9444, 0.5062, -2.3693, 0.3329, 1.4401, 1.0883])
    kinematics = Kinematics()
    return HandsIK(GRASPS, DUAL_PANDA).solve(kinematics.tcp_poses(q)[0] @ inverse(GRASPS[0]), q)


def value(constraint, q):
    return constraint.value_and_jacobian(q)[0]


def random_configurations(count, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(Q_LOWER, Q_UPPER, (count, 14))


def central_differences(f, q, h):
    return np.column_stack([(f(q + h * e) - f(q - h * e)) / (2.0 * h) for e in np.eye(14)])


def test_jacobian_is_the_derivative(constraint, q_held):
    """Oracle: central differences with Richardson extrapolation, anywhere in the joint limits and on the manifold."""
    rng = np.random.default_rng(1)
    near = [q_held + rng.normal(0.0, s, 14) for s in (0.0, 1e-3, 0.1, 0.3)]
    far = [q for q in random_configurations(60) if np.linalg.norm(value(constraint, q)[3:]) < 2.8]
    assert len(far) > 30
    for q in [*near, *far]:
        coarse, fine = (central_differences(partial(value, constraint), q, h) for h in (2e-4, 1e-4))
        numeric = (4.0 * fine - coarse) / 3.0
        assert np.abs(constraint.value_and_jacobian(q)[1] - numeric).max() < 1e-6


def test_jacobian_by_a_second_formula(constraint):
    """Oracle: log(E) = -log(E^-1), and E^-1 = G T_right^-1 T_left has the body velocity J_left - Ad(A) J_right."""
    kinematics = Kinematics()
    model = kinematics.model
    data = kinematics.data
    left, right = kinematics.tcp_ids
    G = pin.SE3(T_LEFT_RIGHT)
    for q in random_configurations(40, seed=2):
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        A = data.oMf[left].actInv(data.oMf[right])
        J_left = pin.getFrameJacobian(model, data, left, pin.LOCAL)
        J_right = pin.getFrameJacobian(model, data, right, pin.LOCAL)
        E_inverse = G * A.inverse()
        second = -pin.Jlog6(E_inverse) @ (J_left - A.action @ J_right)
        value, J = constraint.value_and_jacobian(q)
        assert np.abs(value + pin.log6(E_inverse).vector).max() < 1e-9
        assert np.abs(J - second).max() < 1e-7 * max(1.0, np.abs(J).max())


def test_a_wrong_jacobian_would_be_seen(constraint, q_held):
    """Negative control: without Jlog6, or with the sign of one hand turned, the comparison above fails."""
    q = q_held + np.random.default_rng(3).normal(0.0, 0.3, 14)
    numeric = central_differences(partial(value, constraint), q, 1e-5)
    wrong = constraint.value_and_jacobian(q)[1] * np.repeat([1.0, -1.0], 7)
    assert np.abs(wrong - numeric).max() > 1e-2


def test_value_vanishes_where_the_hands_hold_and_only_there(constraint, q_held):
    left, right = Kinematics().tcp_poses(q_held)
    assert np.abs(inverse(left) @ right - T_LEFT_RIGHT).max() < 1e-7
    assert np.abs(value(constraint, q_held)).max() < 1e-7
    moved = q_held.copy()
    moved[3] += 0.01
    off = value(constraint, moved)
    assert np.linalg.norm(off[:3]) > 1e-3
    assert np.linalg.norm(off[3:]) == pytest.approx(0.01, rel=1e-3)


def test_a_relative_pose_that_is_none_is_named():
    with pytest.raises(
        UsageError,
        match="relative pose of the hands holds a value that is not finite",
    ):
        GraspConstraint(np.full((4, 4), np.nan), Kinematics())


def test_ompl_gets_the_same_numbers(constraint, q_held):
    q = q_held + 0.05
    found = np.zeros(6)
    J = np.zeros((6, 14))
    constraint.function(q, found)
    constraint.jacobian(q, J)
    expected, J_expected = constraint.value_and_jacobian(q)
    assert np.array_equal(found, expected)
    assert np.array_equal(J, J_expected)


@pytest.fixture(scope="module")
def move(q_held):
    kinematics = Kinematics()
    T_start = kinematics.tcp_poses(q_held)[0] @ inverse(GRASPS[0])
    T_goal = T_start.copy()
    T_goal[:3, :3] = rot_z(0.4) @ T_goal[:3, :3]
    T_goal[:3, 3] += (0.05, -0.25, -0.05)
    path = HeldPath.through([T_start, T_goal])
    Ts = path.poses(np.linspace(0.0, path.length, 60))
    Q, ended = HandsIK(GRASPS, DUAL_PANDA).follow(Ts, q_held)
    assert ended is None
    return Q[-1], T_start, T_goal


@pytest.mark.parametrize("space", SPACES)
def test_ompl_plans_on_the_manifold(constraint, q_held, move, space):
    q_goal, T_start, T_goal = move
    middle = 0.5 * (T_start[:3, 3] + T_goal[:3, 3])
    # A post through the middle of the straight way: only a path round it will do.
    post = Box("post", (middle[0], middle[1], middle[2] - 0.15), size_m=(0.05, 0.05, 0.3))
    scene = scene_holding(PlanningScene().with_obstacles(post), ROD, HELD)
    engine = SceneEngines(scene)
    for seed in (1, 2):
        checker = EdgeChecker(engine, 0.0, (q_held, q_goal), 0.03)
        checker.allow(20_000, Budget())
        path = search_manifold(constraint, checker, q_held, q_goal, space=space, seed=seed)
        assert path is not None
        assert np.abs(path[0] - q_held).max() < 1e-6
        assert np.abs(path[-1] - q_goal).max() < 1e-6
        assert max(np.linalg.norm(value(constraint, q)) for q in path) < 2e-4
        assert not engine.engine("mujoco").collisions(path).any()
        assert np.abs(np.diff(path, axis=0)).max() < 0.5


def test_ompl_gives_up_and_says_so(constraint, q_held, move):
    q_goal, T_start, _ = move
    x, y, z = T_start[:3, 3]
    # Walls in front of and behind the rod, and over it: no way out.
    walls = (
        Box("wall0", (x, y - 0.3, z), size_m=(0.6, 0.02, 0.8)),
        Box("wall1", (x, y + 0.3, z), size_m=(0.6, 0.02, 0.8)),
    )
    scene = scene_holding(PlanningScene(obstacles=walls), ROD, HELD, rests_on=())
    engine = SceneEngines(scene)
    checker = EdgeChecker(engine, 0.0, (), 0.03)
    checker.allow(300, Budget())
    found = search_manifold(constraint, checker, q_held, q_goal, space="atlas", seed=1)
    assert found is None
    with pytest.raises(UsageError, match="no state space 'tangent'"):
        search_manifold(constraint, checker, q_held, q_goal, space="tangent", seed=1)
