"""Plans made of stages: order, going back, reasons, and a carry driven by the control stack."""

import itertools
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Box
from minidual.config.scene import ObjectConfig, SceneConfig
from minidual.control.bounds import Reach
from minidual.control.stack import ControlStack
from minidual.errors import UsageError
from minidual.motion.api import Planner
from minidual.motion.budget import Budget
from minidual.motion.held.path import CarriedTrajectory
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, SIDES, inverse, pose, rot_x, rot_z
from minidual.skills.phases import PHASES
from minidual.skills.pipeline.carrying import Carry, Place
from minidual.skills.pipeline.drive import Drive
from minidual.skills.pipeline.hands import Grip, close, descend, home, open_hands, reach, retreat
from minidual.skills.pipeline.motions import off, straight
from minidual.skills.pipeline.search import Pipeline, TaskFailedError
from minidual.skills.pipeline.stage import Candidate, CandidateError, Gap, Stage, Tools
from minidual.skills.states import CLOSED, OPEN, State
from minidual.skills.supervised import arm_distance
from minidual.skills.things import thing_of
from minidual.tasks.task import grasp_offsets

RADIUS = 0.00887
HOME = DUAL_PANDA.home
ROD = thing_of(SceneConfig().object)
GRASPS = dict(zip(SIDES, grasp_offsets(SceneConfig()), strict=True))
BOTH = Grip("both ends", GRASPS)
REACH_M = Reach(Kinematics()).m


def lying(x, y, yaw=0.0):
    return pose(rot_z(yaw), (x, y, RADIUS))


START = State(np.array(HOME), {"rod": lying(0.5, 0.25, 0.1)})
GOAL = Place("the goal", {"rod": lying(0.5, -0.25)})
NEARER = Place("nearer", {"rod": lying(0.5, -0.05)}, cost=1.0)


@pytest.fixture(scope="module")
def planner():
    return Planner()


def tools(planner, *obstacles, gap=None):
    return Tools(PlanningScene().with_obstacles(*obstacles), {"rod": ROD}, planner, seed=1, gap=gap)


def carry(places, grips=(BOTH,), arms=SIDES):
    return Pipeline(
        "carry the rod",
        [
            Stage("approach", partial(reach, arms, grips, {})),
            Stage("descend", partial(descend, arms)),
            Stage("close", partial(close, arms)),
            Stage("carry", Carry(places, 0.12).offers),
            Stage("open", partial(open_hands, arms)),
            Stage("retreat", partial(retreat, arms)),
            Stage("home", partial(home, arms)),
        ],
    )


@dataclass
class Driven:
    """What happened while one segment was driven: largest distances from the plan."""

    phase: str
    tracking_max_rad: float = 0.0
    object_off_max_m: float = 0.0


def measured(drive, world, on_step=lambda phase: None):
    done = []
    last = None
    while not drive.done:
        drive.step()
        segment = next(iter(drive._left), None)
        t = drive.elapsed_s
        if segment is None or t == 0.0:
            continue
        if segment is not last:
            done.append(Driven(segment.phase))
            last = segment
        now = done[-1]
        now.tracking_max_rad = max(
            now.tracking_max_rad,
            np.abs(world.q - segment.trajectory.sample(t)[0]).max(),
        )
        if isinstance(segment.trajectory, CarriedTrajectory):
            planned = segment.trajectory.Ts_world_object
            row = min(round(t / segment.trajectory.dt_s), len(planned) - 1)
            off_m = np.linalg.norm(world.object_pose()[:3, 3] - planned[row, :3, 3])
            now.object_off_max_m = max(now.object_off_max_m, off_m)
        on_step(segment.phase)
    return done


def driven(solution, world, on_step=lambda phase: None):
    drive = Drive(ControlStack(world, Kinematics()), solution.segments)
    result = measured(drive, world, on_step)
    assert drive.aborted is None
    return result


@pytest.fixture(scope="module")
def carried(planner):
    return carry([GOAL]).solve(START, tools(planner))


# Search, on stages without any robot --------------------------------------------------------------


class Idle:
    """Tools of stages that plan nothing."""

    gap = None

    def __init__(self):
        self.planner = SimpleNamespace(work=Budget())


class Numbers:
    """Offers states whose first joint counts up."""

    def __init__(self, name, count):
        self.name = name
        self.count = count
        self.asked = 0

    def offers(self, start, tools):
        for k in range(self.count):
            self.asked += 1
            yield Candidate(str(k), float(k), replace(start, q=start.q + k))


class Only:
    """Lets one number pass."""

    def __init__(self, name, number):
        self.name = name
        self.number = number
        self.asked = 0

    def offers(self, start, tools):
        self.asked += 1
        if round(start.q[0]) == self.number:
            yield Candidate("", 0.0, replace(start))
        else:
            yield CandidateError("wrong", f"{start.q[0]:.0f} is not {self.number}")


NOTHING = State(np.zeros(14), {"rod": np.eye(4)})


def test_it_goes_back_until_a_candidate_passes_every_stage():
    numbers = Numbers("make", 10)
    last = Only("last", 3)
    solution = Pipeline("t", [numbers, Only("first", 3), last]).solve(NOTHING, Idle())
    assert solution.states[1].q[0] == 3
    assert numbers.asked == 4
    assert last.asked == 1
    record = {s.name: s for s in solution.record.stages}
    assert record["first"].failures == {"wrong": ["0 is not 3", "1 is not 3", "2 is not 3"]}
    assert record["make"].chosen == "3"


def test_preferred_candidates_are_followed_first_over_all_stages():
    """Best first by the sum of preferences over the stages, not stage by stage."""
    followed = []

    def second(start, tools):
        for cost in (0.0, 0.4, 2.5):
            q = start.q.copy()
            q[1] = cost
            yield Candidate("", cost, replace(start, q=q))

    def never(start, tools):
        followed.append(round(start.q[0] + start.q[1], 3))
        yield CandidateError("no", "never")

    with pytest.raises(TaskFailedError, match="'never' stops it") as caught:
        Pipeline("t", [Numbers("make", 3), Stage("second", second), Stage("never", never)]).solve(
            NOTHING,
            Idle(),
        )
    assert followed == sorted(followed)
    assert followed == [0.0, 0.4, 1.0, 1.4, 2.0, 2.4, 2.5, 3.5, 4.5]
    assert caught.value.summary == "'never' stops it: never"


def test_limits_end_the_search_and_say_so():
    pipeline = Pipeline("t", [Numbers("make", 10_000), Only("last", -1)])
    with pytest.raises(TaskFailedError, match="gave up after 40 candidates"):
        pipeline.solve(NOTHING, Idle(), tries_max=40)
    with pytest.raises(TaskFailedError, match="gave up after 3 candidates and 6000 state checks"):
        pipeline.solve(NOTHING, Idle(), budget_checks_n=5000)
    with pytest.raises(TaskFailedError, match="gave up after 0 candidates"):
        pipeline.solve(NOTHING, Idle(), budget_checks_n=0)


def test_a_pipeline_without_stages_or_with_a_name_twice_is_refused():
    with pytest.raises(UsageError, match="two stages called 'a'"):
        Pipeline("t", [Numbers("a", 1), Only("a", 1)])
    with pytest.raises(UsageError, match="the task 't' has no stage"):
        Pipeline("t", [])


# The rod ------------------------------------------------------------------------------------------


def test_hands_back_off_against_the_way_they_point():
    down = pose(np.diag([1.0, -1.0, -1.0]), (0, 0, 0))
    forward = pose(np.eye(3)[:, [1, 2, 0]], (0, 0, 0))
    np.testing.assert_allclose(off({"left": down, "right": down}, 0.08), [0, 0, 0.08])
    np.testing.assert_allclose(off({"left": forward}, 0.08), [-0.08, 0, 0])
    facing = pose(np.diag([1.0, -1.0, -1.0]) @ np.diag([1.0, -1.0, -1.0]), (0, 0, 0))
    np.testing.assert_allclose(
        off({"left": down, "right": facing}, 0.08),
        [0, 0, 0.08],
    )  # they face each other: up


def test_the_scene_follows_the_object(planner):
    scene = tools(planner).scene
    assert scene(START).why_unchecked("rod", "left_panda_hand") is None
    near = scene(START, touching=("left",))
    assert near.why_unchecked("rod", "left_panda_leftfinger")
    assert near.why_unchecked("rod", "right_panda_leftfinger") is None
    held = replace(START, held_by={"left": GRASPS["left"]})
    carried = scene(held)
    assert carried.attached[0].link == "left_panda_hand_tcp"
    assert carried.why_unchecked("rod", "table") is None
    assert scene(held, resting=True).why_unchecked("rod", "table")


def test_the_scene_holds_an_object_in_each_hand_and_the_others_as_obstacles(planner):
    cubes = {
        n: thing_of(ObjectConfig(name=n, shape="box", length_m=0.04, grasp_offset_m=0.0))
        for n in "abc"
    }
    poses = {name: lying(0.5, y) for name, y in zip("abc", (0.3, 0.0, -0.3), strict=True)}
    held = State(
        np.array(HOME),
        poses,
        {"left": np.eye(4), "right": np.eye(4)},
        handled={"left": "b", "right": "c"},
    )
    assert not held.closed_chain
    scene = Tools(PlanningScene(), cubes, planner).scene(held, resting=True)
    assert {a.name: a.link for a in scene.attached} == {
        "b": "left_panda_hand_tcp",
        "c": "right_panda_hand_tcp",
    }
    assert scene.why_unchecked("b", "c") is None
    assert scene.why_unchecked("a", "b") is None
    assert scene.why_unchecked("c", "left_panda_hand") is None
    assert scene.why_unchecked("c", "right_panda_hand")
    near = Tools(PlanningScene(), cubes, planner).scene(
        replace(held, held_by={}),
        touching=("left",),
    )
    assert near.why_unchecked("b", "left_panda_leftfinger")
    assert near.why_unchecked("a", "left_panda_leftfinger") is None
    one = replace(held, handled={"left": "b", "right": "b"})
    assert one.closed_chain
    assert (
        Tools(PlanningScene(), cubes, planner)
        .scene(one)
        .attached[0]
        .touch_links[0]
        .startswith("left")
    )


def test_a_carry_is_a_chain_of_proven_segments(carried):
    phases = [s.phase for s in carried.segments]
    assert phases == [
        "approach",
        "descend",
        "close",
        "close",
        "carry",
        "settle",
        "open",
        "retreat",
        "home",
    ]
    moving = [s for s in carried.segments if s.phase not in ("close", "settle", "open")]
    assert all(s.verification.ok for s in moving)
    for a, b in itertools.pairwise(carried.segments):
        assert np.abs(a.trajectory.q[-1] - b.trajectory.q[0]).max() < 1e-6
    assert (moving[0].trajectory.q[0] == HOME).all()
    assert np.abs(moving[-1].trajectory.q[-1] - HOME).max() < 1e-9
    for segment in carried.segments:
        closed = segment.phase in ("close", "carry", "settle")
        assert segment.openings == ((CLOSED, CLOSED) if closed else (OPEN, OPEN))
    assert np.abs(carried.states[-1].objects["rod"] - GOAL.objects["rod"]).max() < 1e-12
    assert "solved" in carried.record.tree("carry")


def test_both_hands_keep_their_grasps_while_they_carry(carried):
    """Oracle: forward kinematics; the hands' relative pose does not change."""
    kinematics = Kinematics()
    segment = next(s for s in carried.segments if s.phase == "carry")
    left, right = kinematics.tcp_poses(segment.trajectory.q[0])
    first = inverse(left) @ right
    for q in segment.trajectory.q[::50]:
        left, right = kinematics.tcp_poses(q)
        assert np.abs(inverse(left) @ right - first).max() < 2e-4


def test_the_carry_is_driven_through_the_control_stack(carried, world):
    world.reset(poses={"rod": (0.5, 0.25, 0.1)})
    lifted = []
    result = driven(carried, world, lambda phase: lifted.append(world.object_pose()[2, 3]))
    assert [d.phase for d in result] == [s.phase for s in carried.segments]
    assert max(lifted) > 0.1
    assert max(d.tracking_max_rad for d in result) < 0.02
    assert 0.0 < max(d.object_off_max_m for d in result) < 0.002
    assert np.linalg.norm(world.object_pose()[:3, 3] - GOAL.objects["rod"][:3, 3]) < 0.002
    assert abs(world.object_pose()[2, 1]) < np.sin(np.deg2rad(1.0))
    assert np.abs(world.q - HOME).max() < 0.02


def test_something_at_the_place_makes_it_take_another(planner):
    crate = Box("crate", (0.5, -0.34, 0.05), size_m=(0.06, 0.06, 0.1))
    solution = carry([GOAL, NEARER]).solve(START, tools(planner, crate))
    assert np.abs(solution.states[-1].objects["rod"] - NEARER.objects["rod"]).max() < 1e-12
    record = {s.name: s for s in solution.record.stages}["carry"]
    assert record.chosen == "nearer"
    assert "crate" in record.failures["goal_in_collision"][0]


def test_what_blocks_the_way_at_once_is_gone_round_in_parts(planner):
    wall = Box("wall", (0.5, 0.0, 0.07), size_m=(0.2, 0.02, 0.14))
    solution = carry([GOAL]).solve(START, tools(planner, wall))
    assert [s.phase for s in solution.segments][4:7] == ["lift", "carry", "lower"]
    (message,) = solution.record.stages[3].failures["not_free"]
    assert "wall" in message


def test_without_another_place_it_fails_and_names_the_stage(planner):
    crate = Box("crate", (0.5, -0.25, 0.05), size_m=(0.1, 0.1, 0.1))
    with pytest.raises(TaskFailedError) as caught:
        carry([GOAL]).solve(START, tools(planner, crate))
    text = caught.value.message
    assert "'carry' stops it" in text
    assert "crate and rod penetrate by" in text
    assert "retreat        not reached" in text
    stage = next(s for s in caught.value.record.to_json()["stages"] if s["stage"] == "carry")
    assert stage["solved_n"] == 0
    assert stage["tried_n"] == sum(f["count"] for f in stage["failures"]) > 0


def test_grips_out_of_reach_stop_it_at_the_approach(planner):
    far = replace(START, objects={"rod": lying(1.2, 0.0)})
    with pytest.raises(TaskFailedError, match="'approach' stops it") as caught:
        carry([GOAL]).solve(far, tools(planner))
    assert list(caught.value.record.stages[0].failures) == ["ik_unreachable"]
    assert caught.value.record.stages[0].to_json()["tried_n"] == 1


def test_a_grip_that_cannot_be_reached_gives_way_to_the_next(planner):
    beyond = Grip(
        "1 m beside it",
        {arm: pose(np.eye(3), (1.0, 0.0, 0.0)) @ T for arm, T in GRASPS.items()},
    )
    fetch = Pipeline(
        "fetch",
        [Stage("approach", partial(reach, SIDES, [beyond, replace(BOTH, cost=1.0)], {}))],
    )
    solution = fetch.solve(START, tools(planner))
    assert solution.record.stages[0].chosen == "both ends"
    assert "1 m beside it" in solution.record.stages[0].failures["ik_unreachable"][0]


def test_arms_that_come_too_close_are_a_failure_with_the_pair_and_the_gap(planner):
    near = iter([0.002, 0.002])
    gap = Gap(lambda q: ("elbow with elbow", next(near, 0.1)), REACH_M, 0.015)
    solution = carry([GOAL]).solve(START, tools(planner, gap=gap))
    record = solution.record.stages[0]
    assert record.chosen == "both ends, posture 2"
    assert (
        record.failures["arms_too_close"][0] == "elbow with elbow come to 2.0 mm; they must keep 15"
    )


def test_a_gap_is_looked_at_as_often_as_it_could_close(carried):
    distance = arm_distance(DUAL_PANDA)
    looks = []
    motion = next(s for s in carried.segments if s.phase == "home")
    times = np.arange(0.0, motion.trajectory.duration_s + 0.005, 0.005)
    every = [distance(q)[1] for q in motion.trajectory.sample_many(times)[0]]
    assert min(every) < 0.15  # the arms come nearer than the distance sees

    def look(q):
        looks.append(q)
        return distance(q)

    Gap(look, REACH_M, min(every) - 1e-9).check([motion])
    assert 2 < len(looks) < 0.6 * len(every)
    with pytest.raises(CandidateError, match=f"come to {1e3 * min(every):.1f} mm"):
        Gap(distance, REACH_M, min(every) + 1e-9).check([motion])


def test_a_motion_that_touches_a_joint_limit_is_refused_where_the_supervisor_would_stop_it(carried):
    gap = Gap(lambda q: ("", 1.0), REACH_M, 0.015)
    gap.check(carried.segments)
    (moving, *_) = (segment for segment in carried.segments if segment.verification is not None)
    at_the_limit = replace(
        moving,
        verification=moving.verification._replace(limit_margin_rad=0.002),
    )
    with pytest.raises(
        CandidateError,
        match=r"a joint comes to 2\.0 mrad from its limit",
    ) as caught:
        gap.check([moving, at_the_limit])
    assert caught.value.reason == "at_limit"


def test_a_straight_way_past_a_singular_posture_is_refused_before_anything_waits_for_it(planner):
    q = HOME.copy()
    q[DUAL_PANDA.groups["right_arm"]] = [0.6048, 0.2604, -1.2743, -2.1147, 0.3029, 2.1705, -1.3643]
    state = replace(START, q=q, objects={})
    down = rot_z(np.pi / 2 - 0.1) @ rot_x(np.pi)
    there = Tools(PlanningScene(), {}, planner)
    with pytest.raises(
        CandidateError,
        match=r"0\.62 m straight in 1\d\.\d s instead of 2\.1",
    ) as caught:
        straight(there, "carry", state, {"right": pose(down, (0.56, 0.03, 0.37))}, PlanningScene())
    assert caught.value.reason == "crawls"
    beside = straight(
        there,
        "carry",
        state,
        {"right": pose(down, (0.56, -0.2, 0.37))},
        PlanningScene(),
    )
    assert beside.trajectory.duration_s < 2.5


def test_what_hands_cannot_do_is_refused(planner):
    held = replace(START, held_by=GRASPS, rests=False)
    for offers, state, says in (
        (partial(home, SIDES), held, "tear"),
        (partial(reach, SIDES, [BOTH], {}), held, "tear"),
        (partial(open_hands, ("left",)), START, "the left hand holds nothing to let go"),
        (partial(open_hands, SIDES), held, "the object is in the air"),
        (Carry([GOAL], 0.1).offers, START, "no hand holds the object"),
    ):
        with pytest.raises(CandidateError, match=says):
            next(offers(state, tools(planner)))


def test_hands_may_reach_their_grasps_one_after_the_other(planner):
    """A hand over its grasp keeps it while the other hand reaches its own."""
    one, other = (Stage(f"approach {arm}", partial(reach, (arm,), [BOTH], {})) for arm in SIDES)
    solution = Pipeline("t", [one, other]).solve(START, tools(planner))
    assert set(solution.states[1].reached) == {"left"}
    assert set(solution.states[2].reached) == set(SIDES)


def keeps_the_limits_of_a_carry(planner, motion):
    """Return the left hand's speed and acceleration every 2 ms; one radian counts as 0.2 m."""
    step_s = 0.002
    limits = PHASES["carry"].limits
    times = np.arange(0.0, motion.duration_s, step_s)
    poses = np.array([planner.kinematics.tcp_poses(q)[0] for q in motion.sample_many(times)[0]])
    turns = np.array([pin.log3(a.T @ b) for a, b in pairwise(poses[:, :3, :3])]) / step_s
    speeds = np.diff(poses[:, :3, 3], axis=0) / step_s
    fastest = np.hypot(np.linalg.norm(speeds, axis=1), 0.2 * np.linalg.norm(turns, axis=1)).max()
    hardest = np.linalg.norm(np.diff(speeds, axis=0) / step_s, axis=1).max()
    assert fastest <= 1.01 * limits.speed_m_per_s
    assert hardest <= 1.05 * limits.acceleration_m_per_s2
    assert fastest > 0.9 * limits.speed_m_per_s or hardest > 0.9 * limits.acceleration_m_per_s2


def test_a_free_motion_that_tilts_the_object_is_a_failure(planner):
    """One hand moves an upright rod round a wall: if any tilt is allowed, not if none is."""
    bottle = replace(ROD, upright=True)
    T = GRASPS["left"]
    state = replace(START, q=np.array(HOME), held_by={"left": T}, rests=False)
    T_start = planner.kinematics.tcp_poses(HOME)[0] @ inverse(T)
    turned = T_start.copy()
    turned[:3, :3] = rot_z(0.3) @ rot_x(0.6) @ T_start[:3, :3]
    place = Place("turned", {"rod": turned}, rests=False)
    given = Tools(PlanningScene(), {"rod": bottle}, planner, seed=1)
    held = replace(state, objects={"rod": T_start})
    stages = {limit: Carry([place], 0.1, limit) for limit in (np.pi, 0.05)}
    offered = [o for o in stages[np.pi].offers(held, given) if not isinstance(o, CandidateError)]
    (carried, *_) = (o.segments[-1].trajectory for o in offered if o.label.endswith("round"))
    keeps_the_limits_of_a_carry(planner, carried)
    carries = home(("left",), offered[0].end, given)
    keeps_the_limits_of_a_carry(planner, next(carries).segments[0].trajectory)
    found = [o for o in stages[0.05].offers(held, given) if isinstance(o, CandidateError)]
    assert "tilted" in {o.reason for o in found}
    assert "at most 0.05" in next(o.message for o in found if o.reason == "tilted")


def test_tilt_is_that_of_the_axis_that_should_stay():
    lean = np.array([pose(rot_x(angle), (0, 0, 0)) for angle in (0.0, 0.3, -0.1)])
    roll = np.array([pose(rot_z(np.pi / 2) @ rot_x(0.4) @ rot_z(-np.pi / 2), (0, 0, 0))])
    upright = replace(ROD, upright=True)
    assert ROD.tilt_rad(lean) == pytest.approx(0.3)
    assert ROD.tilt_rad(roll) == pytest.approx(0.0)
    assert upright.tilt_rad(lean) == pytest.approx(0.3)
    assert upright.tilt_rad(roll) == pytest.approx(0.4)


def test_a_refused_segment_aborts_the_drive_by_name(carried, world):
    world.reset()
    late = replace(carried.segments[1])  # it starts elsewhere
    drive = Drive(ControlStack(world, Kinematics()), [late])
    measured(drive, world)
    assert drive.aborted is not None
    assert drive.aborted.startswith("the arbiter stopped phase 'descend' (")


@pytest.mark.parametrize("taker", ["hold", "teleop"])
def test_arms_that_are_taken_over_abort_the_drive(carried, world, taker):
    world.reset()
    stack = ControlStack(world, Kinematics())
    drive = Drive(stack, carried.segments)
    for step in range(1500):
        drive.step()
        if step == 1000:
            assert drive.aborted is None
            stack.request(taker)
    assert drive.done
    assert drive.aborted == "the arbiter stopped phase 'approach' (the arms were taken over)"


def test_one_hand_carries_too(planner, world):
    along_x = lying(0.45, 0.25, np.pi / 2)
    grip = Grip("the middle", {"left": pose(np.eye(3), (0.0, -0.12, 0.0)) @ GRASPS["left"]})
    place = Place("p", {"rod": lying(0.45, 0.05, np.pi / 2)})
    solution = carry([place], [grip], ("left",)).solve(
        replace(START, objects={"rod": along_x}),
        tools(planner),
    )
    world.reset(poses={"rod": (0.45, 0.25, np.pi / 2)})
    driven(solution, world)
    assert np.linalg.norm(world.object_pose()[:3, 3] - place.objects["rod"][:3, 3]) < 0.005
