"""Four cubes into two bins: draw, order of the work, reach of the arms, and ways to cheat."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from minidual.config.root import Config
from minidual.config.scene import PartConfig
from minidual.control.stack import ControlStack
from minidual.motion.api import Planner
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, SIDES, pose, rot_z
from minidual.skills.compliant_carry import CompliantCarry
from minidual.skills.cycle import solve
from minidual.skills.pipeline.search import TaskFailedError
from minidual.skills.planned_carry import PlannedCarry
from minidual.skills.states import State
from minidual.tasks.catalogue import make_task
from minidual.tasks.judge import Judge, Outcome, begin
from minidual.tasks.sort import bin_of, side_of
from minidual.tasks.task import Step, Task, Trial, pose_of
from minidual.trials.methods import MethodInputs
from minidual.trials.runner import Bench
from tests.support.carries import true_poses

TASK = make_task(Config(task="sort"))
MARKS = {mark.name: mark for mark in TASK.scene.marks}
DRAWS = 256
HALF_M = 0.02
WAY = {"left": 1.0, "right": -1.0}


def start_of(trial: Trial, task: Task = TASK) -> dict[str, np.ndarray]:
    return {name: pose_of(item.body, trial.start[name]) for name, item in task.objects.items()}


# --- the draw


def test_every_draw_has_cubes_apart_outside_the_bins_and_one_on_the_wrong_side() -> None:
    wrong = []
    for k in range(DRAWS):
        trial = TASK.trial(3, "draws", k)
        for a, b in itertools.combinations(trial.start.values(), 2):
            assert math.dist(a[:2], b[:2]) >= 0.10
        assert all(
            abs(y) + 1.5 * HALF_M < MARKS["red_bin"].xy_m[1] - 0.09
            for _, y, _ in trial.start.values()
        )
        wrong.append(sum(WAY[side_of(name)] * y < -0.15 for name, (_, y, _) in trial.start.items()))
        assert set(trial.goal) == set(TASK.objects)
        for name, (x, y, _) in trial.goal.items():
            mark = MARKS[bin_of(name)]
            assert abs(x - mark.xy_m[0]) + HALF_M < mark.size_m[0] / 2
            assert abs(y - mark.xy_m[1]) + HALF_M < mark.size_m[1] / 2
            assert y * WAY[side_of(name)] > 0
    assert min(wrong) == 1
    assert max(wrong) >= 3


def test_of_one_colour_the_cube_nearer_its_bin_is_the_first() -> None:
    for k in range(DRAWS):
        y = {name: at[1] for name, at in TASK.trial(3, "draws", k).start.items()}
        assert y["red_1"] > y["red_2"]
        assert y["blue_1"] < y["blue_2"]


# --- two arms are needed


def test_no_posture_brings_a_hand_to_a_cube_in_the_other_arms_bin() -> None:
    """Shoulder to elbow to wrist to tool centre: the sum of three fixed lengths is too short."""
    kinematics = Kinematics()
    rng = np.random.default_rng(0)
    model = kinematics.model
    data = kinematics.data
    lengths = []
    shoulders = []
    for _ in range(50):
        q = rng.uniform(DUAL_PANDA.q_lower, DUAL_PANDA.q_upper)
        pin.forwardKinematics(model, data, q)
        origin = [data.oMi[k + 1].translation.copy() for k in range(7)]
        tcp = kinematics.tcp_poses(q)[0][:3, 3]
        shoulders.append(origin[1])
        chain = (origin[1], origin[3], origin[5], tcp)
        lengths.append([np.linalg.norm(b - a) for a, b in itertools.pairwise(chain)])
    assert np.ptp(lengths, axis=0).max() < 1e-9
    assert np.ptp(shoulders, axis=0).max() < 1e-9
    reach = float(np.sum(lengths[0]))
    mark = MARKS[bin_of("blue")]
    corner = np.array([mark.xy_m[0] - mark.size_m[0] / 2, mark.xy_m[1] + mark.size_m[1] / 2, 0.0])
    nearest = corner + np.array(
        [HALF_M, -HALF_M, HALF_M],
    )  # centre of a cube inside, nearest to the left arm
    grip = np.hypot(HALF_M, HALF_M)  # the tool centre is in the cube when the fingers pinch it
    assert np.linalg.norm(nearest - shoulders[0]) > reach + grip
    # With one arm frozen, the two cubes of its colour never come into their bin, whatever the draw.
    for k in range(DRAWS):
        goals = TASK.trial(4, "frozen", k).goal
        for arm, way in WAY.items():
            assert sum(way * y < 0 for _, y, _ in goals.values()) == 2, arm


PHASES = ("approach", "descend", "close", "lift", "carry", "lower", "open", "retreat")


def one_armed(arm: str, *names: str) -> Task:
    """Return the task in which one arm does all the work with these cubes."""
    steps = tuple(Step(phase, (arm,), (name,)) for name in names for phase in PHASES)
    return dataclasses.replace(TASK, arrange=None, steps=steps)


@pytest.mark.parametrize(("arm", "name"), [("left", "blue_1"), ("right", "red_1")])
def test_one_arm_alone_finds_no_plan(arm: str, name: str) -> None:
    others = {other: (0.44, 0.4 - 0.2 * k, 0.0) for k, other in enumerate(TASK.objects)}
    trial = dataclasses.replace(
        TASK.trial(4, "frozen", 0),
        start=others | {name: (0.54, -0.1, 0.0)},
    )
    with pytest.raises(TaskFailedError, match=r"the goal: .*cannot reach"):
        solve(one_armed(arm, name), trial, State(DUAL_PANDA.home, start_of(trial)), Planner())


# --- the order of the work


def carries(steps: tuple[Step, ...]) -> list[Step]:
    return [step for step in steps if step.phase == "carry"]


def test_cubes_of_the_wrong_side_are_passed_through_the_middle() -> None:
    for k in range(32):
        trial = TASK.trial(5, "order", k)
        both, turns = TASK.arrange(TASK, trial, start_of(trial))
        assert any(len(step.hands) == 2 for step in both)
        assert all(len(step.hands) == 1 for step in turns)
        for steps in (both, turns):
            at = {name: y for name, (_, y, _) in trial.start.items()}
            for step in carries(steps):
                for hand, name in zip(step.hands, step.objects, strict=True):
                    end = step.places[0][name]
                    wrong = WAY[side_of(name)] * at[name] < -0.15
                    assert (hand == side_of(name)) != wrong
                    assert abs(end[1, 3]) < 0.12 if wrong else abs(end[1, 3]) > 0.5
                    at[name] = end[1, 3]
            assert all(WAY[side_of(name)] * y > 0.5 for name, y in at.items())


def test_arms_act_together_only_where_they_keep_apart() -> None:
    for k in range(32):
        trial = TASK.trial(6, "order", k)
        at = {name: y for name, (_, y, _) in trial.start.items()}
        for step in carries(next(iter(TASK.arrange(TASK, trial, start_of(trial))))):
            ends = {name: T[1, 3] for name, T in step.places[0].items()}
            if len(step.hands) == 2:
                left, right = step.objects
                assert at[left] - at[right] >= 0.2
                assert ends[left] - ends[right] >= 0.2
            at |= ends


def test_a_draw_is_planned_with_the_other_cubes_as_obstacles() -> None:
    trial = TASK.trial(7, "plan", 0)
    solution = solve(TASK, trial, State(DUAL_PANDA.home, start_of(trial)), Planner())
    for name, T in solution.states[-1].objects.items():
        np.testing.assert_allclose(T[:2, 3], trial.goal[name][:2], atol=1e-9)
    moving = [segment for segment in solution.segments if segment.verification is not None]
    assert all(segment.verification.ok for segment in moving)
    for segment in moving:
        held = {shape.name for shape in segment.scene.attached}
        assert held | {shape.name for shape in segment.scene.obstacles} == {*TASK.objects, "table"}
    assert any(len(segment.scene.attached) == 2 for segment in moving)


def test_by_force_what_is_put_down_is_lowered_by_soft_hands_before_it_is_let_go() -> None:
    trial = TASK.trial(7, "plan", 0)
    kinematics = Kinematics()
    let_go = 0
    segments = solve(
        TASK,
        trial,
        State(DUAL_PANDA.home, start_of(trial)),
        Planner(),
        by_force=True,
    ).segments
    for lower, settle, opens in zip(segments, segments[1:], segments[2:], strict=False):
        if opens.phase != "open" or opens.kept_by:
            continue
        let_go += 1
        assert (lower.phase, settle.phase) == ("lower", "settle")
        assert set(lower.soft) == set(settle.soft) == set(opens.soft) != set()
        from_m, to_m = (
            np.array(kinematics.tcp_poses(lower.trajectory.q[k]))[:, 2, 3] for k in (0, -1)
        )
        arms = [SIDES.index(arm) for arm in opens.soft]
        assert (from_m - to_m)[arms] == pytest.approx(0.004, abs=1e-5)
        assert settle.scene is not None
        assert {shape.link[:4] for shape in settle.scene.attached}.isdisjoint(
            arm[:4] for arm in opens.soft
        )
    assert let_go >= 1


# --- the success test

GRIP = {"left": (30.0, 0.0), "right": (0.0, 30.0)}
TRIAL = Trial(
    "cheats",
    0,
    {
        "red_1": (0.45, 0.30, 0.0),
        "red_2": (0.45, -0.30, 0.3),
        "blue_1": (0.55, -0.10, 0.0),
        "blue_2": (0.55, 0.10, 0.0),
    },
    TASK.trial(8, "goals", 0).goal,
)


STEP_M = 0.015
"""Way of 10 ms at a speed that hands may have."""


class Cube:
    """What the judge reads of one cube."""

    def __init__(self, x: float, y: float, yaw: float) -> None:
        self.x = x
        self.y = y
        self.yaw = yaw
        self.height = 0.0
        self.pinch = (0.0, 0.0)
        self.speed = 0.0

    def pose(self) -> np.ndarray:
        return pose(rot_z(self.yaw), (self.x, self.y, HALF_M + self.height))

    def twist(self) -> np.ndarray:
        return np.array([self.speed, 0.0, 0.0, 0.0, 0.0, 0.0])

    def solids(self, parts: Sequence[PartConfig]) -> list[tuple[Any, Any]]:
        return [(part.position_m, part.half_m) for part in parts]

    def look(self) -> np.ndarray:
        T = self.pose()
        (left, right) = self.pinch
        return np.r_[
            T[:3, 3],
            T[2, :3],
            0.0,
            left,
            0.0,
            0.0,
            -right,
            0.0,
            self.pinch,
            0.0,
            self.yaw,
        ]


class Script:
    """Moves cubes in steps of 10 ms, judged at each."""

    def __init__(self, trial: Trial | None = None) -> None:
        self.trial = TRIAL if trial is None else trial
        self.time = 0.0
        self.judge = Judge(TASK, self.trial)
        self.cubes = {name: Cube(*place) for name, place in self.trial.start.items()}
        self.go("red_1", steps=2)

    def truth(self, name: str) -> Cube:
        return self.cubes[name]

    def at_an_arm(self, name: str) -> bool:
        return False

    def on_table(self, name: str) -> bool:
        return self.cubes[name].height < 1e-3

    def go(self, name: str, *, xy=None, height=None, pinch=None, steps: int = 20) -> None:
        cube = self.cubes[name]
        cube.pinch = cube.pinch if pinch is None else pinch
        begin = np.array([cube.x, cube.y, cube.height])
        end = np.array([*(begin[:2] if xy is None else xy), begin[2] if height is None else height])
        steps = max(steps, int(np.ceil(np.linalg.norm(end - begin) / STEP_M)))
        for cube.x, cube.y, cube.height in np.linspace(begin, end, steps + 1)[1:].tolist():
            self.time += 0.01
            self.judge.observe(self)

    def fetch(self, name: str, hand: str, xy, height: float = 0.1, low: float = 0.0) -> None:
        """Carry one cube."""
        self.go(name, pinch=GRIP[hand], steps=5)
        self.go(name, height=height)
        self.go(name, xy=xy)
        self.go(name, height=low)
        self.go(name, pinch=(0.0, 0.0), height=0.0, steps=15)

    def sort(self, *names: str) -> None:
        """Carry these cubes to their goals, by the middle where they must."""
        for name in names:
            owner = side_of(name)
            if WAY[owner] * self.cubes[name].y < -0.15:
                self.fetch(name, SIDES[1 - SIDES.index(owner)], (0.48, 0.11 * WAY[owner]))
            self.fetch(name, owner, self.trial.goal[name][:2])

    def end(self) -> Outcome:
        return self.judge.outcome(self)


def test_an_honest_script_succeeds_and_counts_its_cubes() -> None:
    """Positive control: without it every refusal below might have another cause."""
    script = Script()
    for count, name in enumerate(("blue_2", "red_2", "red_1", "blue_1"), start=1):
        assert not script.judge.finished
        script.sort(name)
        assert script.judge.stages == tuple(f"placed_{k}" for k in range(1, count + 1))
    outcome = script.end()
    assert outcome.success, outcome.reason
    assert script.judge.finished
    assert outcome.measured["progress"] == 1.0
    assert outcome.number("goal_error_m") < 1e-9
    assert outcome.number("pinch_min_n") == 30.0


def pushed(s: Script) -> None:
    s.go("red_1", xy=TRIAL.goal["red_1"][:2])


def dragged(s: Script) -> None:
    s.go("red_1", pinch=GRIP["left"], xy=TRIAL.goal["red_1"][:2])
    s.go("red_1", pinch=(0.0, 0.0))


def dragged_after_a_lift(s: Script) -> None:
    s.go("red_1", pinch=GRIP["left"], height=0.06)
    s.go("red_1", height=0.0)
    dragged(s)


def hopped(s: Script) -> None:
    s.go("red_1", pinch=GRIP["left"], height=0.06)
    s.go("red_1", height=0.004)
    s.fetch("red_1", "left", TRIAL.goal["red_1"][:2], height=0.004)


def lifted_too_little(s: Script) -> None:
    s.fetch("red_1", "left", TRIAL.goal["red_1"][:2], height=0.035)


def brought_by_the_wrong_hand(s: Script) -> None:
    """As one arm that reached everywhere would sort."""
    s.fetch("red_1", "right", TRIAL.goal["red_1"][:2])


def let_go_and_pushed(s: Script) -> None:
    x, y, _ = TRIAL.goal["red_1"]
    s.fetch("red_1", "left", (x, y - 0.019))
    s.go("red_1", xy=(x, y))


def thrown(s: Script) -> None:
    s.go("red_1", pinch=GRIP["left"], height=0.1)
    s.go("red_1", pinch=(0.0, 0.0), xy=TRIAL.goal["red_1"][:2])
    s.go("red_1", height=0.0)


def dropped(s: Script) -> None:
    s.fetch("red_1", "left", TRIAL.goal["red_1"][:2], low=0.03)


def over_the_rim(s: Script) -> None:
    mark = MARKS["red_bin"]
    s.fetch("red_1", "left", (mark.xy_m[0], mark.xy_m[1] - mark.size_m[1] / 2 + HALF_M - 0.002))


def in_the_other_bin(s: Script) -> None:
    s.fetch("red_1", "left", (0.48, 0.0))
    s.fetch("red_1", "right", MARKS["blue_bin"].xy_m)


def left_behind(s: Script) -> None:
    s.fetch("red_1", "left", (0.48, 0.11))


def still_held(s: Script) -> None:
    s.sort("red_1")
    s.go("red_1", pinch=GRIP["left"])


def stacked(s: Script) -> None:
    x, y, _ = TRIAL.goal["red_2"]
    s.go("red_1", pinch=GRIP["left"], height=0.1)
    s.go("red_1", xy=(x, y))
    s.go("red_1", height=2 * HALF_M)
    s.go("red_1", pinch=(0.0, 0.0))


def rolling(s: Script) -> None:
    s.sort("red_1")
    s.cubes["red_1"].speed = 0.05
    s.go("red_1")


def late(s: Script) -> None:
    s.time += TASK.time_limit_s
    s.sort("red_1")


def tipped(s: Script) -> None:
    cube = s.cubes["red_1"]
    s.go("red_1", pinch=GRIP["left"], height=0.1)
    cube.pose = lambda: pose(
        np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
        (cube.x, cube.y, HALF_M + cube.height),
    )
    s.go("red_1", xy=TRIAL.goal["red_1"][:2])
    s.go("red_1", height=0.0)
    s.go("red_1", pinch=(0.0, 0.0))


CHEATS: dict[Callable[[Script], None], str] = {
    pushed: "carried",
    dragged: "carried",
    dragged_after_a_lift: "carried",
    hopped: "carried",
    lifted_too_little: "rose",
    brought_by_the_wrong_hand: "brought",
    let_go_and_pushed: "settled",
    thrown: "held",
    dropped: "held",
    over_the_rim: "inside",
    in_the_other_bin: "brought",
    left_behind: "inside",
    still_held: "released",
    stacked: "held",
    rolling: "at_rest",
    late: "on_time",
    tipped: "level",
}


@pytest.mark.parametrize("cheat", CHEATS, ids=lambda cheat: cheat.__name__)
def test_a_cheat_with_one_cube_is_refused_though_the_others_are_sorted(
    cheat: Callable[[Script], None],
) -> None:
    script = Script()
    script.sort("blue_1", "blue_2", "red_2")
    assert script.judge.stages[-1] == "placed_3"
    assert script.judge.failures == {}
    cheat(script)
    outcome = script.end()
    assert not outcome.success
    assert outcome.failures[0].name == CHEATS[cheat], outcome.failures
    assert cheat is late or "red_1" in outcome.reason


# --- driven


@pytest.mark.slow
@pytest.mark.parametrize("method", ["moveit", "impedance"])
def test_driven_it_sorts(method: str) -> None:
    bench = Bench(method, MethodInputs(TASK.config, TASK.config.seed))
    for k in range(2):
        result, _ = bench.run(TASK.trial(TASK.config.seed, "driven", k))
        assert result.success, result.text
        assert result.measured["progress"] == 1.0


@pytest.mark.slow
@pytest.mark.parametrize("method", ["moveit", "impedance"])
def test_a_camera_that_sees_cubes_too_high_makes_nobody_drop_them(method: str) -> None:
    """An object that rests is no payload of the hand: else `moveit` lets go in the air."""
    bench = Bench(method, MethodInputs(TASK.config, TASK.config.seed), "randomised")
    result, _ = bench.run(TASK.trial(20260, "benchmark", 6))
    assert result.success, result.text


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arm", "kind"),
    [(SIDES[0], PlannedCarry), (SIDES[1], PlannedCarry), (SIDES[0], CompliantCarry)],
)
def test_with_one_arm_frozen_it_sorts_half_at_most(arm: str, kind: type[PlannedCarry]) -> None:
    """The arm does all it can: its own colour, near its side."""
    trial = TASK.trial(9, "frozen", 0)
    spots = iter([(0.42, 0.25), (0.54, 0.25), (0.42, -0.25), (0.54, -0.25)])
    trial = dataclasses.replace(trial, start={name: (*next(spots), 0.0) for name in TASK.objects})
    world = World(TASK.scene)
    judge = begin(world, TASK, trial)
    own = one_armed(arm, *(name for name in TASK.objects if side_of(name) == arm))
    carry = kind(
        ControlStack(world, Kinematics()),
        Planner(),
        own,
        trial,
        1,
        poses=true_poses(world, own),
    )
    while not carry.done and world.time < TASK.time_limit_s:
        carry.step()
        judge.observe(world)
    outcome = judge.outcome(world)
    assert carry.aborted is None
    assert judge.stages == ("placed_1", "placed_2")
    assert not outcome.success
    assert {"rose", "inside"} <= {failure.name for failure in outcome.failures}


def test_the_scene_shows_bins_and_cubes_of_their_colours() -> None:
    world = World(TASK.scene)
    for name, item in TASK.objects.items():
        colour = name.split("_")[0]
        np.testing.assert_allclose(world.model.geom(name).rgba, item.body.colour, atol=1e-6)
        rim = world.model.geom(f"{colour}_rim")
        np.testing.assert_allclose(rim.rgba, item.body.colour, atol=1e-6)
        assert world.model.geom(bin_of(name)).contype == 0
        assert world.model.geom(bin_of(name)).pos[2] > rim.pos[2]
    names = [world.model.geom(k).name for k in range(world.model.ngeom)]
    assert "goal_mark" not in names
