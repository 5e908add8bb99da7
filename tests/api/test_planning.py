"""The public planner: goals and starts of every kind, in one call."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from minidual.api.planning import Planner, load_scene
from minidual.collision.errors import GoalInCollisionError, IKUnreachableError, OutOfLimitsError
from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Box
from minidual.errors import ConfigError, UsageError

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def planner() -> Planner:
    return Planner()


def test_a_plan_is_proven_and_says_what_it_uses(planner: Planner) -> None:
    plan = planner.plan("ready", seed=1)
    assert plan.proven
    assert plan.group == "both_arms"
    assert 0.1 < plan.duration_s < 5.0
    assert 0.0 < plan.planning_s <= sum(plan.times_s.values()) + 1.0
    assert 0.0 < plan.clearance_m <= 0.05
    assert set(plan.limits_used) == {"velocity", "acceleration", "jerk", "torque", "torque_rate"}
    assert all(0.0 < share <= 1.0 for share in plan.limits_used.values())
    assert np.allclose(plan.sample(0.0).q, planner.home)


def test_the_same_query_and_seed_give_the_same_motion(planner: Planner) -> None:
    first = planner.plan("ready", seed=3)
    second = planner.plan("ready", seed=3)
    assert first.trajectory.digest() == second.trajectory.digest()


def test_a_plan_goes_on_from_another_one(planner: Planner) -> None:
    ready = planner.plan("ready")
    back = planner.plan("home", start=ready)
    assert np.allclose(back.trajectory.q[0], ready.q_end_rad)
    assert np.allclose(back.q_end_rad, planner.home, atol=1e-6)


def test_a_hand_without_a_pose_keeps_its_own(planner: Planner) -> None:
    poses = planner.tcp_poses(planner.home)
    target = poses["left"].copy()
    target[2, 3] += 0.05
    for group in ("both_arms", "left_arm"):
        plan = planner.plan({"left": target}, group=group)
        reached = planner.tcp_poses(plan.q_end_rad)
        assert np.abs(reached["left"] - target).max() < 1e-3
        assert np.abs(reached["right"] - poses["right"]).max() < 1e-3


def test_joints_of_the_group_are_a_goal(planner: Planner) -> None:
    q = planner.home
    q[0] += 0.3
    plan = planner.plan(q[:7], group="left_arm", start=planner.home)
    assert np.allclose(plan.q_end_rad, q)


def test_a_goal_file_is_a_goal(planner: Planner) -> None:
    plan = planner.plan(str(ROOT / "examples" / "beside-post.yaml"), group="left_arm")
    assert plan.q_end_rad[0] == pytest.approx(1.1)


def test_what_cannot_be_planned_is_refused_with_its_reason(planner: Planner) -> None:
    far = planner.tcp_poses(planner.home)["left"]
    far[0, 3] = 3.0
    with pytest.raises(IKUnreachableError, match="cannot reach"):
        planner.plan({"left": far})
    with pytest.raises(UsageError, match="raedy"):
        planner.plan("raedy")
    with pytest.raises(UsageError, match="third_arm"):
        planner.plan("ready", group="third_arm")
    with pytest.raises(OutOfLimitsError, match="all 14 joints"):
        planner.plan("ready", start=[0.0, 1.0])
    with pytest.raises(UsageError, match="budget_s"):
        planner.plan("ready", budget_s=-1.0)


def test_the_scene_counts() -> None:
    hand = Planner().tcp_poses(Planner().home)["left"][:3, 3]
    block = Box("block", tuple(hand.tolist()), size_m=(0.1, 0.1, 0.1))
    planner = Planner(PlanningScene().with_obstacles(block))
    with pytest.raises(GoalInCollisionError, match="block"):
        planner.plan("home", start=away(planner))


def away(planner: Planner) -> list[float]:
    """Return joints with the left hand off its place at home."""
    q = planner.home
    q[0] += 0.8
    return q.tolist()


def test_a_scene_file_is_read_for_the_named_arm() -> None:
    scene = load_scene(str(ROOT / "examples" / "bench-scene.yaml"))
    assert {"post", "pipe", "bracket", "cup"} <= set(scene.names)
    with pytest.raises(UsageError, match="pandu"):
        load_scene(ROOT / "examples" / "bench-scene.yaml", arm="pandu")


def test_a_wrong_scene_file_names_the_line(tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text("table: true\nobstacle: []\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"scene.yaml:2.*obstacle"):
        load_scene(file)
