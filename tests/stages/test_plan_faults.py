"""Faults of the scene, the engines and the planner: each makes its own check of `plan` say no."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import pytest

from minidual.collision.engines import CoalEngine
from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import ENGINES, Box
from minidual.config.planning import PlanConfig
from minidual.config.root import Config
from minidual.config.scene import SceneConfig, TaskConfig
from minidual.gate.check import Check
from minidual.motion.api import Planner, PlanResult
from minidual.proof import scene_engines
from minidual.proof.scene_engines import SceneEngines
from minidual.robot.kinematics import Kinematics
from minidual.stages.plan_checks import CARRIES_N, common_checks, group_checks
from minidual.trials.planning import evaluate
from minidual.trials.planning.evaluate import QueryOutcome, engine_agreement, plan_query, repeats
from minidual.trials.planning.queries import Query, QueryGenerator

CONFIG = PlanConfig()


@pytest.fixture(scope="module")
def planner() -> Planner:
    """A planner that the tests share."""
    return Planner()


@pytest.fixture(scope="module")
def query() -> Query:
    """A query past an obstacle."""
    return QueryGenerator(3).query("left_arm", 0)


@pytest.fixture(scope="module")
def outcome(planner: Planner, query: Query) -> QueryOutcome:
    """The query, solved."""
    return plan_query(planner, query)


def failing(checks: list[Check]) -> set[str]:
    return {check.name for check in checks if check.passed is False}


def common(outcomes: list[QueryOutcome], **changes: float) -> set[str]:
    """Return the failing checks of all groups, with sound numbers apart from `changes`."""
    numbers = {"agreement": 1.0, "repeatable": True, "carries_failed_n": 0, **changes}
    return failing(common_checks(outcomes, config=CONFIG, **numbers))


def bare(query: Query) -> Query:
    """Return a query whose scene holds the table alone."""
    return dataclasses.replace(query, scene=PlanningScene(obstacles=query.scene.obstacles[:1]))


def test_a_goal_that_something_stands_on(planner: Planner, query: Query) -> None:
    hand = Kinematics().tcp_poses(query.q_goal)[0][:3, 3]
    block = Box("block", tuple(hand), size_m=(0.1, 0.1, 0.1))
    blocked = dataclasses.replace(query, scene=query.scene.with_obstacles(block))
    outcome = plan_query(planner, blocked)
    assert outcome.reason
    assert failing(group_checks("left_arm", [outcome], CONFIG)) == {"left_arm.success_rate"}


@pytest.mark.parametrize(
    ("lasts_s", "names"),
    [
        (0.01, set()),
        (0.3, {"left_arm.replan_median_s"}),
        (11.0, {"left_arm.replan_median_s", "left_arm.replan_max_s"}),
    ],
)
def test_a_planner_that_takes_long(
    monkeypatch: pytest.MonkeyPatch,
    planner: Planner,
    query: Query,
    lasts_s: float,
    names: set[str],
) -> None:
    """The clock goes on by so much while the planner works."""
    readings: Iterator[float] = iter([0.0, 0.0, 0.0, lasts_s])
    monkeypatch.setattr(evaluate, "perf_counter", lambda: next(readings))
    outcome = plan_query(planner, query)
    assert failing(group_checks("left_arm", [outcome], CONFIG)) == names


def test_an_audit_that_does_not_take_place(
    monkeypatch: pytest.MonkeyPatch,
    planner: Planner,
    outcome: QueryOutcome,
) -> None:
    assert common([evaluate.audited(outcome, planner)]) == set()
    monkeypatch.setattr(SceneEngines, "audit", lambda *_: None)
    names = common([evaluate.audited(outcome, planner)])
    assert names == {"proof.audited_n", "proof.audit_states"}


def test_a_path_proven_in_another_scene_than_the_audited(planner: Planner, query: Query) -> None:
    """The planner did not know the obstacle that stands in the way."""
    outcome = plan_query(planner, bare(query))
    audited = evaluate.audited(dataclasses.replace(outcome, query=query), planner)
    assert common([audited]) == {"proof.audit_collisions"}


def test_two_engines_that_see_different_scenes(
    monkeypatch: pytest.MonkeyPatch,
    query: Query,
) -> None:
    """Coal does not know the obstacles."""
    without = bare(query).scene
    engines = {"mujoco": ENGINES["mujoco"], "coal": lambda _scene: CoalEngine(without)}
    monkeypatch.setattr(scene_engines, "ENGINES", engines)
    planner = Planner()
    unaware = plan_query(planner, bare(query))
    audited = evaluate.audited(dataclasses.replace(unaware, query=query), planner)
    names = common([audited], agreement=engine_agreement(query.scene, 400, 1))
    assert names == {
        "proof.audit_collisions",
        "proof.audit_disagreements",
        "engines.agreement",
    }


def test_a_planner_that_draws_from_the_clock(
    monkeypatch: pytest.MonkeyPatch,
    outcome: QueryOutcome,
) -> None:
    """Each plan has a seed of its own."""
    assert common([], repeatable=repeats(CONFIG, outcome)) == {"proof.audit_states"}
    seeds = iter(range(100, 200))
    real = Planner.plan_to_joints

    def plan(self: Planner, *given: Any, **options: Any) -> PlanResult:
        return real(self, *given, **{**options, "seed": next(seeds)})

    monkeypatch.setattr(Planner, "plan_to_joints", plan)
    assert not outcome.query.as_poses
    assert "repeatable" in common([], repeatable=repeats(CONFIG, outcome))


def test_carries_to_a_goal_out_of_reach() -> None:
    far = SceneConfig(task=TaskConfig(goal_xy_m=(1.4, -0.3)))
    failures = evaluate.failed_carries(Config(scene=far), 1)
    assert len(failures) == 1
    assert CARRIES_N > 1
    assert "closed_chain.carries_rate" in common([], carries_failed_n=len(failures))
