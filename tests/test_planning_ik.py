"""Inverse kinematics against forward kinematics."""

import numpy as np
import pytest

from minidual.errors import UsageError
from minidual.planning.errors import IKUnreachableError
from minidual.planning.ik import ArmIK, check_pose
from minidual.robot.constants import GROUPS, HOME
from minidual.robot.kinematics import Kinematics


@pytest.fixture(scope="module", params=["left", "right"])
def solver(request):
    return ArmIK(request.param)


def reachable(solver, count, seed):
    rng = np.random.default_rng(seed)
    return [solver.tcp_pose(rng.uniform(solver.lower, solver.upper)) for _ in range(count)]


def test_round_trip(solver):
    """Oracle: the pose of every solution, by the kinematics of both arms, is the one that was asked."""
    kinematics = Kinematics()
    index = ("left", "right").index(solver.arm)
    rng = np.random.default_rng(1)
    for T in reachable(solver, 60, seed=2):
        q = HOME.copy()
        joints = GROUPS[f"{solver.arm}_arm"]
        q[joints] = next(solver.solutions(T, q[joints], rng, 30))
        assert np.abs(kinematics.tcp_poses(q)[index] - T).max() < 1e-6
        assert (q[joints] >= solver.lower).all()
        assert (q[joints] <= solver.upper).all()


def test_most_poses_are_solved_from_home_at_once(solver):
    home = HOME[GROUPS[f"{solver.arm}_arm"]]
    reached = [solver.solve(T, home).reached for T in reachable(solver, 100, seed=3)]
    assert np.mean(reached) > 0.7


def test_jacobian_is_the_derivative_of_the_error(solver):
    rng = np.random.default_rng(4)
    h = 1e-6
    for T in reachable(solver, 10, seed=5):
        q = rng.uniform(solver.lower, solver.upper)
        _, J = solver.error_and_jacobian(q, T)
        numeric = np.empty((6, 7))
        for j in range(7):
            d = np.zeros(7)
            d[j] = h
            numeric[:, j] = (
                solver.error_and_jacobian(q + d, T)[0] - solver.error_and_jacobian(q - d, T)[0]
            ) / (2 * h)
        assert np.abs(J - numeric).max() < 1e-5


def test_solutions_differ_and_repeat(solver):
    T = solver.tcp_pose(HOME[GROUPS[f"{solver.arm}_arm"]])
    first, again = (list(solver.solutions(T, np.zeros(7), np.random.default_rng(6), 20)) for _ in range(2))
    assert len(first) > 3
    assert np.array_equal(first, again)
    for i, q in enumerate(first):
        assert all(np.abs(q - other).max() > 0.05 for other in first[:i])


def test_unreachable_pose_names_the_residual(solver):
    T = solver.tcp_pose(HOME[GROUPS[f"{solver.arm}_arm"]])
    T[0, 3] += 1.0
    with pytest.raises(
        IKUnreachableError, match=rf"{solver.arm} hand cannot reach .* mm and .* rad away"
    ) as caught:
        list(solver.solutions(T, np.zeros(7), np.random.default_rng(7), 5))
    assert caught.value.reason == "ik_unreachable"
    away_mm = float(caught.value.message.split("stays ")[1].split(" mm")[0])
    assert 400 < away_mm < 1000  # one metre farther than a pose inside the reach of 0.85 m


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda T: T[:3], "shape"),
        (lambda T: T * np.nan, "not finite"),
        (lambda T: np.diag([1.0, 1.0, -1.0, 1.0]), "no rigid pose"),
        (lambda T: T * 2.0, "no rigid pose"),
    ],
)
def test_bad_poses_are_refused(spoil, says):
    with pytest.raises(UsageError, match=says):
        check_pose(spoil(np.eye(4)), "the target")
