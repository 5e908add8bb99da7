"""The proof says no: to collisions, to speed, to torque, to what hides between samples."""

import dataclasses

import numpy as np
import pytest

from minidual.planning.api import Planner
from minidual.planning.scene import PlanningScene
from minidual.planning.shapes import Box, Sphere
from minidual.planning.trajectory import Trajectory
from minidual.planning.verify import STEP_RAD, collision_samples
from minidual.robot.constants import HOME, Q_UPPER
from minidual.robot.kinematics import Kinematics


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
    report = planner.engines().verifier.verify(good)
    assert report.ok
    assert report.reason == ""
    assert report.step_max_rad <= STEP_RAD
    assert report.disagreements_n == report.unproven_n == 0
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
    report = planner.engines().verifier.verify(minimum_jerk(HOME, down, 3.0))
    assert not report.ok
    assert report.reason.startswith("collision at sample")
    assert "table" in report.reason
    assert "left_panda" in report.reason


def test_arms_that_cross_fail(planner):
    inwards = HOME.copy()
    inwards[[0, 7]] = -0.6, 0.6
    report = planner.engines().verifier.verify(minimum_jerk(HOME, inwards, 3.0))
    assert not report.ok
    assert "left_panda" in report.reason
    assert "right_panda" in report.reason


def test_too_fast_fails(planner, good):
    quick = planner.engines().verifier.verify(minimum_jerk(HOME, good.q[-1], 0.3))
    assert not quick.ok
    assert "needs" in quick.reason
    assert quick.velocity_ratio > 1.0


def test_each_limit_is_named(planner, good):
    verifier = planner.engines().verifier
    spoiled = dataclasses.replace(good, v=good.v * 3.0)
    assert "velocity limit" in verifier.verify(spoiled).reason
    spoiled = dataclasses.replace(good, a=good.a * 3.0)
    assert "acceleration limit" in verifier.verify(spoiled).reason
    outside = HOME.copy()
    outside[6] = Q_UPPER[6] - 0.01
    beyond = outside.copy()
    beyond[6] += 0.05
    report = verifier.verify(minimum_jerk(outside, beyond, 1.0))
    assert "left_panda_joint7 leaves its position limit by 0.04" in report.reason


def test_torque_limit_is_named(planner):
    """Accelerations within limits, but torques beyond: the stretched arm swung upwards at full acceleration."""
    q = HOME.copy()
    q[1], q[3], q[5] = 1.2, -0.1, 1.5
    times = np.arange(21) * 0.001
    a = np.zeros((21, 14))
    a[:, 1], a[:, 3] = -7.4, 12.0
    v = a * times[:, None]
    trajectory = Trajectory(times, q + 0.5 * a * times[:, None] ** 2, v, a, "left_arm")
    assert np.abs(Kinematics().rnea(q, v[0], a[0]))[1] > 87.0
    assert "joint2 needs" in planner.engines().verifier.verify(trajectory).reason
    assert "torque limit" in planner.engines().verifier.verify(trajectory).reason


def test_not_at_rest_fails(planner, good):
    n = len(good.times) // 2
    cut = Trajectory(good.times[:n], good.q[:n], good.v[:n], good.a[:n], good.group)
    assert "still move" in planner.engines().verifier.verify(cut).reason


def test_a_jump_between_samples_fails(planner, good):
    q = good.q.copy()
    q[len(q) // 2 :, 6] += 0.3
    report = planner.engines().verifier.verify(dataclasses.replace(good, q=q))
    assert not report.ok


def test_what_hides_between_two_samples_is_not_proven():
    """Both ends free and clear by more than the margin, a ball in the middle: only the motion bound can tell."""
    kinematics = Kinematics()
    a, middle, b = HOME.copy(), HOME.copy(), HOME.copy()
    a[3] -= 0.2
    middle[3] += 0.4
    b[3] += 1.0
    T_world_tcp = kinematics.tcp_poses(middle)[0]
    hand = T_world_tcp[:3, 3] - 0.06 * T_world_tcp[:3, 2]
    scene = PlanningScene().with_obstacles(Sphere("ball", tuple(hand), radius_m=0.01))
    engines = Planner(scene).engines()
    assert not engines.mujoco.collisions(np.array([a, b])).any()
    assert engines.mujoco.in_collision(middle)
    assert not engines.verifier._proven(a, b, [], [], 12)
    assert engines.verifier._proven(a, a + 0.001, [], [], 0)


def test_a_coarse_step_cannot_pass_as_the_proof(planner, good, monkeypatch):
    verifier = planner.engines().verifier
    monkeypatch.setattr(verifier, "_step_rad", 0.02)
    assert "rad apart" in verifier.verify(good).reason


def test_second_opinion_counts(good):
    """If coal alone sees a collision the plan is refused."""
    planner = Planner()
    verifier = planner.engines().verifier
    middle = Kinematics().tcp_poses(good.q[len(good.q) // 2])[0][:3, 3]
    other = PlanningScene().with_obstacles(Box("only_coal_sees_it", tuple(middle), size_m=(0.1, 0.1, 0.1)))
    verifier._second = Planner(other).engines().coal
    report = verifier.verify(good)
    assert not report.ok
    assert report.disagreements_n > 0
    assert report.reason.startswith("coal sees a collision")
