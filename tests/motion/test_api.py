"""Queries in, proven trajectories or named errors out."""

import numpy as np
import pytest

from minidual.collision.errors import (
    GoalInCollisionError,
    IKUnreachableError,
    NoPathInTimeError,
    OutOfLimitsError,
    StartInCollisionError,
)
from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Box, Sphere
from minidual.config.planning import PlannerConfig
from minidual.config.root import Config
from minidual.errors import UsageError
from minidual.motion.api import Effort, Planner
from minidual.motion.checks import check_joints, goal_joints
from minidual.motion.search import PLANNERS
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import pose, rot_x, rot_z
from minidual.stages.registry import STAGES
from tests.support.panda import GROUPS, HOME, Q_UPPER

POST = Box("post", (0.36, 0.25, 0.4), size_m=(0.06, 0.06, 0.8))
DOWN = rot_z(np.pi / 2) @ rot_x(np.pi)


@pytest.fixture(scope="module")
def planner():
    return Planner()


@pytest.fixture(scope="module")
def post_planner():
    return Planner(PlanningScene().with_obstacles(POST))


def beside_the_post(sign):
    q = HOME.copy()
    q[0] = sign * 0.8
    return q


@pytest.mark.parametrize("group", GROUPS)
def test_each_group_reaches_its_goal_and_holds_the_rest(planner, group):
    goal = HOME.copy()
    goal[GROUPS[group]] += 0.25
    start = HOME.copy()
    start[[6, 13]] = 0.3, -0.3
    result = planner.plan_to_joints(group, start, goal[GROUPS[group]], seed=1)
    t = result.trajectory
    assert result.verification.ok
    assert t.group == group
    assert np.abs(t.q[0] - start).max() < 1e-12
    assert np.abs(t.q[-1, GROUPS[group]] - goal[GROUPS[group]]).max() < 1e-12
    held = np.ones(14, dtype=bool)
    held[GROUPS[group]] = False
    assert (t.q[:, held] == start[held]).all()
    assert (t.v[:, held] == 0.0).all()
    assert sum(result.times_s.values()) <= result.total_s


def test_a_blocked_line_is_gone_round(post_planner):
    start = beside_the_post(1)
    goal = beside_the_post(-1)
    result = post_planner.plan_to_joints("left_arm", start, goal, seed=3)
    assert not result.direct
    assert len(result.path) > 2
    assert result.verification.ok
    # Oracle: without the post the same query is a straight line.
    assert post_planner.plan_to_joints(
        "left_arm",
        start,
        goal,
        seed=3,
        scene=PlanningScene(),
    ).direct


def test_same_seed_same_trajectory_bit_for_bit_even_after_other_queries(post_planner):
    start = beside_the_post(1)
    goal = beside_the_post(-1)
    first = post_planner.plan_to_joints("left_arm", start, goal, seed=5).trajectory
    post_planner.plan_to_joints("right_arm", start, HOME[7:] + 0.1, seed=9)
    again = post_planner.plan_to_joints("left_arm", start, goal, seed=5).trajectory
    fresh = Planner(post_planner.scene).plan_to_joints("left_arm", start, goal, seed=5).trajectory
    other = post_planner.plan_to_joints("left_arm", start, goal, seed=6).trajectory
    assert first.digest() == again.digest() == fresh.digest()
    assert first.q.tobytes() == fresh.q.tobytes()
    assert other.digest() != first.digest()


def test_pose_goals_are_reached_by_both_hands(planner):
    targets = {"left": pose(DOWN, (0.5, 0.4, 0.15)), "right": pose(DOWN, (0.5, -0.4, 0.15))}
    result = planner.plan_to_poses("both_arms", HOME, targets, seed=2)
    for T, wanted in zip(
        Kinematics().tcp_poses(result.trajectory.q[-1]),
        targets.values(),
        strict=True,
    ):
        assert np.abs(T - wanted).max() < 1e-6
    again = planner.plan_to_poses("both_arms", HOME, targets, seed=2)
    assert again.trajectory.digest() == result.trajectory.digest()


def test_a_goal_that_is_the_start_is_a_rest(planner):
    t = planner.plan_to_joints("both_arms", HOME, HOME).trajectory
    assert len(t.times) == 2
    assert (t.q == HOME).all()


def test_start_in_collision_names_the_pair_and_the_depth(planner):
    start = HOME.copy()
    start[0], start[7] = -0.9, 0.9
    with pytest.raises(
        StartInCollisionError,
        match=r"start is in collision: left_panda_\w+ and right_panda_\w+ penetrate by [\d.]+ mm",
    ):
        planner.plan_to_joints("left_arm", start, HOME[:7])


def test_goal_in_collision_names_the_pair(planner):
    scene = planner.scene.with_obstacles(Sphere("ball", (0.307, -0.25, 0.55), radius_m=0.05))
    goal = HOME.copy()
    start = HOME.copy()
    start[7] = -0.9
    with pytest.raises(GoalInCollisionError, match="ball and right_panda"):
        planner.plan_to_joints("right_arm", start, goal, scene=scene)
    # A pose that can be reached, but only inside the ball:
    with pytest.raises(GoalInCollisionError, match="goal is in collision"):
        planner.plan_to_poses(
            "right_arm",
            start,
            {"right": Kinematics().tcp_poses(HOME)[1]},
            scene=scene,
        )


def test_unreachable_pose_names_the_residual(planner):
    with pytest.raises(
        IKUnreachableError,
        match=r"left hand cannot reach \(1.500, 0.000, 0.300\) m .* mm and",
    ):
        planner.plan_to_poses("left_arm", HOME, {"left": pose(DOWN, (1.5, 0.0, 0.3))})


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda q: q[:7], "shape"),
        (lambda q: q * np.nan, "left_panda_joint1 = nan"),
        (
            lambda q: np.where(np.arange(14) == 3, 1.0, q),
            "left_panda_joint4 = 1 rad; its limits are -3.0718 to -0.0698",
        ),
    ],
)
def test_starts_out_of_limits_are_named(planner, change, says):
    with pytest.raises(OutOfLimitsError, match=says):
        planner.plan_to_joints("both_arms", change(HOME.copy()), HOME)


def test_a_start_and_a_goal_rounded_to_float32_are_on_the_limits(planner):
    robot = planner.robot
    start = HOME.copy()
    goal = HOME.copy()
    start[3] = np.float32(robot.q_upper[3])  # -0.0698 is rounded up
    goal[0] = np.float32(robot.q_lower[0])  # -2.8973 is rounded down
    assert start[3] > robot.q_upper[3]
    assert goal[0] < robot.q_lower[0]
    inside = check_joints(start, "start", robot)
    assert inside[3] == robot.q_upper[3]
    assert goal_joints("both_arms", inside, goal, robot)[0] == robot.q_lower[0]
    assert goal_joints("left_arm", inside, goal[:7], robot)[0] == robot.q_lower[0]


def test_a_refused_start_is_told_from_its_limit(planner):
    start = HOME.copy()
    start[3] = planner.robot.q_upper[3] + 2e-6
    with pytest.raises(OutOfLimitsError, match=r"= -0\.069798 rad; its limits .* to -0\.0698 rad"):
        planner.plan_to_joints("both_arms", start, HOME)


def test_goals_out_of_limits_are_named(planner):
    goal = HOME[:7].copy()
    goal[6] = Q_UPPER[6] + 0.2
    with pytest.raises(OutOfLimitsError, match="goal has left_panda_joint7"):
        planner.plan_to_joints("left_arm", HOME, goal)


def test_no_path_in_time_names_budget_attempts_and_reason():
    """A wall through the left base with a gap just wide enough for the folded arm, and steps too small to find it."""
    walls = [
        Box(f"wall{side}", (side * 0.59, 0.25, 0.9), size_m=(0.9, 0.02, 1.8)) for side in (-1, 1)
    ]
    scene = PlanningScene().with_obstacles(*walls)
    start = beside_the_post(1.4)
    goal = beside_the_post(-1.4)
    planner = Planner(
        scene,
        PlannerConfig(search_checks_n=200, edge_step_rad=0.0005, range_rad=0.05),
    )
    planner.engines()
    with pytest.raises(
        NoPathInTimeError,
        match=r"no proven path for left_arm in 0.05 s: \d+ attempts, the last one: (rrtconnect|kpiece) found no path",
    ):
        planner.plan_to_joints("left_arm", start, goal, budget_s=0.05)
    with pytest.raises(
        NoPathInTimeError, match=r"for left_arm in 20000 state checks: \d+ attempts"
    ):
        planner.plan_to_joints("left_arm", start, goal, budget_checks_n=20_000)
    with pytest.raises(UsageError, match="budget_checks_n = 0"):
        planner.plan_to_joints("left_arm", start, goal, budget_checks_n=0)
    for bad in (0.0, -1.0, float("nan")):
        with pytest.raises(UsageError, match="budget_s"):
            planner.plan_to_joints("left_arm", start, goal, budget_s=bad)


def test_a_failed_proof_is_planned_again(post_planner, monkeypatch):
    """The planner's own word never counts: what the proof refuses once is made anew."""
    verifier = post_planner.engines()
    verify = verifier.verify
    calls = []

    def refuse_first(trajectory, unlimited):
        calls.append(trajectory)
        report = verify(trajectory, unlimited)
        return report if len(calls) > 1 else report._replace(ok=False, reason="made up")

    monkeypatch.setattr(verifier, "verify", refuse_first)
    result = post_planner.plan_to_joints(
        "left_arm",
        beside_the_post(1),
        beside_the_post(-1),
        seed=3,
    )
    assert result.attempts_n == 2
    assert result.notes == ("proof failed: made up",)

    def refuse_always(trajectory, unlimited):
        return verify(trajectory, unlimited)._replace(ok=False, reason="no")

    monkeypatch.setattr(verifier, "verify", refuse_always)
    with pytest.raises(NoPathInTimeError, match="proof failed: no"):
        post_planner.plan_to_joints(
            "left_arm",
            beside_the_post(1),
            beside_the_post(1)[:7] + 0.1,
            budget_checks_n=5000,
        )


def test_unknown_group_and_wrong_targets(planner):
    with pytest.raises(
        UsageError,
        match="no group 'both'; there are both_arms, left_arm, right_arm",
    ):
        planner.plan_to_joints("both", HOME, HOME)
    with pytest.raises(UsageError, match="targets name right; left_arm needs left"):
        planner.plan_to_poses("left_arm", HOME, {"right": np.eye(4)})
    moved = HOME.copy()
    moved[10] += 0.2
    with pytest.raises(UsageError, match="outside left_arm"):
        planner.plan_to_joints("left_arm", HOME, moved)


def test_allowing_and_forbidding_a_pair_changes_what_plans(planner):
    """A finger's tip inside a soft block: refused, allowed, refused again."""
    x, y, z = Kinematics().tcp_poses(HOME)[0][:3, 3]
    scene = PlanningScene().with_obstacles(Box("foam", (x, y, z - 0.05), size_m=(0.3, 0.3, 0.11)))
    start = HOME.copy()
    start[3] += 0.4
    with pytest.raises(GoalInCollisionError, match="foam"):
        planner.plan_to_joints("left_arm", start, HOME, scene=scene)
    for finger in ("leftfinger", "rightfinger"):
        scene = scene.allowing("foam", f"left_panda_{finger}", "foam is soft")
    result = planner.plan_to_joints("left_arm", start, HOME, scene=scene)
    assert result.verification.ok
    with pytest.raises(GoalInCollisionError, match="foam and left_panda_rightfinger"):
        planner.plan_to_joints(
            "left_arm",
            start,
            HOME,
            scene=scene.forbidding("left_panda_rightfinger", "foam"),
        )


def test_forbidding_a_robot_pair_changes_what_plans(planner):
    """Neighbouring links overlap at their joint: once checked, nothing plans."""
    scene = PlanningScene().forbidding("left_panda_link5", "left_panda_link6")
    with pytest.raises(StartInCollisionError, match="left_panda_link5 and left_panda_link6"):
        planner.plan_to_joints("left_arm", HOME, HOME[:7] + 0.1, scene=scene)
    back = scene.allowing("left_panda_link5", "left_panda_link6")
    assert planner.plan_to_joints("left_arm", HOME, HOME[:7] + 0.1, scene=back).verification.ok


@pytest.mark.parametrize(
    "settings",
    [{"planner": "rrtconect"}, {"fallback_planners": ("kpiece", "rrtconect")}],
)
def test_an_unknown_planner_is_refused_before_the_first_query(settings):
    config = Config.model_validate({"plan": {"planner": settings}})
    with pytest.raises(
        UsageError,
        match=r"no planner 'rrtconect'.*\n?.*did you mean 'rrtconnect'",
    ) as caught:
        STAGES["plan"].resolved(config, checked=True)
    assert "kpiece" in str(caught.value)


def test_a_planner_of_another_distribution_plans(post_planner, monkeypatch):
    monkeypatch.setitem(
        PLANNERS._rows,
        "bkpiece",
        "ompl.geometric:BKPIECE1",
    )  # as an entry point of minidual.planners names it
    other = Planner(post_planner.scene, PlannerConfig(planner="bkpiece"))
    result = other.plan_to_joints("left_arm", beside_the_post(1), beside_the_post(-1), seed=1)
    assert result.verification.ok
    assert not result.direct


def test_the_other_planner_solves_it_too(post_planner):
    other = Planner(post_planner.scene, PlannerConfig(planner="kpiece"))
    result = other.plan_to_joints("left_arm", beside_the_post(1), beside_the_post(-1), seed=1)
    assert result.verification.ok
    assert not result.direct


def test_slower_limits_are_kept(planner):
    slow = Planner(config=PlannerConfig(velocity_scale=0.2, acceleration_scale=0.1))
    report = slow.plan_to_joints("both_arms", HOME, HOME + 0.4).verification
    assert report.velocity_ratio <= 0.2 * 1.0001
    assert report.acceleration_ratio <= 0.1 * 1.0001


def test_patience_grows_up_to_a_bound():
    """A budget of hours means thousands of fruitless attempts; the next one must still be a number of checks."""
    effort = Effort(0.008, 0.05, 2500)
    sizes = []
    for _ in range(5000):
        effort = effort.after_no_path()
        sizes.append(effort.checks_n)
    assert sizes[:3] == [3750, 5625, 8437]
    assert sizes == sorted(sizes)
    assert sizes[-1] == 10_000_000
    assert (
        Effort(0.008, 0.05, 50_000_000).after_no_path().checks_n == 50_000_000
    )  # never less than was asked for


def test_padding_never_shrinks_after_a_failed_proof():
    assert Effort(0.008, 0.05, 2500).after_no_proof().padding_m == pytest.approx(0.012)
    assert Effort(0.018, 0.05, 2500).after_no_proof().padding_m == 0.02
    assert Effort(0.05, 0.05, 2500).after_no_proof().padding_m == 0.05
