"""The proof says no: to collisions, to speed, to torque, to what hides between samples."""

import dataclasses
import itertools
import re

import numpy as np
import pytest

from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Box, Sphere
from minidual.config.planning import PlannerConfig
from minidual.errors import UsageError
from minidual.motion import timing
from minidual.motion.api import Planner
from minidual.proof import certificate, limits
from minidual.proof.certificate import certify
from minidual.proof.scene_engines import STEP_RAD, SceneEngines, collision_samples
from minidual.robot.kinematics import Kinematics
from minidual.robot.models import ARM_MODELS
from minidual.robot.pair import DUAL_PANDA, Robot
from minidual.robot.trajectory import Trajectory
from minidual.trials.planning.evaluate import plan_query
from minidual.trials.planning.queries import QueryGenerator
from tests.support.panda import A_MAX, HOME, Q_UPPER


@pytest.fixture(scope="module")
def planner():
    return Planner()


@pytest.fixture(scope="module")
def good(planner):
    goal = HOME.copy()
    goal[[0, 7]] = 0.5, -0.5
    return planner.plan_to_joints("both_arms", HOME, goal).trajectory


def minimum_jerk(q0, q1, duration_s, group="both_arms"):
    """A smooth motion of our own, rest to rest, whatever stands in its way."""
    n = round(duration_s / 0.001)
    times = np.arange(n + 1) * 0.001
    x = (times / times[-1])[:, None]
    d = (np.asarray(q1) - np.asarray(q0)) / times[-1]
    return Trajectory(
        times,
        q0 + (q1 - q0) * (10 * x**3 - 15 * x**4 + 6 * x**5),
        d * (30 * x**2 - 60 * x**3 + 30 * x**4),
        d / times[-1] * (60 * x - 180 * x**2 + 120 * x**3),
        group,
    )


def test_a_good_plan_passes(planner, good):
    report = planner.engines().verify(good)
    assert report.ok
    assert report.reason == ""
    assert 0.0 < report.jerk_ratio <= 0.9501
    assert 0.3 < report.acceleration_ratio <= 0.9001


def test_samples_are_fine_enough_and_follow_the_trajectory(good):
    Q = collision_samples(good)
    assert np.abs(np.diff(Q, axis=0)).max() <= STEP_RAD
    assert np.array_equal(Q[[0, -1]], good.q[[0, -1]])
    for q in Q[:: len(Q) // 10]:
        assert np.abs(good.q - q).max(axis=1).min() < STEP_RAD


def test_a_colliding_trajectory_fails_with_the_pair(planner):
    """Down through the table."""
    down = HOME.copy()
    down[1] += 1.6
    report = planner.engines().verify(minimum_jerk(HOME, down, 3.0))
    assert not report.ok
    assert report.reason.startswith("collision at ")
    assert "table" in report.reason
    assert "left_panda" in report.reason


def test_arms_that_cross_fail(planner):
    inwards = HOME.copy()
    inwards[[0, 7]] = -0.6, 0.6
    report = planner.engines().verify(minimum_jerk(HOME, inwards, 3.0))
    assert not report.ok
    assert "left_panda" in report.reason
    assert "right_panda" in report.reason


def test_too_fast_fails(planner, good):
    quick = planner.engines().verify(minimum_jerk(HOME, good.q[-1], 0.3))
    assert not quick.ok
    assert "needs" in quick.reason
    assert quick.velocity_ratio > 1.0


def test_each_limit_is_named(planner, good):
    verifier = planner.engines()
    spoiled = dataclasses.replace(good, v=good.v * 3.0)
    assert "velocity limit" in verifier.verify(spoiled).reason
    spoiled = dataclasses.replace(good, a=good.a * 3.0)
    assert "acceleration limit" in verifier.verify(spoiled).reason
    k = len(good.times) // 2
    a = good.a.copy()
    a[k:, 3] += 7.0  # 7 rad/s^2 in a millisecond
    assert "left_panda_joint4 needs 1." in verifier.verify(dataclasses.replace(good, a=a)).reason
    assert "jerk limit" in verifier.verify(dataclasses.replace(good, a=a)).reason
    outside = HOME.copy()
    outside[6] = Q_UPPER[6] - 0.01
    beyond = outside.copy()
    beyond[6] += 0.05
    report = verifier.verify(minimum_jerk(outside, beyond, 1.0))
    assert "left_panda_joint7 leaves its position limit by 0.04" in report.reason


def test_torque_rate_limit_is_named(planner):
    """Acceleration, jerk and torque within limits, but an acceleration that swings 40 times a second."""
    times = np.arange(201) * 0.001
    w = 2.0 * np.pi * 40.0
    a_max = np.zeros(14)
    a_max[1] = 4.0
    q, v, a = (
        np.outer(x, a_max)
        for x in (
            (times - np.sin(w * times) / w) / w,
            (1 - np.cos(w * times)) / w,
            np.sin(w * times),
        )
    )
    report = planner.engines().verify(Trajectory(times, HOME + q, v, a, "left_arm"))
    assert (
        max(
            report.velocity_ratio,
            report.acceleration_ratio,
            report.jerk_ratio,
            report.torque_ratio,
        )
        < 1.0
    )
    tau = Kinematics().torques(HOME + q, v, a)
    assert report.torque_rate_ratio * 1000.0 == pytest.approx(
        np.abs(tau[8:] - tau[:-8]).max() / 0.008,
        rel=0.02,
    )
    assert (
        report.reason
        == f"left_panda_joint2 needs {report.torque_rate_ratio:.3f} of its torque rate limit"
    )
    gentle = planner.engines().verify(
        Trajectory(times, HOME + 0.2 * q, 0.2 * v, 0.2 * a, "left_arm"),
    )
    assert gentle.ok


def test_torque_limit_is_named(planner):
    """Accelerations within limits, but torques beyond: the stretched arm swung upwards at full acceleration."""
    q = HOME.copy()
    q[1], q[3], q[5] = 1.2, -0.1, 1.5
    times = np.arange(101) * 0.001
    most = np.zeros(14)
    w = 20.0 * np.pi
    most[1], most[3] = -7.4, 12.0
    t = times[:, None]  # the acceleration rises from zero and falls again
    v = 0.5 * most * (t - np.sin(w * t) / w)
    moved = 0.5 * most * (0.5 * t**2 + (np.cos(w * t) - 1.0) / w**2)
    trajectory = Trajectory(times, q + moved, v, 0.5 * most * (1.0 - np.cos(w * t)), "left_arm")
    assert np.abs(Kinematics().rnea(trajectory.q[50], v[50], most))[1] > 87.0
    assert "joint2 needs" in planner.engines().verify(trajectory).reason
    assert "torque limit" in planner.engines().verify(trajectory).reason


def test_not_at_rest_fails(planner, good):
    n = len(good.times) // 2
    cut = Trajectory(good.times[:n], good.q[:n], good.v[:n], good.a[:n], good.group)
    assert "still move" in planner.engines().verify(cut).reason


def test_a_jump_between_samples_fails(planner, good):
    q = good.q.copy()
    q[len(q) // 2 :, 6] += 0.3
    report = planner.engines().verify(dataclasses.replace(good, q=q))
    assert not report.ok


def swing_past(ball_offset_m):
    """A swing of the elbow, and a scene with a small ball where the hand is half-way, moved up by an offset."""
    a = HOME.copy()
    middle = HOME.copy()
    b = HOME.copy()
    a[3] -= 0.2
    middle[3] += 0.4
    b[3] += 1.0
    T_world_tcp = Kinematics().tcp_poses(middle)[0]
    hand = T_world_tcp[:3, 3] - 0.06 * T_world_tcp[:3, 2] + [0.0, 0.0, ball_offset_m]
    scene = PlanningScene().with_obstacles(Sphere("ball", tuple(hand), radius_m=0.01))
    return minimum_jerk(a, b, 3.0, "left_arm"), scene


def test_what_hides_between_two_samples_is_found(monkeypatch):
    """Both ends are free and clear, a ball in the middle: the motion bound alone asks for a look there."""
    trajectory, scene = swing_past(0.0)
    engines = Planner(scene).engines()
    assert not engines.engine("mujoco").collisions(trajectory.q[[0, -1]]).any()
    monkeypatch.setattr(certificate, "_FIRST_RAD", 100.0)  # the first look is at both ends only
    report = engines.verify(trajectory)
    assert "ball and left_panda" in report.reason or "left_panda" in report.reason.split(" and ")[0]
    assert re.match(
        r"collision at \d\.\d+ s: .* touch|.* could not be proven apart after",
        report.reason,
    )
    clear, scene = swing_past(0.5)
    report = Planner(scene).engines().verify(clear)
    assert report.ok


def test_grazing_cannot_be_proven_and_is_refused():
    """A ball that the hand touches by a hair: no sample need see it, but no proof may pass."""
    trajectory, _ = swing_past(0.0)
    engines = Planner().engines()
    Q = collision_samples(trajectory)
    assert not engines.engine("mujoco").collisions(Q).any()
    low = 0.0
    high = 0.2
    for _ in range(14):  # the offset at which the hand just touches the ball
        offset = 0.5 * (low + high)
        hit = Planner(swing_past(offset)[1]).engines().engine("mujoco").collisions(Q).any()
        low, high = (offset, high) if hit else (low, offset)
    verifier = Planner(swing_past(high + 1e-6)[1]).engines()
    assert not verifier.verify(trajectory).ok
    assert verifier.clearance(trajectory) < 1e-4


def test_the_audit_agrees_with_the_proof_and_can_say_no(planner, good, monkeypatch):
    verifier = planner.engines()
    audit = verifier.audit(good)
    assert (audit.collisions_n, audit.disagreements_n) == (0, 0)
    assert audit.samples_n > 200
    inwards = HOME.copy()
    inwards[[0, 7]] = -0.6, 0.6
    assert verifier.audit(minimum_jerk(HOME, inwards, 3.0)).collisions_n > 0
    engines = {name: verifier.engine(name) for name in ("mujoco", "coal")}
    engines["coal"] = Planner(PlanningScene(obstacles=())).engines().engine("coal")
    monkeypatch.setattr(verifier, "engine", engines.__getitem__)
    down = HOME.copy()
    down[1] += 1.6
    assert verifier.audit(minimum_jerk(HOME, down, 3.0)).disagreements_n > 0


def test_what_touches_at_rest_is_refused_whoever_moves(good):
    """The pairs that stand still are looked at too: a box in the hand that rests while the other arm moves."""
    T_world_tcp = Kinematics().tcp_poses(HOME)[0]
    seen, far = (
        Planner(PlanningScene().with_obstacles(Box("box", at, size_m=(0.12, 0.12, 0.12)))).engines()
        for at in (tuple(T_world_tcp[:3, 3]), (3.0, 0.0, 0.0))
    )
    goal = HOME.copy()
    goal[7] -= 0.3
    moving = minimum_jerk(HOME, goal, 2.0, "right_arm")
    assert far.verify(moving).ok
    report = seen.verify(moving)
    assert report.reason.startswith("collision at 0.000 s: box and left_panda")


def test_what_a_trajectory_says_of_its_acceleration_and_velocity_must_be_true(planner, good):
    """Accelerations of zero would keep every limit of acceleration, jerk and torque."""
    verifier = planner.engines()
    still = np.zeros_like(good.v)
    lied = verifier.verify(dataclasses.replace(good, a=still))
    assert 0.5 < lied.acceleration_ratio < 1.0, "that of the cubics between the samples"
    assert re.search(
        r"the acceleration of \w+ is not that of its velocity: \d+\.\d\d rad/s\^2 off",
        lied.reason,
    )
    halved = verifier.verify(dataclasses.replace(good, a=0.5 * good.a))
    assert "is not that of its velocity" in halved.reason
    # A motion slow enough that even stopping and starting every millisecond breaks no limit of speed.
    slow = minimum_jerk(HOME, good.q[-1], 8.0)
    assert verifier.verify(slow).ok
    report = verifier.verify(
        dataclasses.replace(slow, v=still[:1].repeat(len(slow.v), axis=0), a=0.0 * slow.a),
    )
    assert "of its acceleration limit" in report.reason
    bent = 1.002 * slow.v
    report = verifier.verify(dataclasses.replace(slow, v=bent))
    assert "the velocity of" in report.reason
    assert "is not that of its positions" in report.reason


@pytest.mark.parametrize("smoothing_s", [0.0, 0.04])
def test_honest_trajectories_are_far_from_contradicting_themselves(smoothing_s, monkeypatch):
    """The tolerance is no limit of what is planned: plans with and without smoothing keep half of it."""
    planner = Planner(config=PlannerConfig(smoothing_s=smoothing_s))
    generator = QueryGenerator(5)
    for group in ("left_arm", "both_arms"):
        trajectory = plan_query(planner, generator.query(group, 0)).result.trajectory
        with monkeypatch.context() as patch:
            patch.setattr(limits, "_MISFIT", 0.5 * limits._MISFIT)
            assert planner.engines().verify(trajectory).ok


def coarse(q, v, a, dt_s=0.25):
    """A trajectory of few samples."""
    return Trajectory(np.arange(len(q)) * dt_s, q, v, a, "both_arms")


def test_an_arm_whose_samples_stand_still_may_move_between_them():
    """Passed at speed to and fro, equal samples hide a swing of 0.14 rad; a ball beside the arm is met in between."""
    joint = 10
    dt = 0.25
    n = 10
    sign = (-1.0) ** np.arange(n)
    q = np.tile(HOME, (n, 1))
    v = np.zeros((n, 14))
    a = np.zeros((n, 14))
    a[:, joint] = 0.8 * A_MAX[joint] * sign
    v[1:-1, joint] = 0.45 * 0.8 * A_MAX[joint] * dt * sign[1:-1]
    trajectory = coarse(q, v, a)
    between = trajectory.sample_many(np.linspace(0.0, trajectory.duration_s, 1001))[0]
    assert np.ptp(between, axis=0).max() > 0.1
    kinematics = Kinematics()
    far = between[np.argmax(np.abs(between - HOME).max(axis=1))]
    here, there = (kinematics.tcp_poses(x)[1][:3, 3] for x in (HOME, far))
    for away in np.linspace(0.02, 0.2, 100):
        ball = Sphere(
            "ball",
            tuple(here + away * (there - here) / np.linalg.norm(there - here)),
            radius_m=0.01,
        )
        engines = Planner(PlanningScene(obstacles=(ball,))).engines()
        if not engines.engine("mujoco").collisions(q[:1]).any():
            break
    assert engines.engine("mujoco").collisions(between).any()
    report = engines.verify(trajectory)
    assert not report.ok
    audit = engines.audit(trajectory)
    assert audit.collisions_n > 0
    steps = np.abs(np.diff(collision_samples(trajectory), axis=0))
    assert steps.max() <= STEP_RAD  # however far apart the samples of the trajectory are
    assert audit.clearance_m <= 0.0


def test_clearance_is_that_of_the_whole_way(planner, good):
    """Not only at the few samples of the proof: as small as at any millisecond."""
    verifier = planner.engines()
    everywhere = planner.engines().solids.clearance(good.q, 0.04)
    assert verifier.clearance(good) == pytest.approx(everywhere, abs=2e-4)
    assert verifier.audit(good).clearance_m == verifier.clearance(good)
    assert 0.0 < everywhere < 0.04


def test_times_that_drift_from_their_step_are_refused(good):
    """Each step is right to a billionth of a second, the last time a tenth of a millisecond off."""
    n = 100_001
    times = np.concatenate([[0.0], np.cumsum(np.full(n - 1, 0.001 + 9e-10))])
    times[1] = 0.001
    still = np.zeros((n, 14))
    with pytest.raises(UsageError, match="grow in equal steps"):
        Trajectory(times, still, still, still, "both_arms")


def zigzag(joint, dt_s, n):
    """Stated accelerations within the limits, whose cubics between the samples accelerate by up to twice as much."""
    a_max = 0.999 * A_MAX[joint]
    change = 0.999 * min(float(DUAL_PANDA.jerk_max[joint]) * dt_s, 2 * A_MAX[joint])
    middle = n // 2
    stated = np.zeros(n)
    for i in range(1, middle):
        wanted = (a_max if i % 2 else a_max - change) if i < middle - 4 else 0.0
        stated[i] = np.clip(wanted, stated[i - 1] - change, min(a_max, stated[i - 1] + change))
    stated[middle:] = -stated[:middle][::-1]
    changes = np.abs(np.diff(stated))
    mean = 0.5 * (stated[1:] + stated[:-1])
    slack = 0.049 * A_MAX[joint]
    gain = mean + np.sign(mean) * (0.5 * changes + slack) * 0.99
    gain = 0.5 * (gain - gain[::-1])
    bend = (changes + slack) * 0.99 * np.where(np.arange(n - 1) % 2, 1, -1)
    v = np.append(0.0, np.cumsum(gain) * dt_s)
    v[-1] = 0.0
    x = np.append(0.0, np.cumsum(dt_s * (0.5 * (v[1:] + v[:-1]) + dt_s / 6 * bend)))
    q = np.tile(HOME, (n, 1))
    V = np.zeros_like(q)
    A = np.zeros_like(q)
    q[:, joint] += x - x[-1] / 2
    V[:, joint] = v
    A[:, joint] = stated
    return Trajectory(np.arange(n) * dt_s, q, V, A, "left_arm"), np.abs(
        [gain + bend, gain - bend],
    ).max()


@pytest.mark.parametrize(("joint", "dt_s", "n"), [(5, 0.001, 200), (6, 0.001, 200), (0, 0.004, 80)])
def test_what_a_cubic_accelerates_between_two_samples_counts(planner, joint, dt_s, n):
    """Times that jump hide 1.6 to 2.1 times the limit."""
    motion, largest = zigzag(joint, dt_s, n)
    assert largest > 1.5 * A_MAX[joint]
    proof = planner.engines().verify(motion)
    assert not proof.ok
    assert proof.acceleration_ratio == pytest.approx(largest / A_MAX[joint], rel=1e-6)


def test_a_trajectory_of_another_robot_is_refused():
    """Two UR5 have other joints: nothing is proven for them, and no kernel writes beyond its array."""
    engines = SceneEngines(PlanningScene(robot=Robot(ARM_MODELS["ur5"])))
    motion = timing.resting(HOME, 0.01, "both_arms")
    for check in (engines.verify, lambda m: certify(engines.solids, m)):
        with pytest.raises(UsageError, match="the trajectory has 14 joints, the arms ur5 have 12"):
            check(motion)


def test_a_scene_without_checked_pairs_is_planned_in():
    names = PlanningScene(obstacles=()).names
    allowed = frozenset((*sorted(pair), "not checked") for pair in itertools.combinations(names, 2))
    scene = PlanningScene(obstacles=(), allowed=allowed)
    goal = HOME.copy()
    goal[0] += 0.5
    assert Planner(scene).plan_to_joints("left_arm", HOME, goal).verification.ok


def test_positions_beyond_all_measure_are_refused_and_not_raised(planner):
    q = np.tile(HOME, (17, 1))
    q[8, 0], q[16, 0] = 1e308, -1e308
    with np.errstate(over="ignore", invalid="ignore"):
        proof = planner.engines().verify(
            Trajectory(np.arange(17) * 1e-3, q, 0 * q, 0 * q, "left_arm"),
        )
    assert not proof.ok
