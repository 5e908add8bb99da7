"""The hard planning queries: nothing is left out, what is called infeasible is, what touches is counted as touching."""

from __future__ import annotations

import itertools
import json
import sys

import numpy as np
import pytest

from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Box
from minidual.config.root import Config
from minidual.config.seeds import stream
from minidual.errors import EnvironmentMissingError
from minidual.motion.api import Planner
from minidual.motion.blend import blended_path
from minidual.motion.ik import solvers
from minidual.motion.search import EdgeChecker
from minidual.motion.timing import time_path
from minidual.plant.world import World
from minidual.registry import Registry
from minidual.robot.pair import DUAL_PANDA, SIDES
from minidual.robot.trajectory import Trajectory
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import pose_of
from scripts.bench import __main__ as bench
from scripts.bench import hard, peers
from scripts.bench.peers import Roboplan, Run
from scripts.bench.queries import (
    GROUP,
    SETS,
    DrawnQuery,
    PosedQuery,
    RigidHands,
    draw,
    first_grasps,
    out_of_reach,
    posed,
)
from scripts.bench.tables import BenchInputs, BenchTable
from tests.support.panda import DOF, HOME, Q_LOWER, Q_UPPER

SEED = 20260


@pytest.fixture(scope="module")
def planner() -> Planner:
    return Planner()


@pytest.fixture(scope="module")
def queries(planner) -> dict[str, list[PosedQuery]]:
    return {
        name: [posed(draw(of, SEED, index), planner) for index in range(12)]
        for name, of in SETS.items()
    }


def straight(q_start, q_goal, planner) -> Trajectory:
    """Return the timed straight line between two postures, whatever stands there."""
    ends = np.array([q_start, q_goal])
    checker = EdgeChecker(planner.engines(PlanningScene(obstacles=())), 0.0, ends, 0.1)
    return time_path(
        blended_path(ends, checker, 0.1, 0.1),
        GROUP,
        planner.config,
        planner.kinematics,
    )[0]


class TestDraws:
    @pytest.mark.parametrize("name", SETS)
    def test_a_query_follows_from_seed_and_index_alone(self, name) -> None:
        of = SETS[name]
        first = [draw(of, SEED, index) for index in (5, 3)]
        again = draw(of, SEED, 5)
        other = draw(of, SEED + 1, 5)
        assert again.scene == first[0].scene
        assert again.seed == first[0].seed
        for end in ("start", "goal"):
            for arm in SIDES:
                T = getattr(again, end)[arm]
                assert T.tobytes() == getattr(first[0], end)[arm].tobytes()
                assert not np.allclose(T, getattr(first[1], end)[arm])
                assert not np.allclose(T, getattr(other, end)[arm])

    def test_no_draw_is_left_out(self) -> None:
        """Oracle: the first numbers of each query's own stream are its left hand, without a loop that could skip some."""
        of = SETS["crossing"]
        for index in range(50):
            rng = stream(SEED, "bench/crossing", index)
            rng.integers(len(of.start))
            assert draw(of, SEED, index).start["left"][:3, 3] == pytest.approx(
                rng.uniform(of.start[0].low_m, of.start[0].high_m),
            )

    def test_every_draw_is_counted_once(self, queries, planner) -> None:
        kinds = set()
        for of_set in queries.values():
            counts = hard.counted(of_set)
            plannable = [query for query in of_set if query.plannable]
            nothing = hard.judged(plannable, [Run(None, 1.0, "gave up")] * len(plannable), planner)
            assert nothing["solved"] == 0
            assert nothing["early"] == nothing["timed_out"]
            assert nothing["low_pct"] == 0.0
            assert counts["drawn"] == len(of_set) == 12
            assert counts["infeasible"] + counts["no_posture"] + nothing["timed_out"] == 12
            kinds |= {kind for kind in ("infeasible", "no_posture") if counts[kind]}
        assert kinds == {"infeasible", "no_posture"}

    def test_postures_are_at_their_poses_and_free(self, queries, planner) -> None:
        for query in itertools.chain.from_iterable(queries.values()):
            if not query.plannable:
                continue
            engine = planner.engines(query.drawn.scene).engine("mujoco")
            for q, asked in ((query.q_start, query.drawn.start), (query.q_goal, query.drawn.goal)):
                for T, arm in zip(planner.kinematics.tcp_poses(q), SIDES, strict=True):
                    assert np.abs(T - asked[arm]).max() < 1e-5
                assert not engine.collisions(q[None])[0]

    def test_the_rod_is_held_in_every_draw_of_the_gate(self) -> None:
        drawn = draw(SETS["gate"], SEED, 0)
        assert [held.name for held in drawn.scene.attached] == ["rod"]
        spans = [
            np.linalg.norm(end["left"][:3, 3] - end["right"][:3, 3])
            for end in (drawn.start, drawn.goal)
        ]
        assert spans == pytest.approx([0.24, 0.24])

    def test_twenty_boxes(self) -> None:
        boxes = [
            shape
            for shape in draw(SETS["clutter"], SEED, 4).scene.obstacles
            if shape.name != "table"
        ]
        assert len(boxes) == 20
        assert sum(box.position_m[2] == pytest.approx(0.5 * box.size_m[2]) for box in boxes) >= 10

    @pytest.mark.parametrize("name", [name for name, of in SETS.items() if of.task])
    def test_the_objects_of_a_task_stand_where_its_trial_puts_them(self, name) -> None:
        """Oracle: the task's own world, in MuJoCo."""
        task = make_task(Config(task=name))
        for index in range(3):
            drawn = draw(SETS[name], SEED, index)
            trial = task.trial(SEED, f"bench/{name}", index)
            world = World(task.scene)
            world.reset(poses=trial.start)
            seen = {}
            for shape in drawn.scene.obstacles:
                seen.setdefault(shape.name.rpartition(" ")[0], []).append(shape)
            for body in task.objects:
                assert seen[body][0].position_m == pytest.approx(
                    world.object_pose(body)[:3, 3],
                    abs=1e-9,
                )
                assert len(seen[body]) == len(task.objects[body].body.solids)

    def test_hands_go_over_the_grasps_of_a_task(self) -> None:
        task = make_task(Config(task="pot_lift"))
        drawn = draw(SETS["pot_lift"], SEED, 1)
        trial = task.trial(SEED, "bench/pot_lift", 1)
        pot = task.objects[task.carried]
        for arm in SIDES:
            grasp = pose_of(pot.body, trial.start[task.carried]) @ pot.grasps[arm]
            assert drawn.goal[arm][:3, :3] == pytest.approx(grasp[:3, :3])
            assert drawn.goal[arm][:3, 3] - grasp[:3, 3] == pytest.approx([0.0, 0.0, 0.08])
        (giver,) = first_hands("handover", 0)
        assert giver in SIDES, "the taker's grasp is not on the table"
        assert set(first_hands("insertion", 0)) == set(SIDES)


def first_hands(name, index) -> list[str]:
    task = make_task(Config(task=name))
    trial = task.trial(SEED, f"bench/{name}", index)
    objects = {key: pose_of(item.body, trial.start[key]) for key, item in task.objects.items()}
    return list(first_grasps(task, trial, objects, np.random.default_rng(0)))


class TestInfeasible:
    def test_every_posture_at_an_infeasible_pose_touches(self, queries, planner) -> None:
        """Oracle: MuJoCo, at postures that inverse kinematics finds without asking what they touch."""
        asked_n = 0
        for query in itertools.chain.from_iterable(queries.values()):
            if "inside" not in query.infeasible:
                continue
            targets = (
                query.drawn.start
                if query.infeasible.startswith("at the start")
                else query.drawn.goal
            )
            engine = planner.engines(query.drawn.scene).engine("mujoco")
            rng = np.random.default_rng(query.drawn.index)
            for _ in range(20):
                q = np.array(HOME)
                solutions = [
                    solvers(DUAL_PANDA)[arm].solve(T, rng.uniform(Q_LOWER[:7], Q_UPPER[:7]))
                    for arm, T in targets.items()
                ]
                for arm, solution in zip(SIDES, solutions, strict=True):
                    q[solvers(DUAL_PANDA)[arm].joints] = solution.q
                if all(solution.reached for solution in solutions):
                    asked_n += 1
                    assert engine.collisions(q[None])[0], query.infeasible
        assert asked_n > 20

    @pytest.mark.parametrize("name", ["clutter", "crossing"])
    def test_hands_of_a_free_posture_are_never_called_infeasible(self, name, planner) -> None:
        """Negative control: where MuJoCo sees a free posture, its poses are feasible."""
        scene = draw(SETS[name], SEED, 1).scene
        engine = planner.engines(scene).engine("mujoco")
        hands = RigidHands(scene)
        Q = np.random.default_rng(0).uniform(Q_LOWER, Q_UPPER, (400, DOF))
        free = Q[~engine.collisions(Q)]
        assert len(free) > 20
        for q in free:
            targets = dict(zip(SIDES, planner.kinematics.tcp_poses(q), strict=True))
            assert hands.inside(targets) == ""
            assert out_of_reach(targets, planner.kinematics) == ""

    def test_no_posture_reaches_beyond_the_bound(self, planner) -> None:
        q = np.array(HOME)
        T = planner.kinematics.tcp_poses(q)[0]
        for way_m, beyond in ((0.0, False), (0.3, False), (0.9, True)):
            moved = T.copy()
            moved[0, 3] += way_m
            assert bool(out_of_reach({"left": moved}, planner.kinematics)) == beyond
        moved[0, 3] = T[0, 3] + 0.48  # nearly at the bound
        assert out_of_reach({"left": moved}, planner.kinematics) == ""
        assert not any(
            solvers(DUAL_PANDA)["left"].solve(moved, start).reached
            for start in np.random.default_rng(1).uniform(Q_LOWER[:7], Q_UPPER[:7], (20, 7))
        )

    def test_a_hand_in_a_wall_is_named(self, planner) -> None:
        targets = dict(zip(SIDES, planner.kinematics.tcp_poses(HOME), strict=True))
        x, y, z = targets["left"][:3, 3]
        walled = PlanningScene().with_obstacles(Box("wall", (x, y, z), size_m=(0.1, 0.1, 0.05)))
        assert "left_panda" in RigidHands(walled).inside(targets)
        assert "wall" in RigidHands(walled).inside(targets)
        assert RigidHands(PlanningScene()).inside(targets) == ""


@pytest.fixture(scope="module")
def blocked(planner) -> PosedQuery:
    """A query whose straight line runs through a box: the left arm turns past it."""
    start = HOME.copy()
    goal = HOME.copy()
    start[0] = 0.8
    goal[0] = -0.8
    box = Box("post", (0.34, 0.25, 0.4), size_m=(0.06, 0.06, 0.8))
    ends = [dict(zip(SIDES, planner.kinematics.tcp_poses(q), strict=True)) for q in (start, goal)]
    drawn = DrawnQuery(SETS["crossing"], 0, 1, PlanningScene().with_obstacles(box), *ends)
    return PosedQuery(drawn, "", start, goal)


class TestLook:
    def test_a_path_through_a_box_is_colliding(self, blocked, planner) -> None:
        run = Run(straight(blocked.q_start, blocked.q_goal, planner), 0.01)
        numbers = hard.judged([blocked], [run], planner)
        assert (numbers["solved"], numbers["colliding"], numbers["over_jerk"]) == (1, 1, 0)
        assert numbers["low_pct"] == 0.0
        assert numbers["high_pct"] < 100.0

    def test_the_proven_path_is_not(self, blocked, planner) -> None:
        runs = hard.plan_minidual([blocked], planner, 10.0)
        numbers = hard.judged([blocked], runs, planner)
        assert (numbers["solved"], numbers["colliding"], numbers["over_jerk"]) == (1, 0, 0)
        assert numbers["high_pct"] == 100.0

    def test_what_takes_too_long_is_timed_out_and_not_early(self, blocked, planner) -> None:
        path = straight(blocked.q_start, blocked.q_goal, planner)
        for run in (Run(path, 1.1 * hard.BUDGET_S), Run(None, hard.BUDGET_S, "no path in time")):
            numbers = hard.judged([blocked], [run], planner)
            assert (numbers["solved"], numbers["timed_out"], numbers["early"]) == (0, 1, 0)

    def test_a_path_to_another_place_is_not_solved(self, blocked, planner) -> None:
        run = Run(straight(blocked.q_start, blocked.q_goal + 0.01, planner), 0.01)
        assert hard.judged([blocked], [run], planner)["solved"] == 0

    def test_a_jump_of_acceleration_is_over_the_jerk_limit(self, planner) -> None:
        smooth = straight(HOME, HOME + 0.2, planner)
        assert 0.0 < hard.jerk_ratio(smooth, planner.robot) <= 1.0
        shaken = smooth.a.copy()
        shaken[0] = 0.8 * planner.robot.a_max  # from rest in one sample
        jumps = Trajectory(smooth.times, smooth.q, smooth.v, shaken, GROUP)
        assert hard.jerk_ratio(jumps, planner.robot) > 1.0

    def test_hands_that_leave_the_rod_show(self, queries, planner) -> None:
        query = next(query for query in queries["gate"] if query.plannable)
        swung = query.q_start.copy()
        swung[0] += 0.01
        leaves = straight(query.q_start, swung, planner)
        assert hard.look(query.drawn, leaves, planner).off_grasp
        stays = straight(query.q_start, query.q_start + 1e-7, planner)
        assert not hard.look(query.drawn, stays, planner).off_grasp


def test_a_rod_held_with_a_joint_on_its_limit_is_carried(queries, planner) -> None:
    query = queries["gate"][1]
    assert np.minimum(query.q_start - Q_LOWER, Q_UPPER - query.q_start).min() < 1e-9
    numbers = hard.judged([query], hard.plan_minidual([query], planner, 30.0), planner)
    assert [numbers[what] for what in ("solved", "colliding", "over_jerk", "off_grasp")] == [
        1,
        0,
        0,
        0,
    ]


def test_hands_whose_first_postures_collide_are_planned_to_their_poses(planner) -> None:
    query = posed(draw(SETS["crossing"], 20261, 19), planner)
    numbers = hard.judged([query], hard.plan_to_poses([query], planner, 30.0), planner)
    assert [numbers[what] for what in ("solved", "colliding", "over_jerk")] == [1, 0, 0]


class TestPeers:
    def test_ompl_solves_what_is_easy_and_says_what_it_takes(self, planner) -> None:
        ends = [
            dict(zip(SIDES, planner.kinematics.tcp_poses(q), strict=True))
            for q in (HOME, HOME + 0.1)
        ]
        query = PosedQuery(
            DrawnQuery(SETS["crossing"], 0, 1, PlanningScene(), *ends),
            "",
            HOME,
            HOME + 0.1,
        )
        (run,) = peers.plan_ompl([query], planner, 20.0)
        numbers = hard.judged([query], [run], planner)
        assert (numbers["solved"], numbers["colliding"]) == (1, 0)
        assert numbers["median_ms"] > 0.0

    @pytest.mark.parametrize("python", ["nowhere/bin/python", sys.executable])
    def test_without_roboplan_it_is_said_what_to_type(self, python, tmp_path) -> None:
        with pytest.raises(EnvironmentMissingError, match="roboplan is not installed") as caught:
            Roboplan(tmp_path / python)
        assert f"pip install roboplan=={peers.ROBOPLAN}" in caught.value.remedy

    def test_the_table_without_roboplan_says_so(self, monkeypatch, tmp_path) -> None:
        monkeypatch.setattr(hard, "SETS", {"crossing": SETS["crossing"]})
        monkeypatch.setattr(
            hard,
            "plan_ompl",
            lambda queries, planner, budget_s: [Run(None, 0.0, "no")] * len(queries),
        )
        said: list[str] = []
        table = hard.measure(BenchInputs(Config(), SEED, 1, said.append, True, tmp_path / "python"))
        assert "WITHOUT roboplan" in table.title
        assert any("pip install roboplan" in note for note in table.notes)
        assert any("pip install roboplan" in what for what in said)
        assert [row.name for row in table.rows] == [
            "crossing",
            "crossing: minidual",
            "crossing: minidual, to hand poses",
            "crossing: OMPL, MuJoCo, toppra",
        ]
        assert "WITHOUT" not in hard.measure(BenchInputs(Config(), SEED, 1)).title

    def answering(self, folder, contacts, **answer):
        """Return the Python of an environment whose roboplan gives this answer."""
        script = folder / "python"
        line = json.dumps({"contacts": contacts, "cpu_s": 0.5, "reason": "", **answer})
        script.write_text(
            f"#!/bin/sh\n[ \"$1\" = -c ] && exit 0\ncat > /dev/null\ncat <<'END'\n{line}\nEND\n",
        )
        script.chmod(0o755)
        return Roboplan(script)

    def test_a_colliding_path_of_a_peer_is_counted(self, blocked, planner, tmp_path) -> None:
        states = np.array(peers._query(blocked, planner.kinematics)["states"])
        contacts = planner.engines(blocked.drawn.scene).engine("mujoco").collisions(states).tolist()
        assert 0 < sum(contacts) < len(contacts)
        motion = straight(blocked.q_start, blocked.q_goal, planner)
        samples = {"times": motion.times, "q": motion.q, "v": motion.v, "a": motion.a}
        answer = {name: value.tolist() for name, value in samples.items()}
        runs = self.answering(tmp_path, contacts, **answer).plan([blocked], planner, 1.0)
        numbers = hard.judged([blocked], runs, planner)
        assert (numbers["solved"], numbers["colliding"], numbers["median_ms"]) == (1, 1, 500.0)

        contacts[:2] = [not touches for touches in contacts[:2]]
        self.answering(tmp_path, contacts, **answer).plan([blocked], planner, 1.0)
        contacts[2] = not contacts[2]
        with pytest.raises(RuntimeError, match="other contacts"):
            self.answering(tmp_path, contacts, **answer).plan([blocked], planner, 1.0)

    def test_a_peer_that_finds_nothing_is_not_solved(self, blocked, planner, tmp_path) -> None:
        states = np.array(peers._query(blocked, planner.kinematics)["states"])
        contacts = planner.engines(blocked.drawn.scene).engine("mujoco").collisions(states).tolist()
        (run,) = self.answering(tmp_path, contacts, reason="no path").plan([blocked], planner, 1.0)
        assert (run.trajectory, run.reason) == (None, "no path")


class TestCommand:
    @pytest.mark.parametrize(
        ("words", "measured"),
        [((), {"toy"}), (("--peers",), {"hard"}), (("hard",), {"hard"}), (("toy",), {"toy"})],
    )
    def test_hard_queries_are_measured_where_they_are_asked_for(
        self,
        words,
        measured,
        monkeypatch,
    ) -> None:
        seen = {}

        def toy(name):
            def measure(inputs):
                seen[name] = inputs.peers
                return BenchTable("title", (), ())

            return measure

        monkeypatch.setattr(
            bench,
            "BENCHES",
            Registry("bench", {name: toy(name) for name in ("toy", "hard")}),
        )
        assert bench.main(list(words)) == 0
        assert set(seen) == measured
        assert all(peers_too == ("--peers" in words) for peers_too in seen.values())
