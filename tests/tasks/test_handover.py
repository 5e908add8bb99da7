"""A bottle changes hands in the air, solved by the pipeline and judged by its own conditions."""

from __future__ import annotations

import dataclasses
import itertools
from contextlib import suppress

import numpy as np
import pytest

from minidual.collision.errors import IKUnreachableError
from minidual.config.root import Config
from minidual.control.stack import ControlStack
from minidual.errors import UsageError
from minidual.motion.api import Planner
from minidual.motion.ik import solvers
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, SIDES, pose, rot_z
from minidual.skills.compliant_carry import CompliantCarry
from minidual.skills.cycle import pipeline_of, solve
from minidual.skills.pipeline.drive import Drive
from minidual.skills.pipeline.search import TaskFailedError
from minidual.skills.planned_carry import PlannedCarry
from minidual.skills.states import Segment, State
from minidual.skills.supervised import trial_supervisor
from minidual.skills.things import thing_of
from minidual.tasks.catalogue import make_task
from minidual.tasks.judge import Outcome, begin
from minidual.tasks.task import Step, Task, Trial, pose_of
from tests.support.carries import true_poses

TASK = make_task(Config(task="handover"))
MIRRORED = {index: TASK.trial(1, "plan", index).start["bottle"][1] < 0.0 for index in range(8)}
TO_THE_LEFT, TO_THE_RIGHT = (
    next(i for i, mirrored in MIRRORED.items() if mirrored is way) for way in (True, False)
)


@pytest.fixture(scope="module")
def planner() -> Planner:
    return Planner()


class Slack(World):
    """A world in which one hand may not close."""

    slack: int | None = None

    def command(self, tau: np.ndarray, fingers: np.ndarray) -> None:
        if self.slack is not None:
            fingers = fingers.copy()
            fingers[self.slack] = self.robot.hand.travel_m
        super().command(tau, fingers)


@pytest.fixture(scope="module")
def bench() -> Slack:
    return Slack(TASK.scene)


def run(
    world: Slack,
    planner: Planner,
    index: int,
    kind: type[PlannedCarry] = PlannedCarry,
) -> tuple[Outcome, PlannedCarry]:
    trial = TASK.trial(1, "plan", index)
    judge = begin(world, TASK, trial)
    shape = thing_of(TASK.objects[TASK.carried].body).shape
    supervisor = trial_supervisor(TASK.config.supervisor, world.dt, world.robot, shapes=[shape])
    carry = kind(
        ControlStack(world, Kinematics(), supervisor=supervisor),
        planner,
        TASK,
        trial,
        index,
        poses=true_poses(world, TASK),
    )
    return drive(world, judge, carry), carry


def begun(world: World, planner: Planner, task: Task, index: int) -> PlannedCarry:
    """Return a carry at the start of a trial, without a supervisor."""
    trial = task.trial(1, "plan", index)
    begin(world, task, trial)
    return PlannedCarry(
        ControlStack(world, Kinematics()),
        planner,
        task,
        trial,
        index,
        poses=true_poses(world, task),
    )


def drive(world: World, judge, method: Drive) -> Outcome:
    while not method.done and world.time < TASK.time_limit_s:
        method.step()
        judge.observe(world)
    return judge.outcome(world)


def test_the_bottle_changes_hands_in_the_air_and_stands_at_its_goal(
    bench: Slack,
    planner: Planner,
) -> None:
    outcome, carry = run(bench, planner, TO_THE_LEFT)
    assert outcome.success, (outcome.reason, carry.aborted)
    assert outcome.measured["goal_error_m"] < 0.02
    names = [stage.name for stage in carry.solution.record.stages]
    assert names[3:8] == [
        "carry right",
        "approach left",
        "descend left",
        "close left",
        "open right",
    ]


def test_a_hand_closes_as_long_as_its_fingers_need_to_the_bottle(planner: Planner) -> None:
    """Nothing tells a policy how long a closed hand waits."""
    trial = TASK.trial(1, "plan", TO_THE_RIGHT)
    start = State(
        DUAL_PANDA.home,
        {"bottle": pose_of(TASK.objects["bottle"].body, trial.start["bottle"])},
    )
    closing = [
        s.trajectory.duration_s
        for s in solve(TASK, trial, start, planner).segments
        if s.phase == "close"
    ]
    way_m = DUAL_PANDA.hand.travel_m - TASK.objects["bottle"].body.half_width_m
    assert way_m == pytest.approx(0.015)
    assert closing[::2] == [pytest.approx(way_m / 0.03 + 0.2)] * 2


def test_a_hand_is_told_the_weight_that_it_bears_until_the_bottle_stands(
    bench: Slack,
    planner: Planner,
) -> None:
    """A giver that sags under the bottle lets the taker close beside it."""
    carry = begun(bench, planner, TASK, TO_THE_RIGHT)
    segments = carry.solution.segments
    borne_n = carry.stack.payload.force_n

    def until(segment: Segment) -> None:
        while not carry.done and (carry._left[0] is not segment or not carry._under_way):
            carry.step()
        assert not carry.done

    taker = next(s for s in segments if s.phase == "descend" and s.scene.attached)
    until(taker)
    wanted, real = (Kinematics().tcp_poses(q)[0][:3, 3] for q in (taker.trajectory.q[0], bench.q))
    assert np.abs(wanted - real).max() < 0.001
    assert borne_n == [pytest.approx(9.81 * 0.75), 0.0]
    _, giver, settle, opens = (s for s in segments if s.phase in ("settle", "open"))
    until(giver)
    for _ in range(150):  # its fingers begin to part
        carry.step()
    assert borne_n == [pytest.approx(0.0), pytest.approx(9.81 * 0.75)]
    until(settle)
    assert bench.object_pose()[2, 3] < 0.105
    until(opens)
    assert borne_n == [0.0, pytest.approx(0.0, abs=2.0)], (
        "it presses the bottle on the table before it opens"
    )


def test_a_hand_that_closes_on_nothing_is_told_no_weight_and_lifts_nothing(
    bench: Slack,
    planner: Planner,
) -> None:
    carry = begun(bench, planner, TASK, TO_THE_RIGHT)
    while not carry.done and carry.phase != "close":
        carry.step()
    joint = bench.model.body("bottle").jntadr[0]
    bench.data.qpos[bench.model.jnt_qposadr[joint]] += 0.15
    low = bench.truth("bottle").pose()[2, 3]
    while not carry.done:
        carry.step()
        assert carry.stack.payload.force_n == [0.0, 0.0]
    assert "missed_grasp" in carry.aborted
    assert "the left hand feels no grip after 1.0 s" in carry.aborted
    assert bench.truth("bottle").pose()[2, 3] < low + 0.01
    assert carry.phase == "done"


def test_what_both_hands_hold_is_told_to_neither(planner: Planner) -> None:
    task = make_task(Config())
    world = World(task.scene)
    carry = begun(world, planner, task, 0)
    while not carry.done and carry.phase not in ("lift", "carry"):
        carry.step()
    assert any(carry._left[0].scene.attached)
    for _ in range(200):
        carry.step()
    assert carry.stack.payload.force_n == [0.0, 0.0]


@pytest.mark.slow
def test_by_impedance_the_taker_is_soft_until_the_giver_has_let_go_and_where_it_stands_the_bottle(
    bench: Slack,
    planner: Planner,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    taken: list[tuple[str, tuple[str, ...]]] = []
    drive_by = CompliantCarry._take_control

    def note(self: CompliantCarry, segment: Segment) -> None:
        drive_by(self, segment)
        taken.append((segment.phase, self.stack.manager.active))

    monkeypatch.setattr(CompliantCarry, "_take_control", note)
    outcome, carry = run(bench, planner, TO_THE_LEFT, CompliantCarry)
    assert outcome.success, (outcome.reason, carry.aborted)
    soft = [phase for phase, active in taken if active == ("left_hand", "right_arm")]
    # Put down, it lowers by 4 mm more, settles and opens while it is soft.
    assert soft == ["close", "close", "settle", "open", "lower", "lower", "settle", "open"]
    assert {active for phase, active in taken if phase not in soft} == {("both_arms",)}


def test_the_giver_keeps_what_the_taker_does_not_hold(bench: Slack, planner: Planner) -> None:
    """The taker's hand is told to close and does not; no clock opens the giver's."""
    bench.slack = SIDES.index("right")
    try:
        outcome, carry = run(bench, planner, TO_THE_RIGHT)
        assert carry.aborted.startswith("missed_grasp at ")
        assert "the right hand feels no grip after 1.0 s" in carry.aborted
        assert {fault.name for fault in outcome.failures} == {
            "exchanged",
            "arrived",
            "released",
            "at_rest",
        }
        for _ in range(300):
            carry.stack.step()
        left, right = bench.truth().pinch()
        assert (left > 20.0, right) == (True, 0.0)
        assert bench.object_pose()[2, 3] > 0.2
    finally:
        bench.slack = None


@pytest.mark.slow
def test_it_succeeds_from_other_starts(bench: Slack, planner: Planner) -> None:
    outcomes = [run(bench, planner, index)[0] for index in range(10, 20)]
    assert [o.success for o in outcomes] == [True] * 10, [o.reason for o in outcomes]


def test_each_end_is_out_of_the_other_hand_s_reach(planner: Planner) -> None:
    """Why it takes two hands: neither alone can plan the whole."""
    trial = TASK.trial(1, "plan", TO_THE_RIGHT)
    direct = next(iter(TASK.arrange(TASK, trial, {"bottle": pose(np.eye(3), (0.42, 0.58, 0.1))})))
    grasps = tuple(grasp for step in direct for grasp in step.grasps)
    assert len(grasps) == 4
    for hand in SIDES:
        phases = ("descend", "close", "lift", "carry", "lower", "open")
        alone = (
            Step("approach", (hand,), grasps=grasps),
            *(Step(phase, (hand,)) for phase in phases),
        )
        with pytest.raises(TaskFailedError, match="cannot reach"):
            planned(dataclasses.replace(TASK, steps=alone, arrange=None), TO_THE_RIGHT, planner)


def test_only_one_arm_reaches_a_corner_of_either_range() -> None:
    """By inverse kinematics with 25 starts a grasp, for the grasps and turns of the task."""
    asked = TASK.scene.task
    rng = np.random.default_rng(0)
    trial = TASK.trial(1, "plan", TO_THE_RIGHT)
    steps = list(
        next(iter(TASK.arrange(TASK, trial, {"bottle": pose(np.eye(3), (0.42, 0.62, 0.1))}))),
    )
    grasps = [grasp for step in steps for grasp in step.grasps]
    goals = next(step.places for step in reversed(steps) if step.places)

    def reaches(hand: str, poses: list[np.ndarray]) -> bool:
        ik = solvers(DUAL_PANDA)[hand]
        for T in poses:
            for grasp in grasps:
                with suppress(IKUnreachableError):
                    next(ik.solutions(T @ grasp, DUAL_PANDA.home[ik.joints], rng, 25))
                    return True
        return False

    for corner in itertools.product((-1.0, 1.0), repeat=2):
        x, y = np.add(asked.start_xy_m, np.multiply(asked.start_range_m, corner))
        starts = [pose(rot_z(way * asked.start_range_rad), (x, y, 0.1)) for way in (-1.0, 0.0, 1.0)]
        x, y = np.add(asked.goal_xy_m, np.multiply(asked.goal_range_m, corner))
        ends = [pose(T[:3, :3], (x, y, 0.1)) for T in goals]
        assert [reaches(hand, starts) for hand in SIDES] == [True, False], corner
        assert [reaches(hand, ends) for hand in SIDES] == [False, True], corner


def planned(task: Task, index: int, planner: Planner):
    """Return the plan of a trial from its true start."""
    trial = TASK.trial(1, "plan", index)
    body = task.objects[task.carried].body
    state = State(planner.robot.home, {body.name: pose_of(body, trial.start[body.name])})
    return solve(task, trial, state, planner, index)


def test_the_giver_grasps_anew_where_no_exchange_is_reachable(planner: Planner) -> None:
    """The first steps would exchange beyond the table."""

    def arrange(task: Task, trial: Trial, seen):
        direct, anew = TASK.arrange(task, trial, seen)
        away = pose(np.eye(3), (1.6, 0.0, 0.3))
        yield tuple(
            dataclasses.replace(s, places=(away,)) if s.phase == "carry" else s for s in direct
        )
        yield anew

    solution = planned(dataclasses.replace(TASK, arrange=arrange), TO_THE_RIGHT, planner)
    names = [stage.name for stage in solution.record.stages]
    assert names[3:6] == ["carry left", "open left", "retreat left"]
    assert names[6:9] == ["approach left (2)", "descend left (2)", "close left (2)"]


def test_a_bottle_that_is_put_down_for_another_grasp_is_handed_over_too(
    bench: Slack,
    planner: Planner,
) -> None:
    """Driven and judged, as if no direct exchange had been found."""
    anew = dataclasses.replace(TASK, arrange=lambda *given: list(TASK.arrange(*given))[1:])
    trial = TASK.trial(1, "plan", TO_THE_RIGHT)
    judge = begin(bench, anew, trial)
    stack = ControlStack(
        bench,
        Kinematics(),
        supervisor=trial_supervisor(TASK.config.supervisor, bench.dt, bench.robot),
    )
    carry = PlannedCarry(stack, planner, anew, trial, TO_THE_RIGHT, poses=true_poses(bench, anew))
    outcome = drive(bench, judge, carry)
    assert outcome.success, (outcome.reason, carry.aborted)
    assert "open left" in [stage.name for stage in carry.solution.record.stages]


def test_a_step_that_cannot_be_planned_is_refused_by_name() -> None:
    trial = TASK.trial(1, "plan", 0)
    with pytest.raises(UsageError, match=r"no phase 'aproach'.*approach"):
        pipeline_of(TASK, trial, [Step("aproach", ("left",))])
    with pytest.raises(UsageError, match=r"no object 'cup'; there are bottle"):
        pipeline_of(TASK, trial, [Step("close", ("left",), ("cup",))])
    bare = dataclasses.replace(TASK.objects["bottle"], grasps={"left": np.eye(4)})
    no_right = dataclasses.replace(TASK, objects={"bottle": bare})
    with pytest.raises(UsageError, match="the right hand has no grasp of 'bottle'; there are left"):
        pipeline_of(no_right, trial, [Step("approach", ("right",))])
