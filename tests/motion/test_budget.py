"""Counted budgets: a plan depends on its query and seed, never on a clock."""

import hashlib
from functools import partialmethod

import numpy as np
import pytest

from minidual.collision.errors import NoPathInTimeError
from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Box
from minidual.config.root import Config, changed
from minidual.config.scene import SceneConfig
from minidual.motion.api import Planner
from minidual.motion.budget import ATTEMPT_CHECKS_N, Budget
from minidual.motion.held.hands import HandsIK
from minidual.motion.held.path import ObjectChart
from minidual.motion.held.planner import HeldPlanner
from minidual.motion.held.search import search_object
from minidual.motion.held.space import HeldSpace
from minidual.motion.search import PLANNERS, EdgeChecker, search
from minidual.skills.cycle import solve
from minidual.skills.pipeline.search import Pipeline, TaskFailedError
from minidual.skills.states import State
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import pose_of
from minidual.trials.planning.held_moves import HeldMoveGenerator
from tests.support.clocks import hurry
from tests.support.panda import HOME

POST = Box("post", (0.36, 0.25, 0.4), size_m=(0.06, 0.06, 0.8))
LEFT = HOME.copy()
LEFT[0] = 1.0
RIGHT = HOME.copy()
RIGHT[0] = -1.0


@pytest.fixture(scope="module")
def planner():
    return Planner(PlanningScene().with_obstacles(POST))


def refusal(planner, **limits):
    with pytest.raises(NoPathInTimeError) as caught:
        planner.plan_to_joints("left_arm", LEFT, RIGHT, seed=2, **limits)
    return caught.value.message


def test_the_same_plan_while_the_clock_races(planner, monkeypatch):
    calm = planner.plan_to_joints("left_arm", LEFT, RIGHT, seed=2)
    assert not calm.direct
    hurry(monkeypatch)
    busy = planner.plan_to_joints("left_arm", LEFT, RIGHT, seed=2)
    assert busy.trajectory.digest() == calm.trajectory.digest()
    assert "in 10.00 s: 0 attempts" in refusal(planner, budget_s=10.0)  # a person's limit does end


def test_the_same_refusal_while_the_clock_races(planner, monkeypatch):
    calm = refusal(planner, budget_checks_n=ATTEMPT_CHECKS_N + 30)
    assert "in 1030 state checks: 1 attempts" in calm
    hurry(monkeypatch)
    assert refusal(planner, budget_checks_n=ATTEMPT_CHECKS_N + 30) == calm


def test_the_same_move_of_a_held_object_while_the_clock_races(monkeypatch):
    move = HeldMoveGenerator(1, SceneConfig()).move(1)
    planner = HeldPlanner()
    calm = planner.plan(move.query)
    assert calm.found_by == "object_rrt"
    hurry(monkeypatch)
    assert planner.plan(move.query).digest() == calm.digest()
    again = HeldMoveGenerator(1, SceneConfig()).move(1)
    assert np.array_equal(again.witness, move.witness)


def planned(name):
    """Return the hash of a trial's plan, or why it has none."""
    task = make_task(changed(Config(), {"task": name}))
    trial = task.trial(0, "budget", 0)
    start = {name: pose_of(item.body, trial.start[name]) for name, item in task.objects.items()}
    planner = Planner()
    try:
        solution = solve(task, trial, State(planner.robot.home, start), planner)
    except TaskFailedError as error:
        return f"{error.summary}; {error.record.ended}"
    digest = hashlib.sha256()
    for segment in solution.segments:
        digest.update(segment.trajectory.q.tobytes())
    return digest.hexdigest()


@pytest.mark.parametrize("name", ["rod_carry", "handover", "sort"])
def test_a_trial_is_planned_alike_while_the_clock_races(name, monkeypatch):
    calm = planned(name)
    assert len(calm) == 64
    hurry(monkeypatch)
    assert planned(name) == calm


def test_a_trial_with_less_work_is_refused_alike(monkeypatch):
    limited = partialmethod(Pipeline.solve, budget_checks_n=7000)
    monkeypatch.setattr(Pipeline, "solve", limited)
    calm = planned("handover")
    assert "gave up after" in calm
    hurry(monkeypatch)
    assert planned("handover") == calm


class Blind(PLANNERS["rrtconnect"]):
    """A planner that checks no state and asks only whether it shall end."""

    def solve(self, condition):
        while not condition():
            pass
        return super().solve(condition)


def test_a_planner_that_checks_nothing_ends(planner, monkeypatch):
    PLANNERS.names("rrtconnect")  # reads the entry points
    monkeypatch.setitem(PLANNERS._rows, "blind", Blind)
    checker = EdgeChecker(planner.engines(), 0.0, (LEFT, RIGHT), 0.1)
    checker.allow(10_000, Budget(500))
    left_arm = planner.robot.groups["left_arm"]
    assert search(checker, np.array([LEFT, RIGHT]), left_arm, seed=1, planner="blind") is None
    assert checker.budget.spent_n == pytest.approx(500, abs=20)


def test_a_search_whose_ik_never_succeeds_ends(monkeypatch):
    """It makes no state check, so only the charge for its IK ends it."""
    move = HeldMoveGenerator(1, SceneConfig()).move(1)
    planner = Planner()
    query = move.query
    hands = HandsIK(query.grasps, planner.robot)
    checker = EdgeChecker(planner.engines(query.scene), 0.0, (query.q_start,), 0.1)
    space = HeldSpace(hands, ObjectChart(move.T_world_start[:3, :3]), checker)
    ends = [space.point(T, query.q_start) for T in (move.T_world_start, query.T_world_goal)]
    monkeypatch.setattr(hands, "solve", lambda *_: None)
    checker.allow(1000, Budget(400))
    assert search_object(space, ends[0], ends[1:], np.random.default_rng(1)) is None
    assert checker.checks_n == 0
    assert 400 <= checker.budget.spent_n < 420


def test_a_budget_charges_the_account_around_it_and_says_its_limits():
    account = Budget()
    for checks_n in (5, 7):
        Budget(10, within=account).spend(checks_n)
    assert account.spent_n == 12
    assert not account.ended
    inner = Budget(10)
    inner.spend(9)
    assert not inner.ended
    inner.spend(1)
    assert inner.ended
    assert str(inner) == "10 state checks"
    assert str(Budget(wall_s=2.5)) == "2.50 s"
    assert str(Budget(10, 2.5)) == "10 state checks or 2.50 s"
    assert str(account) == "unlimited work"


def test_a_planner_sums_the_work_of_its_queries(planner):
    before_n = planner.work.spent_n
    planner.plan_to_joints("left_arm", LEFT, RIGHT, seed=2)
    first_n = planner.work.spent_n - before_n
    assert first_n > ATTEMPT_CHECKS_N
    planner.plan_to_joints("left_arm", LEFT, RIGHT, seed=2)
    assert planner.work.spent_n - before_n == 2 * first_n
