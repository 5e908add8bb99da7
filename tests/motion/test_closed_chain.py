"""Carrying with both hands: the grasps hold between the points that were solved, too."""

import numpy as np
import pinocchio as pin
import pytest
from pydantic import ValidationError

from minidual.collision.errors import ClosedChainError, OutOfLimitsError
from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Box, Capsule
from minidual.errors import UsageError
from minidual.motion.api import Planner
from minidual.motion.held.path import HeldPath
from minidual.motion.held.planner import HeldPlanner
from minidual.motion.held.query import scene_holding
from minidual.motion.timing import PathLimits
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import inverse, pose, rot_x, rot_z
from tests.support.panda import A_MAX, HOME, V_MAX

RADIUS = 0.00887
DOWN = rot_z(np.pi / 2) @ rot_x(np.pi)
GRASPS = (pose(DOWN, (0.0, 0.12, 0.003)), pose(DOWN, (0.0, -0.12, 0.003)))
HELD = {"left": GRASPS[0], "right": GRASPS[1]}
ROD = Capsule(
    "rod",
    (0, 0, 0),
    (np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0),
    radius_m=RADIUS,
    length_m=0.28,
)


def rod_at(x, y, z, yaw=0.0):
    return pose(rot_z(yaw), (x, y, z))


@pytest.fixture(scope="module")
def q_start():
    start = rod_at(0.5, 0.25, RADIUS, 0.2)
    targets = {"left": start @ GRASPS[0], "right": start @ GRASPS[1]}
    return Planner().plan_to_poses("both_arms", HOME, targets).q_goal


@pytest.fixture(scope="module")
def waypoints():
    return [
        rod_at(0.5, 0.25, RADIUS, 0.2),
        rod_at(0.5, 0.25, 0.13, 0.2),
        rod_at(0.5, -0.25, 0.13),
        rod_at(0.5, -0.25, RADIUS),
    ]


@pytest.fixture(scope="module")
def carried(q_start, waypoints):
    return HeldPlanner().follow(
        q_start,
        waypoints,
        GRASPS,
        scene=scene_holding(PlanningScene(), ROD, HELD),
    )


def test_grasps_hold_on_a_much_finer_grid_than_was_solved(carried):
    """Oracle: forward kinematics of the timed samples, ten times finer than 1 kHz in places."""
    kinematics = Kinematics()
    T_left_right = inverse(GRASPS[0]) @ GRASPS[1]
    times = np.random.default_rng(0).uniform(0.0, carried.duration_s, 1500)
    Q, _, _ = carried.sample_many(times)
    worst_m = worst_rad = 0.0
    for q in Q:
        left, right = kinematics.tcp_poses(q)
        error = inverse(T_left_right) @ (inverse(left) @ right)
        worst_m = max(worst_m, float(np.linalg.norm(error[:3, 3])))
        worst_rad = max(worst_rad, float(np.linalg.norm(pin.log3(error[:3, :3]))))
    assert worst_m < 1e-4
    assert worst_rad < 1e-3
    assert carried.residual_m < 1e-4
    assert carried.residual_rad < 1e-3


def test_object_goes_where_it_was_sent(carried, waypoints):
    assert np.abs(carried.Ts_world_object[0] - waypoints[0]).max() < 1e-12
    assert np.abs(carried.Ts_world_object[-1] - waypoints[-1]).max() < 1e-12
    assert len(carried.Ts_world_object) == len(carried.times)
    heights = carried.Ts_world_object[:, 2, 3]
    assert heights.max() == pytest.approx(0.13, abs=1e-6)
    kinematics = Kinematics()
    for k in range(0, len(carried.times), 200):
        left, _ = kinematics.tcp_poses(carried.q[k])
        assert np.abs(left @ inverse(GRASPS[0]) - carried.Ts_world_object[k]).max() < 2e-4


def test_limits_of_joints_and_object_hold(carried):
    assert (np.abs(carried.v) <= V_MAX).all()
    assert (np.abs(carried.a) <= A_MAX).all()
    velocity = np.gradient(carried.Ts_world_object[:, :3, 3], carried.dt_s, axis=0)
    acceleration = np.gradient(velocity, carried.dt_s, axis=0)
    assert np.linalg.norm(velocity, axis=1).max() < 0.3 * 1.05
    assert np.abs(acceleration).max() < 1.0 * 1.15
    assert np.abs(carried.v[[0, -1]]).max() == 0.0


def test_the_proof_covers_the_rod(carried, q_start, waypoints):
    assert carried.verification is not None
    assert carried.verification.ok
    # A block that only the rod would hit, under its way between the hands:
    blocked = PlanningScene().with_obstacles(
        Box("block", (0.5, 0.0, 0.06), size_m=(0.02, 0.02, 0.13)),
    )
    with pytest.raises(ClosedChainError, match=r"not free: .*block"):
        HeldPlanner().follow(q_start, waypoints, GRASPS, scene=scene_holding(blocked, ROD, HELD))


def test_slower_object_takes_longer(carried, q_start, waypoints):
    limits = PathLimits(speed_m_per_s=0.1, acceleration_m_per_s2=0.5)
    slow = HeldPlanner().follow(q_start, waypoints, GRASPS, along=limits)
    assert slow.duration_s > 1.8 * carried.duration_s
    assert slow.verification is None
    with pytest.raises(ValidationError, match="speed_m_per_s"):
        PathLimits(speed_m_per_s=0.0)


def test_same_query_same_bytes(carried, q_start, waypoints):
    again = HeldPlanner().follow(q_start, waypoints, GRASPS)
    assert again.digest() == carried.digest()


def test_rotation_while_carrying(q_start):
    turned = [rod_at(0.5, 0.25, 0.2, 0.2), rod_at(0.5, 0.0, 0.2, 0.8)]
    planner = Planner()
    q = planner.plan_to_poses(
        "both_arms",
        q_start,
        {"left": turned[0] @ GRASPS[0], "right": turned[0] @ GRASPS[1]},
    ).q_goal
    plan = HeldPlanner().follow(q, turned, GRASPS)
    assert plan.residual_m < 1e-4
    assert np.abs(plan.Ts_world_object[-1] - turned[1]).max() < 1e-9


def test_start_off_the_grasp_is_refused(q_start, waypoints):
    off = [T.copy() for T in waypoints]
    off[0][0, 3] += 0.01
    with pytest.raises(
        ClosedChainError,
        match=r"left hand is 10.00 mm and 0.0000 rad off its grasp",
    ):
        HeldPlanner().follow(q_start, off, GRASPS)
    left, right = (inverse(off[0]) @ T for T in Kinematics().tcp_poses(q_start))
    assert HeldPlanner().follow(q_start, off, (left, right)).residual_m < 1e-4


def test_out_of_reach_names_the_hand_and_the_place(q_start, waypoints):
    far = [waypoints[0], rod_at(1.4, 0.25, 0.3, 0.2)]
    with pytest.raises(
        ClosedChainError,
        match=r"the \w+ hand cannot follow.*\(0\.\d+, 0\.\d+, 0\.\d+\) m",
    ):
        HeldPlanner().follow(q_start, far, GRASPS)


def test_bad_input_is_named(q_start, waypoints):
    planner = HeldPlanner()
    with pytest.raises(UsageError, match="two or more"):
        planner.follow(q_start, waypoints[:1], GRASPS)
    with pytest.raises(UsageError, match="same pose"):
        planner.follow(q_start, [waypoints[0], waypoints[0]], GRASPS)
    with pytest.raises(
        UsageError,
        match="waypoint 1 of the object holds a value that is not finite",
    ):
        planner.follow(q_start, [waypoints[0], waypoints[1] * np.nan], GRASPS)
    with pytest.raises(UsageError, match="the left grasp is no rigid pose"):
        planner.follow(q_start, waypoints, (2.0 * GRASPS[0], GRASPS[1]))
    with pytest.raises(OutOfLimitsError, match="left_panda_joint4"):
        planner.follow(np.zeros(14), waypoints, GRASPS)


def test_object_path_is_smooth_and_passes_near_its_corners(waypoints):
    path = HeldPath.through(waypoints, corner_m=0.04)
    s = np.linspace(0.0, path.length, 3000)
    numeric = np.gradient(path.coordinates(s), s, axis=0)
    assert np.abs(numeric - path.coordinates(s, 1))[1:-1].max() < 1e-3
    positions = path.poses(s)[:, :3, 3]
    for T in waypoints:
        assert np.linalg.norm(positions - T[:3, 3], axis=1).min() < 0.02
    for T in path.poses(s[::300]):
        assert np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() < 1e-12
    with pytest.raises(UsageError, match="turns the object by"):
        HeldPath.through([rod_at(0, 0, 0), rod_at(0, 0, 0, 3.1)])
