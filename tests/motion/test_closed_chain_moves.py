"""Moves of a held object: found round obstacles, on the grasps all along, refused with numbers; and driven."""

import dataclasses
import itertools

import numpy as np
import pytest

from minidual.collision.errors import (
    ClosedChainError,
    GoalInCollisionError,
    IKUnreachableError,
    NoPathInTimeError,
    PlanningError,
    StartInCollisionError,
)
from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Box
from minidual.config.planning import HeldMovesConfig, PlanConfig
from minidual.config.root import Config
from minidual.config.scene import SceneConfig
from minidual.control.kernels import apart
from minidual.errors import UsageError
from minidual.motion.budget import Budget
from minidual.motion.held.constraint import GraspConstraint
from minidual.motion.held.hands import HandsIK
from minidual.motion.held.path import HeldPath, ObjectChart
from minidual.motion.held.planner import Effort, HeldPlanner, HeldWork
from minidual.motion.held.query import HeldQuery, scene_holding
from minidual.motion.held.search import search_object, shorten
from minidual.motion.held.space import HeldSpace, Q, X
from minidual.motion.pose_goals import pose_goals
from minidual.motion.search import EdgeChecker
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, inverse, pose, rot_x, rot_z
from minidual.skills.held_execution import execute
from minidual.skills.things import thing_of
from minidual.stages.plan_checks import held_checks
from minidual.tasks.task import grasp_offsets
from minidual.trials.planning import evaluate
from minidual.trials.planning.held_evaluate import (
    plan_move,
    run_moves,
    table_plans,
    timed_residual,
)
from minidual.trials.planning.held_moves import HeldMoveGenerator
from tests.support.panda import HOME, Q_LOWER, Q_UPPER

GRASPS = grasp_offsets(SceneConfig())
ROD = thing_of(SceneConfig().object).shape
HELD = {"left": GRASPS[0], "right": GRASPS[1]}
START = pose(np.eye(3), (0.5, 0.2, 0.25))
GOAL = pose(rot_z(0.3), (0.5, -0.2, 0.25))
WALL = Box("wall", (0.5, 0.0, 0.16), size_m=(0.3, 0.04, 0.32))


@pytest.fixture(scope="module")
def planner():
    return HeldPlanner()


@pytest.fixture(scope="module")
def q_start(planner):
    targets = {arm: START @ grasp for arm, grasp in HELD.items()}
    q = planner.planner.plan_to_poses("both_arms", HOME, targets).q_goal
    return HandsIK(GRASPS, DUAL_PANDA).solve(START, q)


def query(q_start, goal=GOAL, obstacles=(), **change):
    scene = scene_holding(PlanningScene().with_obstacles(*obstacles), ROD, HELD, rests_on=())
    return HeldQuery(q_start, goal, GRASPS, scene, seed=3)._replace(**change)


def failing(checks):
    return {c.name for c in checks if c.passed is False}


@pytest.fixture(scope="module")
def over_the_wall(planner, q_start):
    return planner.plan(query(q_start, obstacles=(WALL,)))


def test_free_way_is_taken_straight(planner, q_start):
    plan = planner.plan(query(q_start))
    assert plan.found_by == "continuation"
    way = plan.Ts_world_object[:, :3, 3] - START[:3, 3]
    along = (GOAL - START)[:3, 3] / np.linalg.norm((GOAL - START)[:3, 3])
    assert np.linalg.norm(way - np.outer(way @ along, along), axis=1).max() < 1e-9
    assert np.abs(plan.Ts_world_object[-1] - GOAL).max() < 1e-9
    assert np.abs(plan.q[0] - q_start).max() < 1e-9


def test_a_wall_is_passed_and_the_proof_covers_the_rod(planner, over_the_wall):
    plan = over_the_wall
    assert plan.found_by != "continuation"
    assert plan.verification.ok
    assert np.abs(plan.Ts_world_object[-1] - GOAL).max() < 1e-9
    # Oracle: dense samples, both engines, the rod attached.
    scene = scene_holding(PlanningScene().with_obstacles(WALL), ROD, HELD, rests_on=())
    audit = planner.planner.engines(scene).audit(plan)
    assert audit.collisions_n == 0
    assert audit.samples_n > 300
    # The rod went over the wall or round its end.
    middle = plan.Ts_world_object[:, :3, 3]
    crossing = np.abs(middle[:, 1]) < 0.01
    assert crossing.any()
    assert (middle[crossing, 2] > 0.32).all() or (np.abs(middle[crossing, 0] - 0.5) > 0.15).all()


def test_goal_postures_are_searched_longer_before_a_goal_is_refused(planner, q_start, monkeypatch):
    usual = planner.planner.config.ik_restarts_n
    tried = []

    def rare(*args):
        tried.append(args[-2])
        if tried[-1] <= most * usual:
            raise GoalInCollisionError("all postures found collide")
        return pose_goals(*args)

    monkeypatch.setattr("minidual.motion.held.goals.pose_goals", rare)
    monkeypatch.setattr(HeldWork, "_straight", lambda work: work.notes.append("blocked"))
    most = 1
    assert planner.plan(query(q_start)).verification.ok
    assert tried[0] == usual < tried[1]
    most = 1_000
    with pytest.raises(GoalInCollisionError, match="all postures found collide"):
        planner.plan(query(q_start))


def test_hands_keep_their_grasps_at_1_khz_and_between(over_the_wall, q_start):
    worst = timed_residual(over_the_wall, query(q_start), Kinematics())
    assert worst[0] < 1e-4
    assert worst[1] < np.deg2rad(0.05)
    # Oracle: forward kinematics at random times against the constraint.
    constraint = GraspConstraint(inverse(GRASPS[0]) @ GRASPS[1], Kinematics())
    times = np.random.default_rng(0).uniform(0.0, over_the_wall.duration_s, 400)
    off = np.array(
        [constraint.value_and_jacobian(q)[0] for q in over_the_wall.sample_many(times)[0]],
    )
    assert np.linalg.norm(off[:, :3], axis=1).max() < 1e-4
    assert np.linalg.norm(off[:, 3:], axis=1).max() < np.deg2rad(0.05)
    # Negative control: a hand that turns by 2 mrad is seen.
    bent = over_the_wall.q.copy()
    bent[len(bent) // 2, 13] += 2e-3
    assert (
        timed_residual(dataclasses.replace(over_the_wall, q=bent), query(q_start), Kinematics())[1]
        > 1.9e-3
    )


def test_same_query_same_bytes(planner, over_the_wall, q_start):
    assert HeldPlanner().plan(query(q_start, obstacles=(WALL,))).digest() == over_the_wall.digest()


def test_continuation_and_projection_agree_with_the_grasps(q_start):
    hands = HandsIK(GRASPS, DUAL_PANDA)
    path = HeldPath.through([START, pose(rot_z(0.5) @ rot_x(0.3), (0.45, 0.0, 0.35))])
    Ts = path.poses(np.linspace(0.0, path.length, 40))
    followed, ended = hands.follow(Ts, q_start)
    assert ended is None
    assert max(hands.strays(followed, Ts)) < 1e-7
    q = hands.solve(Ts[20], followed[15])
    assert max(hands.strays(q[None], Ts[20][None])) < 1e-8
    assert hands.solve(pose(np.eye(3), (3.0, 0.0, 0.0)), q_start) is None
    swung = hands.solve(START, q_start + hands.elbow_swing(q_start, np.array([0.3, -0.3])))
    assert np.abs(swung - q_start).max() > 0.1
    assert max(hands.strays(swung[None], START[None])) < 1e-8


def test_rounding_beyond_a_limit_is_cut_off_and_more_is_refused(monkeypatch, q_start):
    hands = HandsIK(GRASPS, DUAL_PANDA)
    q = q_start.copy()
    monkeypatch.setattr(hands, "_nearest", lambda *_: q)
    q[10] = Q_UPPER[10] + 5e-7
    assert hands.solve(START, q_start)[10] == Q_UPPER[10]
    for beyond in (Q_UPPER[10] + 1e-5, Q_LOWER[10] - 1e-5, np.nan):
        q[10] = beyond
        assert hands.solve(START, q_start) is None


def test_joints_are_pushed_off_their_limits_only_near_them():
    off_limits = HandsIK(GRASPS, DUAL_PANDA).off_limits
    assert not off_limits(HOME).any()
    near = HOME.copy()
    near[0], near[5] = Q_LOWER[0] + 0.05, Q_UPPER[5] - 0.05
    push = off_limits(near)
    assert push[0] > 0.0 > push[5]
    assert np.count_nonzero(push) == 2


def test_search_and_shortening_stay_free(planner, q_start):
    problem = query(q_start, obstacles=(WALL,))
    hands = HandsIK(GRASPS, DUAL_PANDA)
    q_goal = planner.plan(problem).q[-1]
    checker = EdgeChecker(planner.planner.engines(problem.scene), 0.005, (q_start, q_goal), 0.03)
    space = HeldSpace(hands, ObjectChart(START[:3, :3]), checker)
    start = space.point(START, q_start)
    goal = space.point(GOAL, q_goal)
    assert not space.edge_free(start, goal)
    rng = np.random.default_rng(5)
    checker.allow(20_000, Budget())
    path = search_object(space, start, [goal], rng, any_posture=False)
    assert path is not None
    assert np.array_equal(path[0], start)
    assert np.array_equal(path[-1], goal)

    def length(points):
        return sum(float(space.distance(a, b[None])[0]) for a, b in itertools.pairwise(points))

    short = shorten(space, path, rng, 20)
    assert length(short) <= length(path) + 1e-9
    for a, b in itertools.pairwise(short):
        assert space.edge_free(a, b)
    for z in short:
        assert max(hands.strays(z[Q][None], space.chart.pose(z[X])[None])) < 1e-7
    checker.allow(5, Budget())
    refused = search_object(space, start, [goal], rng)
    assert refused is None


def test_bad_queries_are_named_with_numbers(planner, q_start):
    off = q_start.copy()
    off[6] += 0.05
    with pytest.raises(
        ClosedChainError,
        match=r"right hand is \d+\.\d+ mm and 0\.05\d+ rad off its grasp",
    ):
        planner.plan(query(off))
    far = pose(np.eye(3), (1.4, 0.0, 0.3))
    with pytest.raises(IKUnreachableError, match=r"hand cannot reach .*mm and \d+\.\d+ rad away"):
        planner.plan(query(q_start, far))
    inside = Box("block", tuple(GOAL[:3, 3]), size_m=(0.1, 0.1, 0.1))
    with pytest.raises(GoalInCollisionError, match="block and rod penetrate by"):
        planner.plan(query(q_start, obstacles=(inside,)))
    here = Box("block", tuple(START[:3, 3]), size_m=(0.1, 0.1, 0.1))
    with pytest.raises(StartInCollisionError, match="block and rod penetrate by"):
        planner.plan(query(q_start, obstacles=(here,)))
    with pytest.raises(UsageError, match="the goal of the object holds a value that is not finite"):
        planner.plan(query(q_start, GOAL * np.nan))
    with pytest.raises(UsageError, match="budget_s = 0"):
        planner.plan(query(q_start), budget_s=0.0)
    walled = query(q_start, obstacles=(WALL,))
    with pytest.raises(
        NoPathInTimeError, match=r"in 0.00 s; the straight way: it is blocked: .*wall"
    ):
        planner.plan(walled, budget_s=1e-6)
    with pytest.raises(NoPathInTimeError, match=r"in 1 state checks; the straight way: .*wall"):
        planner.plan(walled, budget_checks_n=1)


@pytest.fixture(scope="module")
def outcomes(planner):
    generator = HeldMoveGenerator(1, SceneConfig())
    return [plan_move(planner, generator.move(i)) for i in range(4)]


def test_moves_are_what_they_say(outcomes):
    again = HeldMoveGenerator(1, SceneConfig()).move(1)
    assert np.array_equal(again.query.T_world_goal, outcomes[1].move.query.T_world_goal)
    assert np.array_equal(again.witness, outcomes[1].move.witness)
    other = HeldMoveGenerator(2, SceneConfig()).move(1)
    assert not np.array_equal(again.query.T_world_goal, other.query.T_world_goal)
    for outcome in outcomes:
        move = outcome.move
        way_m, turn_rad = apart(move.query.T_world_goal, move.T_world_start, np.empty(6))
        assert 0.05 <= way_m <= 0.5
        assert turn_rad <= np.pi / 2 + 1e-9
        assert move.with_obstacles == (move.index % 2 == 1)
        assert len(move.query.scene.obstacles) == (4 if move.with_obstacles else 1)
        assert move.blocked or not move.with_obstacles
        hands = HandsIK(GRASPS, DUAL_PANDA)
        assert max(hands.strays(move.query.q_start[None], move.T_world_start[None])) < 1e-6
        assert np.abs(move.witness[0, Q] - move.query.q_start).max() < 1e-9
        assert outcome.ok
        assert outcome.residual_m < 1e-4


def test_a_witness_that_passes_through_things_is_refused(planner, q_start):
    """Negative control of the rule that a move counts only with a proven witness."""
    hands = HandsIK(GRASPS, DUAL_PANDA)
    path = HeldPath.through([START, GOAL])
    followed, _ = hands.follow(path.poses(np.linspace(0.0, path.length, 60)), q_start)
    chart = ObjectChart(START[:3, :3])
    points = np.array(
        [
            np.concatenate([chart.coordinates(T), q])
            for T, q in ((START, q_start), (GOAL, followed[-1]))
        ],
    )
    assert HeldWork(planner.planner, query(q_start)).rounded(points, "given").verification.ok
    with pytest.raises(ClosedChainError, match=r"not free: .*wall"):
        HeldWork(planner.planner, query(q_start, obstacles=(WALL,))).rounded(points, "given")


@pytest.fixture(scope="module")
def driven():
    scene = SceneConfig()
    generator = HeldMoveGenerator(5, scene, from_table=True)
    planner = HeldPlanner()
    world = World(scene)
    plans = [planner.plan(generator.move(i).query) for i in (0, 1)]
    return scene, plans, [execute(plan, world) for plan in plans]


def test_the_rod_follows_the_plan_within_2_mm_and_1_degree(driven):
    _, plans, executions = driven
    turned = [apart(p.Ts_world_object[-1], p.Ts_world_object[0], np.empty(6))[1] for p in plans]
    assert max(turned) > 0.5  # one of them turns the rod by more than 30 degrees
    for execution in executions:
        assert execution.error_max_m < 0.002
        assert execution.error_max_rad < np.deg2rad(1.0)
        assert execution.error_max_m > 0.0
        assert execution.pinch_min_n > 20.0


def test_an_execution_that_strays_is_seen(driven):
    """Negative control: a plan whose object is said to be elsewhere, and hands that never closed."""
    scene, plans, _ = driven
    elsewhere = plans[0].Ts_world_object.copy()
    elsewhere[200:, 0, 3] += 0.003
    assert (
        execute(dataclasses.replace(plans[0], Ts_world_object=elsewhere), World(scene)).error_max_m
        > 0.0025
    )
    dropped = execute(plans[0], World(scene), close_s=0.001)
    assert dropped.error_max_m > 0.002
    tilted = plans[0].Ts_world_object.copy()
    tilted[0, :3, :3] = rot_x(0.2)
    with pytest.raises(ValueError, match="must lie level"):
        execute(dataclasses.replace(plans[0], Ts_world_object=tilted), World(scene))


def test_every_check_can_fail(outcomes, driven):
    config = PlanConfig(held=HeldMovesConfig(cpu_time_median_max_s=10.0, executed_n=2))
    executions = driven[2]

    def names(first=None, second=None, runs=None, config=config):
        sets = {"first": first or outcomes, "second": second or outcomes}
        return failing(held_checks(sets, executions if runs is None else runs, config))

    assert names() == set()
    failed = dataclasses.replace(outcomes[0], result=None, residual_m=np.nan, residual_rad=np.nan)
    assert names(first=[failed, *outcomes[1:]]) == {"closed_chain.success_rate"}
    assert names(second=[failed, *outcomes[1:]]) == {"closed_chain.second_seed_success_rate"}
    stray = dataclasses.replace(outcomes[0], residual_m=2e-4, residual_rad=1e-3)
    assert names(second=[stray]) == {"closed_chain.residual_max_m", "closed_chain.residual_max_rad"}
    unmeasured = dataclasses.replace(outcomes[0], residual_m=np.nan)
    assert names(first=[unmeasured, *outcomes[1:]]) == {"closed_chain.residual_max_m"}
    slow = [dataclasses.replace(o, cpu_s=11.0) for o in outcomes]
    assert names(first=slow) == {"closed_chain.cpu_time_median_s"}
    unlimited = PlanConfig(held=HeldMovesConfig(cpu_time_median_max_s=None, executed_n=2))
    assert names(first=slow, config=unlimited) == set()
    far = dataclasses.replace(executions[0], error_max_m=0.0021, error_max_rad=0.018)
    assert names(runs=[far, executions[1]]) == {
        "closed_chain.executed_error_max_m",
        "closed_chain.executed_error_max_rad",
    }
    lost = dataclasses.replace(executions[0], error_max_m=float("nan"))
    assert names(runs=[lost, executions[1]]) == {"closed_chain.executed_error_max_m"}
    left_out = dataclasses.replace(
        outcomes[0],
        move=dataclasses.replace(outcomes[0].move, undecided_n=3, unreachable_n=5),
    )
    sets = {"first": [left_out], "second": [left_out]}
    (draws,) = [c for c in held_checks(sets, executions, config) if "left_out" in c.name]
    assert draws.observed == 6
    assert "10 more had no free posture" in draws.why
    assert names(runs=executions[:1]) == {"closed_chain.driven_n"}
    assert names(runs=[]) == {
        "closed_chain.driven_n",
        "closed_chain.executed_error_max_m",
        "closed_chain.executed_error_max_rad",
    }
    nothing = [failed]
    assert names(first=nothing, second=nothing) >= {
        "closed_chain.residual_max_m",
        "closed_chain.success_rate",
    }


class _StrayingPlanner(HeldPlanner):
    """Plans in which one joint strays by a milliradian."""

    joint = 13

    def plan(self, *given, **options):
        plan = super().plan(*given, **options)
        return dataclasses.replace(plan, q=plan.q + 1e-3 * np.eye(14)[self.joint])


def test_faults_of_scene_planner_and_clock_fail_their_checks(
    planner, outcomes, driven, monkeypatch
):
    config = PlanConfig(held=HeldMovesConfig(executed_n=2))

    def names(first=outcomes, second=outcomes):
        return failing(held_checks({"first": first, "second": second}, driven[2], config))

    move = outcomes[0].move
    block = Box("block", tuple(move.query.T_world_goal[:3, 3]), size_m=(0.1, 0.1, 0.1))
    scene = move.query.scene.with_obstacles(block)
    blocked = plan_move(
        planner,
        dataclasses.replace(move, query=move.query._replace(scene=scene)),
    )
    assert names(first=[blocked, *outcomes]) == {"closed_chain.success_rate"}
    assert names(second=[blocked, *outcomes]) == {"closed_chain.second_seed_success_rate"}
    straying = _StrayingPlanner()
    turned = plan_move(straying, move)
    assert names(first=[turned, *outcomes]) == {"closed_chain.residual_max_rad"}
    straying.joint = 7
    shifted = plan_move(straying, move)
    assert "closed_chain.residual_max_m" in names(first=[shifted, *outcomes])
    readings = iter([0.0, 5.0])
    monkeypatch.setattr(evaluate, "process_time", lambda: next(readings))
    slow = plan_move(planner, move)
    assert names(first=[slow]) == {"closed_chain.cpu_time_median_s"}


def test_faults_of_hands_and_scene_fail_the_checks_of_driven_moves(outcomes, driven):
    """Hands that never closed, a rod that somebody turns, and a move that cannot be drawn."""
    scene, plans, executions = driven
    config = PlanConfig(held=HeldMovesConfig(executed_n=2))
    sets = {"first": outcomes, "second": outcomes}
    dropped = execute(plans[0], World(scene), close_s=0.001)
    names = failing(held_checks(sets, [dropped, executions[1]], config))
    assert "closed_chain.executed_error_max_m" in names
    world = World(scene)
    rod = world.model.body("rod").id
    step = world.step

    def turned():
        world.data.xfrc_applied[rod, 3] = 6.0
        step()

    world.step = turned
    turned_rod = execute(plans[0], world)
    names = failing(held_checks(sets, [turned_rod, executions[1]], config))
    assert "closed_chain.executed_error_max_rad" in names
    assert failing(held_checks(sets, executions[:1], config)) == {"closed_chain.driven_n"}


def test_moves_that_cannot_be_made_are_told_and_do_not_end_the_stage(monkeypatch):
    """Of two moves off the table one cannot be drawn; and a warm-up that cannot be is passed over."""
    real = HeldMoveGenerator.move

    def move(self, index):
        if index == 1 or self._seed == 6:
            raise PlanningError("no such move")
        return real(self, index)

    monkeypatch.setattr(HeldMoveGenerator, "move", move)
    plans, failures = table_plans(Config(plan=PlanConfig(held=HeldMovesConfig(executed_n=2))), 5)
    assert len(plans) == 1
    assert failures == ["held move 1 off the table cannot be driven: no such move"]
    config = Config(plan=PlanConfig(held=HeldMovesConfig(moves_n=2)))
    monkeypatch.setattr(
        HeldMoveGenerator,
        "move",
        lambda self, i: move(self, 0 if self._seed == 5 else i),
    )
    assert [o.ok for o in run_moves(config, 5)] == [True, True]


@pytest.mark.parametrize("method", ["projected", "atlas"])
def test_the_manifold_search_keeps_the_grasps(planner, q_start, method):
    """A goal off the manifold finds nothing; the way to one on it holds the object and joins free edges."""
    asked = query(q_start)
    end = planner.plan(asked).q[-1]
    work = HeldWork(planner.planner, asked)
    effort = Effort(0.0, checks_n=1500)
    assert work.search(method, [end + 0.3], effort._replace(checks_n=50), 1) is None
    points = work.search(method, [end + 0.3, end], effort, 1)
    assert np.abs(points[-1, Q] - end).max() < 1e-3
    hands = HandsIK(GRASPS, DUAL_PANDA)
    chart = ObjectChart(START[:3, :3])
    assert max(hands.strays(points[:, Q], chart.poses(points[:, X]))) < 1e-6


def test_a_search_that_fails_keeps_the_known_goals(planner, q_start, monkeypatch):
    end = planner.plan(query(q_start)).q[-1]
    work = HeldWork(planner.planner, query(q_start, obstacles=(WALL,)))
    searched = []

    def postures(straight, wanted_n, *_):
        if wanted_n == 1:
            return [end]
        raise GoalInCollisionError("none of them is free")

    def off(method, goals, *_):
        searched.append(goals[0])
        raise ClosedChainError("the goal cannot keep the relative pose")

    monkeypatch.setattr(work.goals, "postures", postures)
    monkeypatch.setattr(work, "search", off)
    with pytest.raises(NoPathInTimeError, match=r"the last one: .*cannot keep the relative pose"):
        work.run()
    assert len(searched) > 3
    assert all(goal is end for goal in searched)
    assert sum("none of them is free" in note for note in work.notes) == 2
