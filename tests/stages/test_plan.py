"""The query set and the plan stage: every check can say no."""

import csv
import dataclasses
import json

import numpy as np
import pytest

from minidual.collision.engines import CoalEngine, MujocoEngine
from minidual.collision.errors import PlanningError, TimingError
from minidual.collision.scene import PlanningScene
from minidual.config.loader import load_config
from minidual.config.planning import HeldMovesConfig, PlanConfig, PlannerConfig
from minidual.config.root import Config
from minidual.config.scene import ObjectConfig, PhysicsConfig, RobotConfig, SceneConfig, TaskConfig
from minidual.errors import ConfigError, DataError, UsageError
from minidual.gate.stage import StageContext
from minidual.motion.api import Planner
from minidual.proof.scene_engines import Audit, SceneEngines
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import pose
from minidual.stages.config_checks import check_plan
from minidual.stages.plan import failure_notes, run
from minidual.stages.plan_checks import common_checks, group_checks
from minidual.stages.registry import STAGES
from minidual.trials.planning import queries
from minidual.trials.planning.evaluate import engine_agreement, plan_query, repeats, run_queries
from minidual.trials.planning.queries import (
    QueryGenerator,
    polyline_states,
    query_source,
    stored_query,
    stored_set,
)
from minidual.trials.planning.retiming import retime
from scripts.make_query_set import is_free, witness
from tests.support.panda import GROUPS
from tests.support.read_recorder import recorded, unlisted

_PLANNED_STRAIGHT = 38
"""A stored query of poses whose planned posture is reached by the straight line."""
CONFIG = Config(
    plan=PlanConfig(
        queries_n=2,
        second_queries_n=1,
        agreement_states_n=200,
        held=HeldMovesConfig(moves_n=2, executed_n=1),
    ),
)


@pytest.fixture(scope="module")
def stage_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plan")
    config, reads = recorded(CONFIG)
    result = run(StageContext(folder=folder, config=config, seed=5, profile="smoke"))
    return folder, result, reads


def failing(checks):
    return {c.name for c in checks if c.passed is False}


def test_stage_reads_no_value_that_its_verdict_does_not_record(stage_run):
    """The model of the scene has cameras and marks, which none of its results show."""
    _, _, reads = stage_run
    looks = ("scene.camera", "scene.marks", "seed")
    assert unlisted(reads, [*STAGES["plan"].reads, *looks]) == []
    assert "scene.task.lift_height_m" in reads


def test_stage_passes_and_writes_what_it_says(stage_run):
    folder, result, _ = stage_run
    assert failing(result.checks) == set()
    names = {c.name for c in result.checks}
    for group in GROUPS:
        assert {
            f"{group}.success_rate",
            f"{group}.replan_median_s",
            f"{group}.replan_max_s",
            f"{group}.first_plan_median_s",
        } <= names
    with (folder / "queries.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 6
    assert {row["group"] for row in rows} == set(GROUPS)
    for row in rows:
        phases = sum(
            float(row[f"{p}_s"]) for p in ("ik", "search", "shortcut", "blend", "timing", "verify")
        )
        assert phases <= float(row["total_s"]) + 1e-5
        assert float(row["velocity_ratio"]) <= 0.951
    assert {
        "second_seed.both_arms.success_rate",
        "proof.audit_collisions",
        "left_arm.replan_p99_s",
    } <= names
    ratio = next(c for c in result.checks if c.name == "timing.own_to_toppra")
    assert ratio.limit is None
    assert 1.0 < ratio.observed < 1.5
    assert "median duration of 6 planned paths" in ratio.why
    assert len((folder / "queries_second_seed.csv").read_text().splitlines()) == 4
    for row in rows:
        assert int(row["audited_n"]) > 100
        assert 0.0 < float(row["jerk_ratio"]) <= 0.951
        assert row["direct"] != "True" or row["line_blocked"] == "False"
    assert (folder / "paths.png").stat().st_size > 20_000
    assert ">left_arm</text>" in (folder / "times.svg").read_text(encoding="utf-8")
    trajectory = json.loads((folder / "trajectory_both_arms.json").read_text())
    assert len(trajectory["q_rad"][0]) == 14
    json.dumps(result.data, allow_nan=False)
    assert str(folder) not in (folder / "queries.csv").read_text()


def test_parameters_hold_the_planner_but_not_the_workers():
    a, b = (
        STAGES["plan"].parameters(Config(plan=PlanConfig(planner=PlannerConfig(padding_m=p))))
        for p in (0.005, 0.01)
    )
    assert a != b
    assert STAGES["plan"].parameters(Config(workers=1)) == STAGES["plan"].parameters(
        Config(workers=2),
    )


@pytest.mark.parametrize(
    "scene",
    [
        SceneConfig(physics=PhysicsConfig(finger_kp_n_per_m=4000.0)),
        SceneConfig(more=(ObjectConfig(name="post"),)),
        SceneConfig(object=ObjectConfig(friction=0.4)),
        SceneConfig(task=TaskConfig(lift_height_m=0.1)),
    ],
)
def test_the_world_in_which_held_moves_are_driven_is_part_of_the_fingerprint(scene):
    assert STAGES["plan"].parameters(Config(scene=scene)) != STAGES["plan"].parameters(Config())


@pytest.fixture(scope="module")
def outcomes():
    planner = Planner()
    generator = QueryGenerator(3)
    return [plan_query(planner, generator.query("left_arm", i)) for i in range(2)]


def test_group_checks_can_fail(outcomes):
    config = PlanConfig()
    assert failing(group_checks("left_arm", outcomes, config)) == set()
    failed = dataclasses.replace(outcomes[0], result=None, reason="no_path_in_time", message="none")
    assert failing(group_checks("left_arm", [failed, outcomes[1]], config)) == {
        "left_arm.success_rate",
    }
    quick = [dataclasses.replace(outcomes[0], total_s=0.19) for _ in range(3)]
    assert failing(group_checks("left_arm", quick, config)) == set()
    slowest = dataclasses.replace(outcomes[0], total_s=10.0)
    assert failing(group_checks("left_arm", [*quick, slowest], config)) == {
        "left_arm.replan_max_s",
    }
    assert failed.row()["reason"] == "no_path_in_time"
    assert failed.row().keys() < outcomes[0].row().keys()


@pytest.mark.parametrize(
    ("group", "limit_s"),
    [("left_arm", 0.2), ("right_arm", 0.2), ("both_arms", 2.0)],
)
def test_the_median_planning_time_has_the_generous_limit_of_its_group(outcomes, group, limit_s):
    """A machine ten times slower than the one of docs/results.md still passes."""
    quick = [dataclasses.replace(o, total_s=0.99 * limit_s) for o in outcomes]
    slow = [dataclasses.replace(o, total_s=limit_s) for o in outcomes]
    for profile in ("smoke", "standard", "gpu"):
        config = load_config(profile).config.plan
        assert failing(group_checks(group, quick, config)) == set()
        assert failing(group_checks(group, slow, config)) == {f"{group}.replan_median_s"}
        assert failing(group_checks(group, slow, config, "second_seed.")) == {
            f"second_seed.{group}.replan_median_s",
        }


def test_a_slow_plan_says_how_much_of_a_core_it_had(outcomes):
    starved = [dataclasses.replace(o, total_s=0.2, cpu_s=0.05) for o in outcomes]
    checks = {c.name: c for c in group_checks("left_arm", starved, PlanConfig())}
    assert checks["left_arm.core_share"].observed == pytest.approx(0.25)
    assert "the process had 25% of a core" in checks["left_arm.replan_median_s"].remedy


AUDIT = Audit(samples_n=900, collisions_n=0, disagreements_n=0, clearance_m=0.01)


def common(outcomes, agreement=1.0, repeatable=True, failed_n=0):
    return failing(common_checks(outcomes, agreement, repeatable, failed_n, PlanConfig()))


def test_audit_checks_can_fail(outcomes):
    def names(**change):
        return common([dataclasses.replace(outcomes[0], audit=AUDIT._replace(**change))])

    assert names() == set()
    assert names(collisions_n=1) == {"proof.audit_collisions"}
    assert names(disagreements_n=1) == {"proof.audit_disagreements"}
    assert common([outcomes[0]]) == {"proof.audited_n", "proof.audit_states"}  # nothing was audited
    one = dataclasses.replace(outcomes[0], audit=AUDIT)
    assert common([one, outcomes[1]]) == {"proof.audited_n"}
    failed = dataclasses.replace(outcomes[1], result=None, reason="no_path_in_time", message="none")
    assert common([one, failed]) == set()


def test_a_second_set_that_is_the_first_is_refused():
    with pytest.raises(ConfigError, match=r"seed and plan\.second_seed are both 20261") as caught:
        check_plan(Config(seed=20261, plan=PlanConfig(second_queries_n=1)))
    assert "--set plan.second_seed" in caught.value.remedy
    check_plan(Config(seed=20261, plan=PlanConfig(second_queries_n=0)))
    check_plan(Config(seed=20260, plan=PlanConfig(second_queries_n=1)))
    with pytest.raises(
        UsageError,
        match=r"(?s)no arm .pandaa.; there are panda, ur5.*did you mean .panda.",
    ) as caught:
        check_plan(Config(robot=RobotConfig(arm="pandaa")))  # before the gate
    assert caught.value.exit_code == 2


def test_a_note_names_each_failed_query_and_its_set(outcomes):
    failed = dataclasses.replace(outcomes[1], result=None, reason="no_path_in_time", message="none")
    assert failure_notes("first", {"left_arm": [outcomes[0]]}) == []
    assert failure_notes("second", {"left_arm": [outcomes[0], failed]}) == [
        "left_arm query 1 of the second seed failed: none",
    ]


def test_a_warm_up_that_is_not_solved_does_not_end_the_set():
    """No budget solves nothing; every query then says so itself."""
    config = Config(plan=PlanConfig(planner=PlannerConfig(budget_checks_n=1)))
    outcomes = run_queries(config, 3, 1)
    assert [o.reason for done in outcomes.values() for o in done] == ["no_path_in_time"] * 3


def test_common_checks_can_fail(outcomes):
    audited = [dataclasses.replace(outcomes[0], audit=AUDIT)]
    assert common(audited) == set()
    assert common(audited, agreement=0.99) == {"engines.agreement"}
    assert common(audited, agreement=float("nan")) == {"engines.agreement"}
    assert common(audited, repeatable=False) == {"repeatable"}
    assert common(audited, failed_n=1) == {"closed_chain.carries_rate"}


def test_paths_that_no_engine_can_time_are_named(outcomes, monkeypatch):
    done = {"left_arm": [outcomes[0]]}
    assert len(retime(CONFIG, done).ratios) == 1

    def fails(*_):
        raise TimingError("no time law")

    monkeypatch.setattr("minidual.trials.planning.retiming.duration_ratio", fails)
    retiming = retime(CONFIG, done)
    assert np.isnan(retiming.median)
    assert retiming.failures == ["a path of left_arm could not be timed again: no time law"]


def test_failed_query_keeps_its_reason(outcomes):
    planner = Planner(config=PlannerConfig(budget_checks_n=1))
    failed = plan_query(planner, outcomes[0].query)
    assert not failed.ok
    assert failed.reason == "no_path_in_time"
    assert "in 1 state checks" in failed.message


def test_repeats_tells_the_difference(outcomes):
    assert repeats(PlanConfig(), outcomes[0])
    other = dataclasses.replace(outcomes[0], query=dataclasses.replace(outcomes[0].query, seed=1))
    moved = dataclasses.replace(other, query=outcomes[1].query)
    assert not repeats(PlanConfig(), moved)
    assert not repeats(PlanConfig(), dataclasses.replace(outcomes[0], result=None))


def test_whether_the_line_is_blocked_is_measured(outcomes):
    """Of one query with and without its obstacles.

    The line leads to the posture that the planner reached, not to the drawn one.
    """
    planner = Planner()
    query = outcomes[0].query
    assert query.kind == "past_obstacle"
    assert outcomes[0].line_blocked
    bare = dataclasses.replace(query, scene=PlanningScene(obstacles=query.scene.obstacles[:1]))
    free = plan_query(planner, bare)
    assert not free.line_blocked
    assert free.result.direct
    freed = plan_query(planner, stored_query(20260, "left_arm", _PLANNED_STRAIGHT))
    assert freed.query.as_poses
    assert freed.result.direct
    assert not freed.line_blocked
    drawn = freed.query.q_start + np.linspace(0, 1, 300)[:, None] * (
        freed.query.q_goal - freed.query.q_start
    )
    assert CoalEngine(freed.query.scene).collisions(drawn).any()
    rate, *_ = [
        c
        for c in group_checks("left_arm", [outcomes[0], free], PlanConfig())
        if "line_blocked" in c.name
    ]
    assert rate.observed == 0.5
    assert "1 of 2" in rate.why


def test_the_first_plan_includes_the_scene(outcomes):
    slow = [dataclasses.replace(o, scene_s=1.0, total_s=0.25) for o in outcomes]
    times = {c.name: c.observed for c in group_checks("left_arm", slow, PlanConfig())}
    assert times["left_arm.first_plan_median_s"] == 1.25
    assert times["left_arm.replan_median_s"] == 0.25


def test_each_query_pays_for_its_scene(monkeypatch):
    """The warm-up leaves no scene behind."""
    built = []

    class Counted(SceneEngines):
        def __init__(self, scene, *more):
            built.append(scene)
            super().__init__(scene, *more)

    monkeypatch.setattr("minidual.motion.api.SceneEngines", Counted)
    outcomes = run_queries(Config(), 20260, 1)
    for done in outcomes.values():
        assert built.count(done[0].query.scene) == 2


def test_queries_repeat_and_differ():
    first, again = (QueryGenerator(8).query("both_arms", 3) for _ in range(2))
    assert first.scene == again.scene
    assert np.array_equal(first.q_goal, again.q_goal)
    assert first.seed == again.seed
    assert not np.array_equal(first.q_goal, QueryGenerator(9).query("both_arms", 3).q_goal)
    assert first.as_poses
    assert not QueryGenerator(8).query("both_arms", 1).as_poses


@pytest.mark.parametrize("group", GROUPS)
def test_queries_are_what_they_say(group):
    generator = QueryGenerator(11, obstacles_n=4, blocked_fraction=1.0)
    for index in range(3):
        query = generator.query(group, index)
        engines = Planner(query.scene).engines()
        assert not engines.closest(query.q_start, 0.0099)
        assert not engines.closest(query.q_goal, 0.0099)
        line = query.q_start + np.linspace(0, 1, 200)[:, None] * (query.q_goal - query.q_start)
        assert query.kind == generator.kind(group, index)
        assert (
            engines.engine("coal").collisions(line).any()
        )  # the second engine sees the block, too
        assert len(query.scene.obstacles) == 5
        hands = dict(zip(("left", "right"), Kinematics().tcp_poses(query.q_goal), strict=True))
        for arm, T in query.targets.items():
            assert np.abs(hands[arm] - T).max() < 1e-9
        held = np.ones(14, dtype=bool)
        held[GROUPS[group]] = False
        assert np.array_equal(query.q_goal[held], query.q_start[held])


@pytest.mark.parametrize("group", GROUPS)
def test_queries_are_hard_as_their_kind_says(group):
    """Without what makes the query hard, the line is freer.

    Coal is asked, which the generator does not use.
    """
    generator = QueryGenerator(12)
    for index in range(2):
        query = generator.query(group, index)
        line = query.q_start + np.linspace(0, 1, 200)[:, None] * (query.q_goal - query.q_start)
        hands = [Kinematics().tcp_poses(q) for q in (query.q_start, query.q_goal)]
        sides = [left[1, 3] - right[1, 3] for left, right in hands]
        engine = MujocoEngine(query.scene)
        touched = set().union(*(engine.touching_pairs(q) for q in line))
        owners = {frozenset(n.split("_")[0] for n in pair) for pair in touched}
        if query.kind == "crossing":
            assert sides[0] * sides[1] < 0.0
            assert CoalEngine(query.scene).collisions(line).any()
        elif query.kind == "past_arm":
            assert frozenset(("left", "right")) in owners
        else:
            bare = PlanningScene(obstacles=query.scene.obstacles[:1])  # only the table
            assert (
                CoalEngine(query.scene).collisions(line).sum()
                > CoalEngine(bare).collisions(line).sum()
            )


def test_stored_queries_are_those_of_the_generator():
    known = stored_set(20260)
    generator = QueryGenerator(20260)
    for group, index in (("left_arm", 3), ("both_arms", 1)):
        query = stored_query(20260, group, index)
        again = generator.attempt(group, index, known[group][0][index])
        assert query.scene == again.scene
        assert (query.seed, query.kind, query.as_poses) == (again.seed, again.kind, again.as_poses)
        assert np.abs(query.q_start - again.q_start).max() < 1e-6
        assert np.abs(query.q_goal - again.q_goal).max() < 1e-6
        for arm, T in query.targets.items():
            assert np.abs(T - again.targets[arm]).max() < 1e-6


@pytest.mark.parametrize("seed", [20260, 20261])
def test_stored_witnesses_prove_their_queries_feasible(seed):
    """Every 0.002 rad along the witness both engines see no contact.

    A spoiled witness does not pass.
    """
    known = stored_set(seed)
    assert all(len(known[group][0]) == 100 for group in GROUPS)
    for group, index in (("left_arm", 1), ("right_arm", 50), ("both_arms", 99)):
        query = stored_query(seed, group, index)
        path = witness(seed, group, index)
        engines = Planner(query.scene).engines()
        assert np.array_equal(path[[0, -1]], [query.q_start, query.q_goal])
        assert np.abs(np.diff(polyline_states(path), axis=0)).max() <= 0.002 + 1e-12
        assert is_free(path, engines)
        assert not is_free(path[[0, -1]], engines)


def test_a_seed_without_a_set_and_a_damaged_set(monkeypatch, tmp_path):
    assert stored_set(4711) is None
    (tmp_path / "query_sets").mkdir()
    (tmp_path / "query_sets" / "seed-4712.npz").write_bytes(b"not a set")
    monkeypatch.setattr(queries, "files", lambda _package: tmp_path)
    with pytest.raises(DataError, match="seed 4712 cannot be read"):
        stored_set(4712)


def test_the_stored_set_is_used_where_it_fits():
    known = stored_query(20260, "left_arm", 0)
    assert np.array_equal(query_source(20260, 5, 1.0)("left_arm", 0).q_goal, known.q_goal)
    assert len(query_source(20260, 3, 1.0)("left_arm", 0).scene.obstacles) == 4
    assert query_source(20260, 5, 1.0)("both_arms", 100).index == 100  # beyond the set: generated


def test_a_query_that_cannot_be_made_is_an_error(monkeypatch):
    monkeypatch.setattr(queries, "_SCENE_TRIES_N", 1)
    monkeypatch.setattr(queries, "_POSE_TRIES_N", 1)
    monkeypatch.setattr(queries, "random_pose", lambda _rng, _arm: pose(np.eye(3), (3.0, 0.0, 0.0)))
    with pytest.raises(
        PlanningError,
        match="no query 0 for both_arms with 5 obstacles after 1 scenes",
    ):
        QueryGenerator(1).query("both_arms", 0)


def test_agreement_of_the_engines():
    assert engine_agreement(PlanningScene(), 400, 1) >= 0.995
