"""What the bench says of paths on hard queries, and how other planners are asked."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.collision.scene import PlanningScene
from minidual.config.root import Config
from minidual.errors import EnvironmentMissingError
from minidual.robot.trajectory import Trajectory
from scripts.bench import hard
from scripts.bench.peer_ompl import plan_ompl
from scripts.bench.peer_roboplan import ROBOPLAN, Roboplan, query_record
from scripts.bench.peers import PeerQuery, Run
from scripts.bench.queries import GROUP, PosedQuery, draw, posed
from scripts.bench.query_sets import SETS
from scripts.bench.tables import BenchInputs
from tests.support.bench_samples import blocked_query, planner, posed_query, straight
from tests.support.panda import HOME, Q_LOWER, Q_UPPER

SEED = 20260


@pytest.fixture(scope="module")
def blocked() -> PosedQuery:
    return blocked_query()


@pytest.fixture(scope="module")
def rod_query() -> PosedQuery:
    """A draw of the gate whose start has a joint on its limit."""
    return posed(draw(SETS["gate"], SEED, 1), planner())


class TestJudged:
    def test_a_path_through_a_box_is_colliding(self, blocked: PosedQuery) -> None:
        run = Run(straight(blocked.q_start, blocked.q_goal), 0.01)
        numbers = hard.judged([blocked], [run], planner())
        assert (numbers["solved"], numbers["colliding"], numbers["over_jerk"]) == (1, 1, 0)
        assert numbers["low_pct"] == 0.0
        assert numbers["high_pct"] < 100.0

    def test_the_proven_path_is_not(self, blocked: PosedQuery) -> None:
        runs = hard.plan_minidual([blocked], planner(), 10.0)
        numbers = hard.judged([blocked], runs, planner())
        assert (numbers["solved"], numbers["colliding"], numbers["over_jerk"]) == (1, 0, 0)
        assert numbers["high_pct"] == 100.0

    def test_what_takes_too_long_is_timed_out_and_not_early(self, blocked: PosedQuery) -> None:
        path = straight(blocked.q_start, blocked.q_goal)
        for run in (Run(path, 1.1 * hard.BUDGET_S), Run(None, hard.BUDGET_S, "no path in time")):
            numbers = hard.judged([blocked], [run], planner())
            assert (numbers["solved"], numbers["timed_out"], numbers["early"]) == (0, 1, 0)

    def test_a_path_to_another_place_is_not_solved(self, blocked: PosedQuery) -> None:
        run = Run(straight(blocked.q_start, blocked.q_goal + 0.01), 0.01)
        assert hard.judged([blocked], [run], planner())["solved"] == 0

    def test_a_jump_of_acceleration_is_over_the_jerk_limit(self) -> None:
        smooth = straight(HOME, HOME + 0.2)
        assert 0.0 < hard.jerk_ratio(smooth, planner().robot) <= 1.0
        a = smooth.a.copy()
        a[0] = 0.8 * planner().robot.a_max  # from rest in one sample
        jump = Trajectory(smooth.times, smooth.q, smooth.v, a, GROUP)
        assert hard.jerk_ratio(jump, planner().robot) > 1.0

    def test_hands_that_leave_the_rod_show(self, rod_query: PosedQuery) -> None:
        turned = rod_query.q_start.copy()
        turned[0] += 0.01
        leaves = straight(rod_query.q_start, turned)
        assert hard.look(rod_query.drawn, leaves, planner()).off_grasp
        stays = straight(rod_query.q_start, rod_query.q_start + 1e-7)
        assert not hard.look(rod_query.drawn, stays, planner()).off_grasp


def test_a_rod_held_with_a_joint_on_its_limit_is_carried(rod_query: PosedQuery) -> None:
    to_limits = np.minimum(rod_query.q_start - Q_LOWER, Q_UPPER - rod_query.q_start)
    assert to_limits.min() < 1e-9
    runs = hard.plan_minidual([rod_query], planner(), 30.0)
    numbers = hard.judged([rod_query], runs, planner())
    assert numbers["solved"] == 1
    assert (numbers["colliding"], numbers["over_jerk"], numbers["off_grasp"]) == (0, 0, 0)


def test_hands_whose_first_postures_collide_are_planned_to_their_poses() -> None:
    query = posed(draw(SETS["crossing"], 20261, 19), planner())
    numbers = hard.judged([query], hard.plan_to_poses([query], planner(), 30.0), planner())
    assert (numbers["solved"], numbers["colliding"], numbers["over_jerk"]) == (1, 0, 0)


class TestOmpl:
    def test_it_solves_what_is_easy_and_says_what_it_takes(self) -> None:
        query = posed_query(HOME, HOME + 0.1, PlanningScene())
        run = plan_ompl(query.motion, planner(), 20.0)
        numbers = hard.judged([query], [run], planner())
        assert (numbers["solved"], numbers["colliding"]) == (1, 0)
        assert numbers["median_ms"] > 0.0

    def test_of_one_arm_only_its_joints_move(self) -> None:
        q_goal = HOME.copy()
        q_goal[:7] += 0.1
        query = PeerQuery("left_arm", 0, 1, PlanningScene(), HOME, q_goal)
        run = plan_ompl(query, planner(), 20.0)
        assert run.trajectory is not None
        assert run.trajectory.q[-1] == pytest.approx(q_goal, abs=1e-3)
        assert np.ptp(run.trajectory.q[:, 7:], axis=0).max() < 1e-9


class TestRoboplan:
    @pytest.mark.parametrize("python", ["nowhere/bin/python", sys.executable])
    def test_without_it_the_error_says_what_to_type(self, python: str, tmp_path: Path) -> None:
        with pytest.raises(EnvironmentMissingError, match="roboplan is not installed") as caught:
            Roboplan(tmp_path / python)
        assert f"pip install roboplan=={ROBOPLAN}" in caught.value.remedy

    def test_the_table_without_it_says_so(
        self,
        monkeypatch: pytest.MonkeyPatch,
        tmp_path: Path,
    ) -> None:
        def no_path(queries: list[PosedQuery], _planner: object, _budget_s: float) -> list[Run]:
            return [Run(None, 0.0, "no")] * len(queries)

        monkeypatch.setattr(hard, "SETS", {"crossing": SETS["crossing"]})
        monkeypatch.setattr(hard, "plan_with_ompl", no_path)
        messages: list[str] = []
        python = tmp_path / "python"
        table = hard.measure(
            BenchInputs(Config(), SEED, 1, messages.append, peers=True, roboplan=python),
        )
        assert "WITHOUT roboplan" in table.title
        assert any("pip install roboplan" in note for note in table.notes)
        assert any("pip install roboplan" in message for message in messages)
        assert [row.name for row in table.rows] == [
            "crossing",
            "crossing: minidual",
            "crossing: minidual, to hand poses",
            "crossing: OMPL, MuJoCo, toppra",
        ]
        assert "WITHOUT" not in hard.measure(BenchInputs(Config(), SEED, 1)).title

    def test_a_colliding_path_is_counted(self, blocked: PosedQuery, tmp_path: Path) -> None:
        motion = straight(blocked.q_start, blocked.q_goal)
        answer = {
            "times": motion.times.tolist(),
            "q": motion.q.tolist(),
            "v": motion.v.tolist(),
            "a": motion.a.tolist(),
        }
        roboplan = answering(tmp_path, contacts_of(blocked), **answer)
        runs = roboplan.plan([blocked.motion], planner(), 1.0)
        numbers = hard.judged([blocked], runs, planner())
        assert (numbers["solved"], numbers["colliding"], numbers["median_ms"]) == (1, 1, 500.0)

    def test_one_that_sees_other_contacts_ends_the_bench(
        self,
        blocked: PosedQuery,
        tmp_path: Path,
    ) -> None:
        contacts = contacts_of(blocked)
        assert 0 < sum(contacts) < len(contacts)
        for k in range(2):  # one in a hundred may differ
            contacts[k] = not contacts[k]
        roboplan = answering(tmp_path, contacts, reason="no path")
        roboplan.plan([blocked.motion], planner(), 1.0)
        contacts[2] = not contacts[2]
        roboplan = answering(tmp_path, contacts, reason="no path")
        with pytest.raises(RuntimeError, match="other contacts"):
            roboplan.plan([blocked.motion], planner(), 1.0)

    def test_one_that_finds_nothing_is_not_solved(
        self,
        blocked: PosedQuery,
        tmp_path: Path,
    ) -> None:
        roboplan = answering(tmp_path, contacts_of(blocked), reason="no path")
        (run,) = roboplan.plan([blocked.motion], planner(), 1.0)
        assert run.trajectory is None
        assert run.reason == "no path"

    def test_joints_outside_the_group_stay_where_they_start(self, tmp_path: Path) -> None:
        query = PeerQuery("right_arm", 0, 1, PlanningScene(), HOME, HOME + 0.1)
        states = np.array(query_record(query, planner().kinematics)["states"])
        engine = planner().engines(query.scene).engine("mujoco")
        answer = {
            "times": [0.0, 1.0],
            "q": [HOME[7:].tolist(), query.q_goal[7:].tolist()],
            "v": np.zeros((2, 7)).tolist(),
            "a": np.zeros((2, 7)).tolist(),
        }
        roboplan = answering(tmp_path, engine.collisions(states).tolist(), **answer)
        (run,) = roboplan.plan([query], planner(), 1.0)
        assert run.trajectory is not None
        assert run.trajectory.q[-1, :7] == pytest.approx(HOME[:7])
        assert run.trajectory.q[-1, 7:] == pytest.approx(query.q_goal[7:])


def contacts_of(query: PosedQuery) -> list[bool]:
    """Return MuJoCo's contacts at the states on which roboplan must agree."""
    states = np.array(query_record(query.motion, planner().kinematics)["states"])
    return planner().engines(query.drawn.scene).engine("mujoco").collisions(states).tolist()


def answering(folder: Path, contacts: list[bool], **answer: Any) -> Roboplan:
    """Return a roboplan whose Python is a script that gives this answer."""
    script = folder / "python"
    line = json.dumps({"contacts": contacts, "cpu_s": 0.5, "reason": "", **answer})
    script.write_text(
        f"#!/bin/sh\n[ \"$1\" = -c ] && exit 0\ncat > /dev/null\ncat <<'END'\n{line}\nEND\n",
    )
    script.chmod(0o755)
    return Roboplan(script)
