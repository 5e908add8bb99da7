"""Plans made of stages: order, backtracking, reasons, and a carry that is driven in the simulator."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Box
from minidual.errors import UsageError
from minidual.motion.api import Planner
from minidual.robot.constants import ARMS, HOME
from minidual.robot.kinematics import Kinematics
from minidual.robot.poses import inverse, pose, rot_z
from minidual.skills.pipeline.carrying import Place
from minidual.skills.pipeline.execute import execute
from minidual.skills.pipeline.moves import Approach, GoTo, Grasp, MoveTo, Release
from minidual.skills.pipeline.rod import both_hand_grips, carry_task, handover_task, one_hand_grips, rod_object
from minidual.skills.pipeline.search import Task, TaskFailedError
from minidual.skills.pipeline.stage import Backward, Candidate, Connector, Failure, Forward, Generator, Tools
from minidual.skills.pipeline.state import CLOSED, OPEN, State, scene_of
from minidual.tasks.rod_carry import grasp_offsets

RADIUS = 0.00887
ROD = rod_object(0.30, RADIUS)


def lying(x, y, yaw=0.0):
    return pose(rot_z(yaw), (x, y, RADIUS))


START = State(np.array(HOME), lying(0.5, 0.25, 0.1))
GOAL = Place("the goal", lying(0.5, -0.25))
NEARER = Place("nearer", lying(0.5, -0.05), cost=1.0)
UPRIGHT = both_hand_grips(offsets_m=(0.12,), leans_rad=(0.0,))


@pytest.fixture(scope="module")
def planner():
    return Planner()


def tools(planner, *obstacles):
    return Tools(PlanningScene().with_obstacles(*obstacles), ROD, planner, seed=1)


@pytest.fixture(scope="module")
def carried(planner):
    return carry_task(UPRIGHT, [GOAL]).solve(START, tools(planner))


# --- the search, on stages without any robot ---------------------------------------------------------------------


class Numbers(Generator):
    """Offers states whose first joint counts up."""

    def __init__(self, name, count):
        super().__init__(name)
        self.count, self.asked = count, 0

    def offers(self, first, tools):
        for k in range(self.count):
            self.asked += 1
            state = replace(first, q=first.q + k)
            yield Candidate(str(k), float(k), state, state)


class Only(Forward):
    """Lets one number pass."""

    def __init__(self, name, number):
        super().__init__(name)
        self.number, self.asked = number, 0

    def offers(self, start, tools):
        self.asked += 1
        if round(start.q[0]) == self.number:
            yield Candidate("", 0.0, start, replace(start))
        else:
            yield Failure("wrong", f"{start.q[0]:.0f} is not {self.number}")


class Before(Backward):
    def __init__(self, name, ways):
        super().__init__(name)
        self.ways = ways

    def offers(self, end, tools):
        for k in range(self.ways):
            yield Candidate(str(k), 0.0, replace(end), end)


class Join(Connector):
    def __init__(self, name, fails=0):
        super().__init__(name)
        self.fails, self.asked = fails, 0

    def offers(self, start, end, tools):
        self.asked += 1
        if self.asked <= self.fails:
            yield Failure("blocked", "no way between")
        else:
            yield Candidate("", 0.0, start, end)


NOTHING = State(np.zeros(14), np.eye(4))


def test_it_goes_back_until_a_candidate_passes_every_stage():
    numbers, last, join = Numbers("make", 10), Only("last", 3), Join("join")
    solution = Task("t", [join, numbers, Only("first", 3), last]).solve(NOTHING, None)
    assert solution.states[2].q[0] == 3
    assert numbers.asked == 4
    assert last.asked == 1
    assert join.asked == 1  # connectors come last, and only once
    record = {s.name: s for s in solution.record.stages}
    assert record["first"].failures == {"wrong": 3}
    assert record["first"].messages["wrong"] == "0 is not 3"
    assert record["make"].chosen == "3"
    assert solution.cost == 3.0


def test_the_same_input_is_planned_once_however_many_ways_lead_there():
    last = Only("last", 3)
    with pytest.raises(TaskFailedError):
        Task("t", [Join("join"), Before("up", 5), Numbers("make", 3), last]).solve(NOTHING, None)
    assert last.asked == 3  # once a number, not once a number and way up to it


def test_a_connector_that_fails_sends_the_search_back():
    solution = Task("t", [Join("join", fails=2), Numbers("make", 10)]).solve(NOTHING, None)
    assert solution.states[-1].q[0] == 2
    assert solution.record.stages[0].failures == {"blocked": 2}


def test_preferred_candidates_are_followed_first_over_all_stages():
    """Best first by the sum of preferences over the stages, not stage by stage."""
    followed = []

    class Second(Forward):
        def offers(self, start, tools):
            for cost in (0.0, 0.4, 2.5):
                q = start.q.copy()
                q[1] = cost
                yield Candidate("", cost, start, replace(start, q=q))

    class Never(Forward):
        def offers(self, start, tools):
            followed.append(round(start.q[0] + start.q[1], 3))
            yield Failure("no", "never")

    with pytest.raises(TaskFailedError, match="'never' stops it"):
        Task("t", [Join("join"), Numbers("make", 3), Second("second"), Never("never")]).solve(NOTHING, None)
    assert followed == sorted(followed)
    assert followed == [0.0, 0.4, 1.0, 1.4, 2.0, 2.4, 2.5, 3.5, 4.5]


def test_limits_end_the_search_and_say_so():
    task = Task("t", [Join("join"), Numbers("make", 10_000), Only("last", -1)])
    with pytest.raises(TaskFailedError, match="gave up after 40 candidates"):
        task.solve(NOTHING, None, tries_max=40)
    with pytest.raises(TaskFailedError, match="gave up after"):
        task.solve(NOTHING, None, budget_s=1e-9)


@pytest.mark.parametrize(
    ("stages", "says"),
    [
        ([Join("a"), Only("b", 1)], r"0 generators in the stages after 'a' \(b\)"),
        ([Join("a"), Numbers("b", 1), Numbers("c", 1)], "2 generators"),
        ([Join("a"), Only("b", 1), Numbers("c", 1)], "'b' stands before the generator and must be a Backward"),
        ([Join("a"), Numbers("b", 1), Before("c", 1)], "'c' stands after the generator and must be a Forward"),
        ([Only("b", 1), Join("a")], r"0 generators|leads nowhere"),
        ([Numbers("a", 1), Only("a", 1)], "two stages called 'a'"),
    ],
)
def test_stages_in_an_order_that_cannot_be_solved_are_refused(stages, says):
    with pytest.raises(UsageError, match=says):
        Task("t", stages)


# --- the rod --------------------------------------------------------------------------------------------------------


def test_the_upright_grip_is_that_of_the_rod_task(scene):
    widest = both_hand_grips()[0]
    for arm, T in zip(ARMS, grasp_offsets(scene), strict=True):
        assert np.abs(widest.grasps[arm] - T).max() < 1e-12


def test_leaning_hands_turn_about_the_rod():
    for grip in both_hand_grips(leans_rad=(0.0, 0.3)):
        for T in grip.grasps.values():
            assert abs(T[:3, 0] @ np.array([0.0, 1.0, 0.0])) == pytest.approx(1.0)  # hand's x along the rod
            assert np.hypot(T[0, 3], T[2, 3]) == pytest.approx(0.003)
            assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)


def test_the_scene_follows_the_object(planner):
    free = scene_of(PlanningScene(), ROD, START)
    assert free.why_unchecked("rod", "left_panda_hand") is None
    near = scene_of(PlanningScene(), ROD, START, touching=("left",))
    assert near.why_unchecked("rod", "left_panda_leftfinger")
    assert near.why_unchecked("rod", "right_panda_leftfinger") is None
    held = replace(START, held_by={"left": grasp_offsets_of("left")})
    carried = scene_of(PlanningScene(), ROD, held)
    assert carried.attached[0].link == "left_panda_hand_tcp"
    assert carried.why_unchecked("rod", "table") is None
    assert scene_of(PlanningScene(), ROD, held, resting=True).why_unchecked("rod", "table")


def grasp_offsets_of(arm):
    return both_hand_grips()[0].grasps[arm]


def test_a_carry_is_a_chain_of_proven_segments(carried):
    names = [s.stage for s in carried.segments]
    assert list(dict.fromkeys(names)) == [
        "move_to",
        "approach",
        "close",
        "lift",
        "transport",
        "place",
        "release",
        "retreat",
        "move_back",
    ]
    moving = [s for s in carried.segments if s.trajectory is not None]
    assert all(s.verification.ok for s in moving)
    for a, b in itertools.pairwise(moving):
        assert np.abs(a.trajectory.q[-1] - b.trajectory.q[0]).max() < 1e-6
    assert (moving[0].trajectory.q[0] == HOME).all()
    assert np.abs(moving[-1].trajectory.q[-1] - HOME).max() < 1e-9
    holding = {"lift", "transport", "place"}
    for segment in moving:
        assert segment.openings == ((CLOSED, CLOSED) if segment.stage in holding else (OPEN, OPEN))
    assert np.abs(carried.states[-1].T_world_object - GOAL.T_world_object).max() < 1e-12
    assert "solved" in carried.record.tree("carry")


def test_both_hands_keep_their_grasps_while_they_carry(carried):
    """Oracle: forward kinematics; the hands' relative pose never changes between close and release."""
    kinematics = Kinematics()
    first = None
    for segment in carried.segments:
        if segment.stage not in ("lift", "transport", "place"):
            continue
        for q in segment.trajectory.q[::50]:
            left, right = kinematics.tcp_poses(q)
            relative = inverse(left) @ right
            first = relative if first is None else first
            assert np.abs(relative - first).max() < 2e-4


def test_the_carry_is_driven_in_the_simulator(carried, world):
    world.reset(poses={"rod": (0.5, 0.25, 0.1)})
    lifted = []
    driven = execute(carried, world, on_step=lambda stage: lifted.append(world.object_pose()[2, 3]))
    assert [d.stage for d in driven] == [s.stage for s in carried.segments]
    assert max(lifted) > 0.1
    assert max(d.tracking_max_rad for d in driven) < 0.02
    assert max(d.object_off_max_m for d in driven if d.object_off_max_m is not None) < 0.002
    assert np.linalg.norm(world.object_pose()[:3, 3] - GOAL.T_world_object[:3, 3]) < 0.002
    assert abs(world.object_pose()[2, 1]) < np.sin(np.deg2rad(1.0))
    assert np.abs(world.q - HOME).max() < 0.02


def test_something_at_the_place_makes_it_take_another(planner):
    crate = Box("crate", (0.5, -0.34, 0.05), size_m=(0.06, 0.06, 0.1))
    places = [GOAL, NEARER]
    solution = carry_task(UPRIGHT, places).solve(START, tools(planner, crate))
    assert np.abs(solution.states[-1].T_world_object - NEARER.T_world_object).max() < 1e-12
    record = {s.name: s for s in solution.record.stages}
    assert record["place_pose"].chosen == "nearer"
    assert record["place_pose"].failures["goal_in_collision"] >= 1
    assert "crate" in record["place_pose"].messages["goal_in_collision"]


def test_without_another_place_it_fails_and_names_the_stage(planner):
    crate = Box("crate", (0.5, -0.25, 0.05), size_m=(0.1, 0.1, 0.1))
    with pytest.raises(TaskFailedError) as caught:
        carry_task(UPRIGHT[:1], [GOAL]).solve(START, tools(planner, crate))
    text = caught.value.message
    assert "'place_pose' stops it" in text
    assert "crate and rod penetrate by" in text
    assert "transport      not reached" in text
    stage = next(s for s in caught.value.record.to_json()["stages"] if s["stage"] == "place_pose")
    assert stage["solved_n"] == 0
    assert stage["tried_n"] == sum(f["count"] for f in stage["failures"]) > 0


def test_grips_out_of_reach_stop_it_at_the_grasp(planner):
    far = replace(START, T_world_object=lying(1.2, 0.0))
    with pytest.raises(TaskFailedError, match="'grasp' stops it") as caught:
        carry_task(UPRIGHT[:1], [GOAL]).solve(far, tools(planner))
    assert caught.value.record.stages[2].failures["ik_unreachable"] == 1


def test_a_lid_over_the_rod_stops_a_high_approach_and_lets_a_low_one_through(planner):
    lid = Box("lid", (0.56, 0.25, 0.36), size_m=(0.04, 0.5, 0.02))

    def fetch(heights):
        approach = Approach("approach", ARMS, heights_m=heights)
        return Task("fetch", [MoveTo(), approach, Grasp("grasp", UPRIGHT[:1], solutions_n=1)])

    with pytest.raises(TaskFailedError, match=r"'approach' stops it(?s:.*)lid and right_panda_link6 penetrate"):
        fetch((0.25,)).solve(START, tools(planner, lid))
    solution = fetch((0.25, 0.03)).solve(START, tools(planner, lid))
    record = {s.name: s for s in solution.record.stages}
    assert record["approach"].chosen == "from 3 cm"
    assert record["approach"].failures == {"linear_blocked": 1}


def test_no_free_motion_while_both_hands_hold(planner):
    held = replace(START, held_by=both_hand_grips()[0].grasps)
    offer = next(MoveTo().offers(held, replace(held, q=HOME + 0.1), tools(planner)))
    assert isinstance(offer, Failure)
    assert "tear" in offer.message
    refused = next(Release("r", ("left",)).offers(START, tools(planner)))
    assert refused.message == "the left hand holds nothing to release"


def test_a_bad_end_is_refused_before_the_search():
    with pytest.raises(Exception, match="configuration of stage 'end' has left_panda_joint1 = nan"):
        GoTo("end", np.full(14, np.nan))


@pytest.mark.slow
def test_the_rod_changes_hands_in_the_air(planner, world):
    start = State(np.array(HOME), lying(0.45, 0.25))
    task = handover_task(
        "left",
        one_hand_grips("left", offsets_m=(0.1,)),
        one_hand_grips("right", offsets_m=(-0.1,)),
        [Place("middle", pose(np.eye(3), (0.45, 0.02, 0.3)))],
        [Place("goal", lying(0.45, -0.2))],
    )
    solution = task.solve(start, tools(planner))
    world.reset(poses={"rod": (0.45, 0.25, 0.0)})
    heights = {}
    execute(solution, world, on_step=lambda stage: heights.setdefault(stage, []).append(world.object_pose()[2, 3]))
    assert min(heights["let_go"]) > 0.25  # the second hand has it
    assert np.linalg.norm(world.object_pose()[:3, 3] - lying(0.45, -0.2)[:3, 3]) < 0.01


@pytest.mark.slow
def test_one_hand_carries_too(planner, world):
    start = State(np.array(HOME), lying(0.45, 0.25, np.pi / 2))
    place = Place("p", lying(0.45, 0.05, np.pi / 2))
    solution = carry_task(one_hand_grips("left"), [place]).solve(start, tools(planner))
    world.reset(poses={"rod": (0.45, 0.25, np.pi / 2)})
    execute(solution, world)
    assert np.linalg.norm(world.object_pose()[:3, 3] - place.T_world_object[:3, 3]) < 0.005
