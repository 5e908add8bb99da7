"""Inverse kinematics against forward kinematics."""

import numpy as np
import pinocchio as pin
import pytest

from minidual.collision.errors import IKUnreachableError
from minidual.errors import UsageError
from minidual.motion.api import Planner
from minidual.motion.checks import check_pose
from minidual.motion.ik import ArmIK
from minidual.motion.pose_goals import pose_goals
from minidual.robot.kinematics import Kinematics, hinges
from minidual.robot.models import ARM_MODELS
from minidual.robot.pair import DUAL_PANDA, Robot, pose
from minidual.tasks.task import DOWN
from tests.support.panda import GROUPS, HOME


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
    near = rng.uniform(solver.lower, solver.upper, (6, 7)) * 0.9
    cases = [(rng.uniform(solver.lower, solver.upper), T) for T in reachable(solver, 10, seed=5)]
    cases += [(q, solver.tcp_pose(q + 10.0**-k)) for k, q in enumerate(near)]
    for q, T in cases:
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
    first, again = (
        list(solver.solutions(T, np.zeros(7), np.random.default_rng(6), 20)) for _ in range(2)
    )
    assert len(first) > 3
    assert np.array_equal(first, again)
    for i, q in enumerate(first):
        assert all(np.abs(q - other).max() > 0.05 for other in first[:i])


def test_the_posture_for_a_pose_is_the_nearest_and_moves_with_the_pose():
    """A policy that learns from planned motion cannot tell a drawn posture from a picture."""
    engines = Planner().engines()
    rng = np.random.default_rng(8)
    goals = []
    for k in range(30):
        hands = {
            side: pose(DOWN, (0.4 + 0.004 * k, y, 0.1))
            for side, y in (("left", 0.25), ("right", -0.32))
        }
        nearest, *others = pose_goals("both_arms", HOME, hands, engines, rng, 30, 2)
        goals.append(nearest)
        assert all(np.linalg.norm(nearest - HOME) <= np.linalg.norm(q - HOME) for q in others)
    assert np.abs(np.diff(goals, axis=0)).max() < 0.03


def test_the_resting_posture_is_the_nearest_in_its_own_metric(solver):
    """Oracle: the gradient of the cost lies in the rows of the Jacobian, so no motion of the elbow lowers it."""
    home = HOME[GROUPS[f"{solver.arm}_arm"]]
    mobility = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 10.0])
    T = solver.tcp_pose(home)
    for shift in ((0.05, 0.1, -0.2), (-0.1, -0.1, 0.1), (0.1, 0.0, 0.1)):
        T_there = T.copy()
        T_there[:3, 3] += shift
        found = solver.resting(T_there, home, home, mobility)
        _, J = solver.error_and_jacobian(found.q, T_there)
        gradient = (found.q - home) / mobility
        along = J.T @ np.linalg.lstsq(J.T, gradient, rcond=None)[0]
        assert found.reached
        assert np.abs(solver.tcp_pose(found.q) - T_there).max() < 1e-6
        assert np.abs(gradient - along).max() < 1e-4
        elsewhere = solver.solve(T_there, home + np.eye(7)[2] / 2)
        assert elsewhere.reached
        assert np.sum((elsewhere.q - home) ** 2 / mobility) > np.sum(
            (found.q - home) ** 2 / mobility,
        )


def test_where_null_space_steps_end_at_the_limits_descent_still_reaches(solver):
    home = HOME[GROUPS[f"{solver.arm}_arm"]]
    poses = [T for T in reachable(solver, 200, seed=9) if solver.solve(T, home).reached]
    rested = [solver.resting(T, home, home, np.ones(7)) for T in poses]
    assert len(poses) > 100
    assert all(found.reached for found in rested)
    assert (
        max(
            np.abs(solver.tcp_pose(found.q) - T).max()
            for found, T in zip(rested, poses, strict=True)
        )
        < 1e-3
    )


def test_unreachable_pose_names_the_residual(solver):
    T = solver.tcp_pose(HOME[GROUPS[f"{solver.arm}_arm"]])
    T[0, 3] += 1.0
    with pytest.raises(
        IKUnreachableError,
        match=rf"{solver.arm} hand cannot reach .* mm and .* rad away",
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
        (
            lambda T: T + np.eye(4, k=1) * 2e-6,
            "no rigid pose: R R.T is 2e-06 from the identity, det 1.000",
        ),
        (lambda T: T + np.eye(4, k=-3) * 1e-8, "no rigid pose"),
        (lambda T: T + np.diag([0.0, 0.0, 0.0, np.inf]), "not finite"),
    ],
)
def test_bad_poses_are_refused(spoil, says):
    with pytest.raises(UsageError, match=says):
        check_pose(spoil(np.eye(4)), "the target")


def se3(q, solver):
    """The hand's pose by Pinocchio, whose logarithms the compiled ones are held to."""
    kinematics = Kinematics()
    full = HOME.copy()
    full[GROUPS[f"{solver.arm}_arm"]] = q
    return pin.SE3(kinematics.tcp_poses(full)[("left", "right").index(solver.arm)])


def by_pinocchio(solver, q, target):
    """Error and Jacobian as Pinocchio's own functions give them."""
    kinematics = Kinematics()
    full = HOME.copy()
    joints = GROUPS[f"{solver.arm}_arm"]
    full[joints] = q
    offset = se3(q, solver).actInv(target)
    tcp = kinematics.tcp_ids[("left", "right").index(solver.arm)]
    J = pin.computeFrameJacobian(kinematics.model, kinematics.data, full, tcp, pin.LOCAL)[:, joints]
    return pin.log6(offset).vector, -pin.Jlog6(offset.inverse()) @ J


@pytest.mark.parametrize(
    "angle",
    [0.0, 1e-9, 1e-6, 1e-4, 2e-4, 0.01, 1.0, 3.0, np.pi - 2e-3, np.pi - 1e-4],
)
def test_error_and_jacobian_are_those_of_pinocchio_at_every_angle(solver, angle):
    rng = np.random.default_rng(8)
    # Pinocchio itself has fewer digits at small angles (1 - cos) and near half a turn.
    tolerance = 1e-8 if 1e-5 < angle < 1e-3 else 1e-9 if angle < 3.1 else 1e-6
    for _ in range(10):
        q = rng.uniform(solver.lower, solver.upper)
        axis = rng.standard_normal(3)
        offset = pin.SE3(pin.exp3(angle * axis / np.linalg.norm(axis)), rng.uniform(-0.5, 0.5, 3))
        target = se3(q, solver) * offset
        error, J = solver.error_and_jacobian(q, target.homogeneous)
        truth, J_truth = by_pinocchio(solver, q, target)
        assert np.abs(error - truth).max() < tolerance
        assert np.abs(J - J_truth).max() < 1e3 * tolerance
        assert np.abs(solver.tcp_pose(q) - se3(q, solver).homogeneous).max() < 1e-13


def descent(solver, T, q, iterations=80):
    """The descent in numpy and Pinocchio: slow and plain."""
    target = pin.SE3(T)
    q = np.clip(q, solver.lower, solver.upper)
    damping = 1e-3
    error, J = by_pinocchio(solver, q, target)
    for _ in range(iterations):
        if error @ error < 1e-14 or damping > 1e4:
            break
        gradient = J.T @ error
        blocked = ((q <= solver.lower) & (gradient > 0.0)) | (
            (q >= solver.upper) & (gradient < 0.0)
        )
        if blocked.all():
            break
        J = np.where(blocked, 0.0, J)
        H = J.T @ J + np.diag(damping + blocked)
        trial = np.clip(
            q - np.linalg.solve(H, np.where(blocked, 0.0, gradient)),
            solver.lower,
            solver.upper,
        )
        error_new, J_new = by_pinocchio(solver, trial, target)
        if error_new @ error_new < error @ error:
            q = trial
            error = error_new
            J = J_new
            damping = max(0.2 * damping, 1e-10)
        else:
            damping *= 5.0
            J = by_pinocchio(solver, q, target)[1]
    return q, error


def test_the_compiled_descent_is_the_plain_one(solver):
    rng = np.random.default_rng(9)
    home = HOME[GROUPS[f"{solver.arm}_arm"]]
    blocked_n = 0
    for T in reachable(solver, 25, seed=10):
        start = home + rng.uniform(-0.5, 0.5, 7)
        solution = solver.solve(T, start)
        q, error = descent(solver, T, start)
        assert solution.reached == (np.linalg.norm(error) < 1e-7)
        blocked_n += bool(((q == solver.lower) | (q == solver.upper)).any())
        if solution.reached:
            assert np.abs(solution.q - q).max() < 1e-8
    assert blocked_n >= 3  # joints at their limits are among them


def test_residuals_are_measured_where_the_descent_ends(solver):
    for T in reachable(solver, 5, seed=11):
        T[:3, 3] += [0.0, 0.0, 1.5]
        solution = solver.solve(T, HOME[GROUPS[f"{solver.arm}_arm"]], 15)
        offset = se3(solution.q, solver).actInv(pin.SE3(T))
        assert not solution.reached
        assert solution.residual_m == pytest.approx(np.linalg.norm(offset.translation), abs=1e-12)
        assert solution.residual_rad == pytest.approx(
            np.linalg.norm(pin.log3(offset.rotation)),
            abs=1e-9,
        )


def test_a_start_is_not_changed_and_must_have_seven_joints(solver):
    T = solver.tcp_pose(HOME[:7] + 0.1)
    start = np.array(HOME[:7])
    assert solver.solve(T, start).reached
    assert np.array_equal(start, HOME[:7])
    for call in (
        lambda: solver.solve(T, start[:6]),
        lambda: solver.solve(T[:3], start),
        lambda: solver.tcp_pose(HOME),
        lambda: solver.error_and_jacobian(start[:3], T),
    ):
        with pytest.raises(ValueError, match="reshape"):
            call()


def test_what_is_no_number_reaches_nothing(solver):
    T = solver.tcp_pose(HOME[:7])
    start = np.array(HOME[:7])
    start[2] = np.nan
    assert not solver.solve(T, start).reached
    T[0, 0] = np.nan
    assert not solver.solve(T, HOME[:7]).reached


@pytest.mark.parametrize(
    ("third", "tip", "error"),
    [
        (pin.JointModelPZ(), 7, "arms need hinges"),
        (pin.JointModelRZ(), 6, "chains are needed"),
        (None, 7, "chains"),
    ],
)
def test_an_arm_of_another_build_is_refused(monkeypatch, third, tip, error):
    """A sliding joint; a tcp before the last joint; a joint that hangs on the one before the last."""
    model = pin.Model()
    for side in DUAL_PANDA.sides:
        chain = [0]
        for i in range(7):
            joint = third if i == 2 and third is not None else pin.JointModelRZ()
            parent = chain[-2] if i == 2 and third is None else chain[-1]
            chain.append(model.addJoint(parent, joint, pin.SE3.Identity(), f"{side}_joint{i}"))
        frame = pin.Frame(
            f"{side}_panda_hand_tcp",
            chain[tip],
            0,
            pin.SE3.Identity(),
            pin.FrameType.BODY,
        )
        model.addFrame(frame)
    monkeypatch.setattr("minidual.robot.kinematics._shared_model", lambda robot: model)
    with pytest.raises(ValueError, match=error):
        hinges.__wrapped__(DUAL_PANDA)


@pytest.mark.parametrize("name", ["xarm7", "ur5"])
def test_arms_of_other_models_are_solved_too(name):
    """Limits of two turns, six joints, hinges about y: forward kinematics by Pinocchio, round trip, projection."""
    kinematics = Kinematics(Robot(ARM_MODELS[name]))
    arm = ArmIK("right", kinematics.robot)
    rng = np.random.default_rng(12)
    full = kinematics.robot.home.copy()
    n = kinematics.robot.dof_per_arm
    for _ in range(20):
        full[arm.joints] = rng.uniform(arm.lower, arm.upper)
        T = kinematics.tcp_poses(full)[1]
        assert np.abs(arm.tcp_pose(full[arm.joints]) - T).max() < 1e-13
        q = next(arm.solutions(T, kinematics.robot.home[arm.joints], rng, 30))
        assert ((q >= arm.lower) & (q <= arm.upper)).all()
        assert np.abs(arm.tcp_pose(q) - T).max() < 1e-6
        moved = arm.nearest(T, q + rng.normal(0.0, 1e-3, n))
        assert moved is not None
        assert np.abs(arm.tcp_pose(moved) - T).max() < 1e-7


def test_the_nearest_solution_is_the_projection(solver):
    """The step from a configuration close by is orthogonal to the free motion of the arm; a wish moves along it."""
    q = HOME[GROUPS[f"{solver.arm}_arm"]]
    T = solver.tcp_pose(q)
    near = q + np.random.default_rng(13).normal(0.0, 1e-3, 7)
    found = solver.nearest(T, near)
    _, J = solver.error_and_jacobian(found, T)
    free = np.linalg.svd(J)[2][-1]
    assert abs(free @ (found - near)) < 1e-5
    assert np.abs(solver.tcp_pose(found) - T).max() < 1e-8
    wished = solver.nearest(T, q, 0.05 * free)
    assert abs(free @ (wished - q)) == pytest.approx(0.05, abs=2e-3)
    assert np.abs(solver.tcp_pose(wished) - T).max() < 1e-8
    far = T.copy()
    far[0, 3] += 1.0
    assert solver.nearest(far, q) is None
    assert solver.nearest(T, np.full(7, np.nan)) is None
