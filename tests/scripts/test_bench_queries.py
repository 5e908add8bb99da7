"""The hard queries: no draw is left out, postures are what they say, what is called infeasible is."""

from __future__ import annotations

import itertools
from functools import cache

import numpy as np
import pytest

from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Box, Shape
from minidual.config.root import Config
from minidual.config.seeds import stream
from minidual.motion.ik import solvers
from minidual.plant.world import World
from minidual.robot.pair import DUAL_PANDA, SIDES
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import pose_of
from scripts.bench import hard
from scripts.bench.infeasible import RigidHands, out_of_reach
from scripts.bench.peers import Run
from scripts.bench.queries import PosedQuery, draw, first_grasps, posed
from scripts.bench.query_sets import SETS
from tests.support.bench_samples import planner
from tests.support.panda import DOF, HOME, Q_LOWER, Q_UPPER

SEED = 20260
DRAWS_N = 6
TASKS = [name for name, query_set in SETS.items() if query_set.task]


@cache
def queries_of(name: str) -> tuple[PosedQuery, ...]:
    """Return the first draws of a set, with their postures."""
    return tuple(posed(draw(SETS[name], SEED, index), planner()) for index in range(DRAWS_N))


def all_queries() -> list[PosedQuery]:
    return [query for name in SETS for query in queries_of(name)]


class TestDraws:
    @pytest.mark.parametrize("name", SETS)
    def test_a_query_follows_from_seed_and_index_alone(self, name: str) -> None:
        first = draw(SETS[name], SEED, 5)
        other_index = draw(SETS[name], SEED, 3)
        again = draw(SETS[name], SEED, 5)
        other_seed = draw(SETS[name], SEED + 1, 5)
        assert again.scene == first.scene
        assert again.seed == first.seed
        for end, arm in itertools.product(("start", "goal"), SIDES):
            T = getattr(again, end)[arm]
            assert T.tobytes() == getattr(first, end)[arm].tobytes()
            assert not np.allclose(T, getattr(other_index, end)[arm])
            assert not np.allclose(T, getattr(other_seed, end)[arm])

    def test_no_draw_is_left_out(self) -> None:
        """Oracle: a query's own stream begins with its left hand, without a loop that could skip."""
        crossing = SETS["crossing"]
        for index in range(50):
            rng = stream(SEED, "bench/crossing", index)
            rng.integers(len(crossing.start))
            position = rng.uniform(crossing.start[0].low_m, crossing.start[0].high_m)
            drawn = draw(crossing, SEED, index)
            assert drawn.start["left"][:3, 3] == pytest.approx(position)

    def test_every_draw_is_counted_once(self) -> None:
        kinds_found: set[str] = set()
        for name in SETS:
            queries = queries_of(name)
            plannable = [query for query in queries if query.plannable]
            gave_up = [Run(None, 1.0, "gave up")] * len(plannable)
            counts = hard.counted(queries)
            unsolved = hard.judged(plannable, gave_up, planner())
            assert unsolved["solved"] == 0
            assert unsolved["early"] == unsolved["timed_out"]
            assert unsolved["low_pct"] == 0.0
            assert counts["drawn"] == len(queries) == DRAWS_N
            assert counts["infeasible"] + counts["no_posture"] + unsolved["timed_out"] == DRAWS_N
            kinds_found |= {kind for kind in ("infeasible", "no_posture") if counts[kind]}
        assert kinds_found == {"infeasible", "no_posture"}

    def test_postures_are_at_their_poses_and_free(self) -> None:
        for query in all_queries():
            if not query.plannable:
                continue
            engine = planner().engines(query.drawn.scene).engine("mujoco")
            ends = ((query.q_start, query.drawn.start), (query.q_goal, query.drawn.goal))
            for q, targets in ends:
                for T, arm in zip(planner().kinematics.tcp_poses(q), SIDES, strict=True):
                    assert np.abs(T - targets[arm]).max() < 1e-5
                assert not engine.collisions(q[None])[0]

    def test_the_rod_is_held_in_every_draw_of_the_gate(self) -> None:
        drawn = draw(SETS["gate"], SEED, 0)
        assert [held.name for held in drawn.scene.attached] == ["rod"]
        for end in (drawn.start, drawn.goal):
            between_hands = end["left"][:3, 3] - end["right"][:3, 3]
            assert np.linalg.norm(between_hands) == pytest.approx(0.24)

    def test_clutter_has_twenty_boxes_half_of_them_on_the_table(self) -> None:
        obstacles = draw(SETS["clutter"], SEED, 4).scene.obstacles
        boxes = [shape for shape in obstacles if shape.name != "table"]
        standing = [box for box in boxes if box.position_m[2] == pytest.approx(0.5 * box.size_m[2])]
        assert len(boxes) == 20
        assert len(standing) >= 10

    @pytest.mark.parametrize("name", TASKS)
    def test_the_objects_of_a_task_stand_where_its_trial_puts_them(self, name: str) -> None:
        """Oracle: the task's own world, in MuJoCo."""
        task = make_task(Config(task=name))
        for index in range(3):
            world = World(task.scene)
            world.reset(poses=task.trial(SEED, f"bench/{name}", index).start)
            shapes_by_object: dict[str, list[Shape]] = {}
            for shape in draw(SETS[name], SEED, index).scene.obstacles:
                owner, _, _ = shape.name.rpartition(" ")
                shapes_by_object.setdefault(owner, []).append(shape)
            for body, item in task.objects.items():
                shapes = shapes_by_object[body]
                position = world.object_pose(body)[:3, 3]
                assert shapes[0].position_m == pytest.approx(position, abs=1e-9)
                assert len(shapes) == len(item.body.solids)

    def test_hands_go_over_the_grasps_of_a_task(self) -> None:
        task = make_task(Config(task="pot_lift"))
        drawn = draw(SETS["pot_lift"], SEED, 1)
        trial = task.trial(SEED, "bench/pot_lift", 1)
        pot = task.objects[task.carried]
        for arm in SIDES:
            T_world_grasp = pose_of(pot.body, trial.start[task.carried]) @ pot.grasps[arm]
            over = drawn.goal[arm]
            assert over[:3, :3] == pytest.approx(T_world_grasp[:3, :3])
            assert over[:3, 3] - T_world_grasp[:3, 3] == pytest.approx([0.0, 0.0, 0.08])

    def test_only_hands_that_take_something_off_the_table_go_over_a_grasp(self) -> None:
        (giver,) = hands_over_grasps("handover", 0)
        assert giver in SIDES, "the taker's grasp is not on the table"
        assert set(hands_over_grasps("insertion", 0)) == set(SIDES)


def hands_over_grasps(name: str, index: int) -> list[str]:
    task = make_task(Config(task=name))
    trial = task.trial(SEED, f"bench/{name}", index)
    poses = {key: pose_of(item.body, trial.start[key]) for key, item in task.objects.items()}
    return list(first_grasps(task, trial, poses, np.random.default_rng(0)))


class TestInfeasible:
    def test_every_posture_at_an_infeasible_pose_touches(self) -> None:
        """Oracle: MuJoCo, at postures that inverse kinematics finds without asking what they touch."""
        postures_n = 0
        for query in all_queries():
            if "inside" not in query.infeasible:
                continue
            at_start = query.infeasible.startswith("at the start")
            targets = query.drawn.start if at_start else query.drawn.goal
            engine = planner().engines(query.drawn.scene).engine("mujoco")
            rng = np.random.default_rng(query.drawn.index)
            for _ in range(20):
                q = np.array(HOME)
                reached = True
                for arm, T_world_tcp in targets.items():
                    solver = solvers(DUAL_PANDA)[arm]
                    solution = solver.solve(T_world_tcp, rng.uniform(Q_LOWER[:7], Q_UPPER[:7]))
                    q[solver.joints] = solution.q
                    reached &= solution.reached
                if reached:
                    postures_n += 1
                    assert engine.collisions(q[None])[0], query.infeasible
        assert postures_n > 20

    @pytest.mark.parametrize("name", ["clutter", "crossing"])
    def test_hands_of_a_free_posture_are_never_called_infeasible(self, name: str) -> None:
        """Negative control: where MuJoCo sees a free posture, its poses are feasible."""
        scene = draw(SETS[name], SEED, 1).scene
        engine = planner().engines(scene).engine("mujoco")
        hands = RigidHands(scene)
        Q = np.random.default_rng(0).uniform(Q_LOWER, Q_UPPER, (400, DOF))
        free = Q[~engine.collisions(Q)]
        assert len(free) > 20
        for q in free[:60]:
            targets = dict(zip(SIDES, planner().kinematics.tcp_poses(q), strict=True))
            assert hands.inside(targets) == ""
            assert out_of_reach(targets, planner().kinematics) == ""

    def test_no_posture_reaches_beyond_the_bound(self) -> None:
        T_home = planner().kinematics.tcp_poses(np.array(HOME))[0]
        moved = T_home.copy()
        for shift_m, beyond in ((0.0, False), (0.3, False), (0.9, True)):
            moved[0, 3] = T_home[0, 3] + shift_m
            assert bool(out_of_reach({"left": moved}, planner().kinematics)) == beyond
        moved[0, 3] = T_home[0, 3] + 0.48  # nearly at the bound
        assert out_of_reach({"left": moved}, planner().kinematics) == ""
        starts = np.random.default_rng(1).uniform(Q_LOWER[:7], Q_UPPER[:7], (20, 7))
        solver = solvers(DUAL_PANDA)["left"]
        assert not any(solver.solve(moved, start).reached for start in starts)

    def test_a_hand_in_a_wall_is_named(self) -> None:
        targets = dict(zip(SIDES, planner().kinematics.tcp_poses(HOME), strict=True))
        position = tuple(targets["left"][:3, 3])
        walled = PlanningScene().with_obstacles(Box("wall", position, size_m=(0.1, 0.1, 0.05)))
        reason = RigidHands(walled).inside(targets)
        assert "left_panda" in reason
        assert "wall" in reason
        assert RigidHands(PlanningScene()).inside(targets) == ""
