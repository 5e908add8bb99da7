"""Peg and socket in the air: draw, play of the bore, need of two hands, and ways to cheat."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np
import pytest

from minidual.config.root import Config
from minidual.config.scene import ObjectConfig, PartConfig
from minidual.control.stack import ControlStack
from minidual.motion.api import Planner
from minidual.motion.ik import solvers
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, SIDES, pose, rot_x, rot_z
from minidual.skills.compliant_carry import CompliantCarry
from minidual.skills.cycle import solve
from minidual.skills.pipeline import inserting
from minidual.skills.planned_carry import PlannedCarry
from minidual.skills.states import State
from minidual.skills.supervised import SceneClearance
from minidual.skills.things import thing_of
from minidual.tasks.catalogue import make_task
from minidual.tasks.insertion import CLEARANCE_M, DEPTH_M, HAND_OF, PEG, SOCKET
from minidual.tasks.judge import Judge, Outcome, begin
from minidual.tasks.task import Step, Trial, placement, pose_of
from minidual.trials.methods import MethodInputs
from minidual.trials.runner import Bench
from tests.support.carries import true_poses

TASK = make_task(Config(task="insertion"))
DRAWS = [TASK.trial(2, "draws", k) for k in range(256)]
BODIES = {name: item.body for name, item in TASK.objects.items()}
MOUTH_M = 0.085
AIM_M = 0.036
BEFORE_M = 0.045
"""From the socket's centre to the mouth of its bore; depth to which a plan drives the peg."""


def start_of(trial: Trial) -> dict[str, np.ndarray]:
    return {name: pose_of(body, trial.start[name]) for name, body in BODIES.items()}


def in_socket(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """Return T_socket_peg with the tip at (x, y, z) from the mouth's centre; y is the depth."""
    return pose(np.eye(3), (x, y - MOUTH_M - BODIES[PEG].length_m / 2, z))


# --- the draw


def test_starts_and_places_in_the_air_vary() -> None:
    for name, way in ((SOCKET, 1.0), (PEG, -1.0)):
        starts = np.array([draw.start[name] for draw in DRAWS])
        assert np.ptp(starts, axis=0) == pytest.approx([0.10, 0.10, 0.70], rel=0.04)
        assert (way * starts[:, 1]).min() > 0.2
    goals = np.array([[*draw.goal[PEG][:3, 3], placement(draw.goal[PEG])[2]] for draw in DRAWS])
    assert np.ptp(goals, axis=0) == pytest.approx([0.06, 0.06, 0.08, 0.52], rel=0.04)
    for draw in DRAWS[:4]:
        T = np.linalg.inv(draw.goal[SOCKET]) @ draw.goal[PEG]
        np.testing.assert_allclose(T, in_socket(y=AIM_M), atol=1e-12)


def test_both_hands_reach_every_draw() -> None:
    """Over the object, at it, before the mouth and in it; each search from the last posture."""
    for draw in DRAWS:
        ends = {**draw.goal, PEG: draw.goal[SOCKET] @ in_socket(y=-BEFORE_M)}
        for name, side in HAND_OF.items():
            grasp = TASK.objects[name].grasps[side]
            solver = solvers(DUAL_PANDA)[side]
            start = start_of(draw)[name]
            postures = (
                DUAL_PANDA.home,
                *(np.concatenate(pair) for pair in DUAL_PANDA.arm.postures.values()),
            )
            over = pose(np.eye(3), (0.0, 0.0, 0.08)) @ start @ grasp
            tries = (solver.solve(over, q[solver.joints]) for q in postures)
            found = next(solution for solution in tries if solution.reached)
            for T in (start, ends[name], draw.goal[name]):
                found = solver.solve(T @ grasp, found.q)
                assert found.reached, (draw.index, name, found.off)


# --- the bore


@pytest.fixture(scope="module")
def floating() -> World:
    """Peg and socket without weight; the socket is too heavy to move, and neither turns."""
    world = World(TASK.scene)
    world.model.opt.gravity[:] = 0.0
    socket, peg = (world.model.body(name).id for name in (SOCKET, PEG))
    world.model.body_mass[socket], world.model.body_inertia[[socket, peg]] = 1e4, 1e4
    mujoco.mj_setConst(world.model, mujoco.MjData(world.model))
    return world


def pressed(
    world: World,
    T_socket_peg: np.ndarray,
    force_n: tuple[float, float, float],
    seconds: float,
) -> np.ndarray:
    """Return where the tip comes when a force acts on the peg."""
    T_socket = pose(np.eye(3), (0.5, 0.0, 0.4))
    world.reset(poses={SOCKET: T_socket, PEG: T_socket @ T_socket_peg})
    peg = world.truth(PEG)
    for _ in range(round(seconds / world.dt)):
        world.data.xfrc_applied[peg.body, :3] = np.array(force_n) - 20.0 * peg.qvel[:3]
        world.step()
    world.data.xfrc_applied[peg.body] = 0.0
    return (np.linalg.inv(T_socket) @ world.object_pose(PEG))[:3, 3] + [
        0.0,
        BODIES[PEG].length_m / 2 + MOUTH_M,
        0.0,
    ]


@pytest.mark.parametrize("axis", [0, 2])
def test_the_peg_has_the_documented_play_across_the_bore(floating: World, axis: int) -> None:
    ends = []
    for way in (-1.0, 1.0):
        force = np.zeros(3)
        force[axis] = 2.0 * way
        ends.append(pressed(floating, in_socket(y=0.03), tuple(force), 0.3)[axis])
    assert ends[1] - ends[0] == pytest.approx(CLEARANCE_M, abs=5e-5)


@pytest.mark.parametrize(
    ("x", "z", "enters"),
    [(0.0, 0.0, True), (0.0006, -0.0006, True), (0.0018, 0.0, False), (0.0, 0.03, False)],
)
def test_a_peg_pressed_beside_the_bore_does_not_go_in(
    floating: World,
    x: float,
    z: float,
    enters: bool,
) -> None:
    deep = pressed(floating, in_socket(x, -0.004, z), (0.0, 20.0, 0.0), 0.4)[1]
    assert deep > 0.04 if enters else abs(deep) < 0.002


# --- two arms are needed


def test_a_frozen_hand_is_away_from_its_object_wherever_the_task_is_done() -> None:
    """One arm frozen, 0 of 256: at the end each hand must pinch its object; the frozen one is away.

    The peg is within the tolerance of its goal then, and in the bore: neither object is farther.
    """
    (held,) = (condition for condition in TASK.success(TASK, DRAWS[0]) if condition.name == "held")
    assert {part.object: part.hand for part in held.parts} == {SOCKET: 0, PEG: 1}
    tolerance = TASK.scene.task.goal_tolerance_m
    play = AIM_M - DEPTH_M + 0.01
    tips = dict(zip(SIDES, Kinematics(DUAL_PANDA).tcp_poses(DUAL_PANDA.home), strict=True))
    for draw in DRAWS:
        for name, side in HAND_OF.items():
            ends = [
                part.position_m[1] + way * part.half_m[1]
                for part in BODIES[name].solids
                for way in (-1.0, 1.0)
            ]
            along = np.linspace(min(ends), max(ends), 50)
            axis = draw.goal[name] @ np.c_[np.zeros(50), along, np.zeros(50), np.ones(50)].T
            gap = np.linalg.norm(axis[:2].T - tips[side][:2, 3], axis=1).min()
            assert gap - tolerance - play - BODIES[name].half_width_m > 0.02, (draw.index, name)
            assert tips[side][2, 3] > 0.3 > pose_of(BODIES[name], draw.start[name])[2, 3] + 0.2


# --- the success test

OWN = {SOCKET: (30.0, 0.0), PEG: (0.0, 30.0)}
NONE = (0.0, 0.0)
SPEED_M_PER_S = 1.5
"""Hands may be so fast."""


class Thing:
    """What the judge reads of one object."""

    def __init__(self, body: ObjectConfig, T: np.ndarray) -> None:
        self.body = body
        self.T = T
        self.pinch = NONE
        self.force = 0.0

    def pose(self) -> np.ndarray:
        return self.T

    @property
    def frame(self) -> tuple[np.ndarray, np.ndarray]:
        return self.T[:3, :3].copy(), self.T[:3, 3].copy()

    def solids(self, parts: Sequence[PartConfig]) -> list[tuple[Any, Any]]:
        return [(part.position_m, part.half_m) for part in parts]

    def look(self) -> np.ndarray:
        T = self.T
        yaw = np.arctan2(-self.T[0, 1], self.T[1, 1])
        return np.r_[
            T[:3, 3],
            T[2, :3],
            0.0,
            self.force,
            0.0,
            0.0,
            self.force,
            0.0,
            self.pinch,
            0.0,
            yaw,
        ]


class Script:
    """Moves peg and socket, judged at each step."""

    def __init__(self, trial: Trial = DRAWS[0], step_s: float = 0.01) -> None:
        self.trial = trial
        self.time = 0.0
        self.step_s = step_s
        self.judge = Judge(TASK, trial)
        self.things = {name: Thing(BODIES[name], T) for name, T in start_of(trial).items()}
        self.wait(0.02)

    def truth(self, name: str) -> Thing:
        return self.things[name]

    def at_an_arm(self, name: str) -> bool:
        return False

    def wait(self, seconds: float) -> None:
        self.go({}, seconds)

    def go(self, ends: dict[str, np.ndarray], seconds: float = 0.2) -> None:
        """Move on straight lines; the last step has the end's rotation."""
        begin = {name: self.things[name].T for name in ends}
        ways_m = [float(np.linalg.norm(T[:3, 3] - begin[name][:3, 3])) for name, T in ends.items()]
        slow_s = max(ways_m, default=0.0) / SPEED_M_PER_S
        steps = max(1, int(np.ceil(max(seconds, slow_s) / self.step_s)))
        for k in range(1, steps + 1):
            for name, T in ends.items():
                now = T.copy()
                now[:3, 3] = begin[name][:3, 3] + k / steps * (T[:3, 3] - begin[name][:3, 3])
                self.things[name].T = now
            self.time += self.step_s
            self.judge.observe(self)

    def pinch(self, **pinches: tuple[float, float]) -> None:
        for name, pinch in (pinches or OWN).items():
            self.things[name].pinch = pinch
        self.wait(0.05)

    def both(self, height: float) -> None:
        self.go(
            {
                name: pose(thing.T[:3, :3], [*thing.T[:2, 3], height])
                for name, thing in self.things.items()
            },
        )

    def at(self, *offset: float) -> dict[str, np.ndarray]:
        """Return both goals, the tip at an offset from the centre of the mouth."""
        T = self.trial.goal[SOCKET]
        return {SOCKET: T, PEG: T @ in_socket(*offset)}

    def insert(self, *offset: float) -> None:
        x, y, z = offset or (0.0, AIM_M, 0.0)
        self.go(self.at(x, -0.02, z))
        self.go(self.at(x, y, z))

    def end(self) -> Outcome:
        return self.judge.outcome(self)


def honest(s: Script) -> None:
    s.pinch()
    s.both(0.2)
    s.insert()
    s.wait(0.5)


def test_an_honest_script_succeeds_and_reaches_its_stages() -> None:
    """Positive control: without it every refusal below might have another cause."""
    script = Script()
    script.pinch()
    assert script.judge.stages == ("held",)
    script.both(0.2)
    assert script.judge.stages == ("held", "aloft")
    script.insert()
    assert not script.judge.finished
    script.wait(0.5)
    outcome = script.end()
    assert outcome.success, outcome.reason
    assert script.judge.finished
    assert script.judge.stages == ("held", "aloft", "mated", "arrived")
    assert outcome.measured["progress"] == 1.0
    assert outcome.measured["depth_m"] == pytest.approx(AIM_M)


def pushed_together_on_the_table(s: Script) -> None:
    """And then lifted as one."""
    s.go({PEG: s.things[SOCKET].T @ in_socket(y=AIM_M)})
    lifted_as_one(s)


def slid_together_within_two_centimetres(s: Script) -> None:
    T = s.things[SOCKET].T.copy()
    s.things[PEG].T = T @ in_socket(y=-0.01)  # as if it had started there
    s.judge = Judge(TASK, s.trial)
    s.pinch()
    for y in (0.005, 0.008):
        s.go({PEG: T @ in_socket(y=y)})
    lifted_as_one(s)


def lifted_as_one(s: Script) -> None:
    s.pinch()
    s.go(s.at(0.0, AIM_M, 0.0))
    s.wait(0.5)


def mated_low(s: Script) -> None:
    s.pinch()
    s.both(0.075)
    low = {name: pose(T[:3, :3], [*T[:2, 3], 0.075]) for name, T in s.at(0.0, -0.02, 0.0).items()}
    s.go(low)
    s.go({PEG: low[SOCKET] @ in_socket(y=AIM_M)})
    lifted_as_one(s)


def dragged(s: Script) -> None:
    s.pinch()
    s.go({PEG: pose(np.eye(3), (0.4, -0.1, 0.011))})
    honest(s)


def one_hand_for_both(s: Script) -> None:
    s.pinch(socket=(30.0, 0.0), peg=(30.0, 0.0))
    s.both(0.2)
    s.insert()
    s.wait(0.5)


def peg_left_in_the_socket(s: Script) -> None:
    """The right hand lets go before the time is over."""
    s.pinch()
    s.both(0.2)
    s.insert()
    s.pinch(peg=NONE)
    s.wait(0.5)


def thrown(s: Script) -> None:
    s.pinch()
    s.both(0.2)
    s.go(s.at(0.0, -0.02, 0.0))
    s.things[PEG].pinch = NONE
    s.insert()
    s.wait(0.5)


def dropped(s: Script) -> None:
    s.pinch()
    s.both(0.2)
    s.pinch(socket=NONE)
    s.both(0.022)


def beside_the_bore(s: Script) -> None:
    s.pinch()
    s.both(0.2)
    s.insert(0.0, AIM_M, 0.04)
    s.wait(0.5)


def through_a_wall(s: Script) -> None:
    s.pinch()
    s.both(0.2)
    s.insert(0.0014, AIM_M, 0.0)
    s.wait(0.5)


def aslant(s: Script) -> None:
    s.pinch()
    s.both(0.2)
    s.go(s.at(0.0, -0.02, 0.0))
    s.go({PEG: s.trial.goal[SOCKET] @ in_socket(y=AIM_M) @ pose(rot_z(0.2), (0.0, 0.0, 0.0))})
    s.wait(0.5)


def in_by_20_mm(s: Script) -> None:
    s.pinch()
    s.both(0.2)
    s.insert(0.0, 0.020, 0.0)
    s.wait(0.5)


def pulled_out_too_soon(s: Script) -> None:
    s.pinch()
    s.both(0.2)
    s.insert()
    s.wait(0.2)
    s.go(s.at(0.0, 0.025, 0.0))
    s.wait(0.5)


def away_from_the_goal(s: Script) -> None:
    s.pinch()
    s.both(0.2)
    s.insert()
    s.go(
        {
            name: pose(T[:3, :3], T[:3, 3] + [0.03, 0.0, 0.0])
            for name, T in s.at(0.0, AIM_M, 0.0).items()
        },
    )
    s.wait(0.5)


def crushed(s: Script) -> None:
    s.pinch()
    s.both(0.2)
    s.things[SOCKET].force = 85.0
    s.insert()
    s.wait(0.5)


def tipped(s: Script) -> None:
    s.pinch()
    s.both(0.2)
    s.go({PEG: s.things[PEG].T @ pose(rot_x(0.3), (0.0, 0.0, 0.0))})
    s.insert()
    s.wait(0.5)


def turned_by_52_degrees(s: Script) -> None:
    """Both, in the air: the peg stays in the bore."""
    s.pinch()
    s.both(0.2)
    x, y, z = s.trial.goal[PEG][:3, 3]
    turn = pose(np.eye(3), (x, y, z)) @ pose(rot_z(np.radians(52.0)), (0.0, 0.0, 0.0))
    turn = turn @ pose(np.eye(3), (-x, -y, -z))
    s.go({name: turn @ T for name, T in s.at(0.0, -0.02, 0.0).items()})
    s.go({name: turn @ T for name, T in s.at(0.0, AIM_M, 0.0).items()})
    s.wait(0.5)


def late(s: Script) -> None:
    s.time += TASK.time_limit_s
    honest(s)


CHEATS: dict[Callable[[Script], None], str] = {
    pushed_together_on_the_table: "carried",
    slid_together_within_two_centimetres: "mated",
    mated_low: "mated",
    dragged: "carried",
    turned_by_52_degrees: "turned",
    one_hand_for_both: "held",
    peg_left_in_the_socket: "held",
    thrown: "held",
    dropped: "held",
    beside_the_bore: "mated",
    through_a_wall: "mated",
    aslant: "mated",
    in_by_20_mm: "mated",
    pulled_out_too_soon: "mated",
    away_from_the_goal: "arrived",
    crushed: "whole",
    tipped: "level",
    late: "on_time",
}


@pytest.mark.parametrize("cheat", CHEATS, ids=lambda cheat: cheat.__name__)
def test_a_cheat_is_refused(cheat: Callable[[Script], None]) -> None:
    script = Script()
    cheat(script)
    outcome = script.end()
    assert not outcome.success
    assert outcome.failures[0].name == CHEATS[cheat], outcome.failures


# --- planned and driven


def test_peg_and_socket_may_touch_in_the_last_move_only() -> None:
    draw = DRAWS[0]
    solution = solve(TASK, draw, State(DUAL_PANDA.home, start_of(draw)), Planner())
    moving = [segment for segment in solution.segments if segment.scene is not None]
    assert list(dict.fromkeys(segment.phase for segment in moving)) == [
        "approach",
        "descend",
        "lift",
        "carry",
        "insert",
    ]
    for segment in moving:
        assert segment.verification.ok
        if segment.phase not in ("approach", "descend"):  # lying, neither moves
            allowed = "one goes into the other" if segment.phase == "insert" else None
            assert segment.scene.why_unchecked(PEG, SOCKET) == allowed
    np.testing.assert_allclose(solution.states[-1].objects[PEG], draw.goal[PEG])
    tips = Kinematics(DUAL_PANDA).tcp_poses(solution.segments[-1].trajectory.q[-1])
    np.testing.assert_allclose(
        tips[1],
        draw.goal[PEG] @ TASK.objects[PEG].grasps["right"],
        atol=1e-3,
    )


def test_the_supervisor_knows_what_each_hand_holds() -> None:
    shapes = [thing_of(BODIES[name]).shape for name in (SOCKET, PEG)]
    clearance = SceneClearance(DUAL_PANDA, *shapes)
    low = DUAL_PANDA.home.copy()
    solver = solvers(DUAL_PANDA)["right"]
    low[solver.joints] = solver.solve(
        pose(rot_z(np.pi / 2) @ rot_x(np.pi), (0.45, -0.28, 0.10)),
        low[solver.joints],
    ).q
    clearance.hold(
        1,
        pose(rot_x(np.pi / 2), (0.0, 0.0, 0.0)),
    )  # the peg points down, into the table
    pair, distance, _ = clearance(low)
    assert "peg in the right hand" in pair
    assert "table" in pair
    assert distance < 0.02
    clearance.hold(0, np.eye(4))
    assert clearance(low)[0] == pair


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench("moveit", MethodInputs(TASK.config, TASK.config.seed))


def test_driven_the_peg_goes_in(bench: Bench) -> None:
    phases: list[str] = []
    trial = TASK.trial(TASK.config.seed, "driven", 0)
    result, _ = bench.run(trial, on_step=lambda _, method: phases.append(method.phase))
    assert result.success, result.text
    assert result.measured["progress"] == 1.0
    assert result.measured["depth_m"] > DEPTH_M
    assert result.measured["insertion_force_max_n"] < 40.0
    assert phases[-1] == "settle"


@pytest.fixture(scope="module")
def soft() -> Bench:
    return Bench("impedance", MethodInputs(TASK.config, TASK.config.seed))


def controllers_of(
    bench: Bench,
    trial: Trial,
) -> tuple[Any, dict[str, set[tuple[str, ...]]], float]:
    """Return a trial's result, each phase's controllers, and the right hand's last peak force."""
    active: dict[str, set[tuple[str, ...]]] = {}
    forces = [0.0]

    def look(world: World, method: Any) -> None:
        if method.stack.executing:
            active.setdefault(method.phase, set()).add(method.stack.manager.active)
        if method.phase in ("insert", "settle"):
            forces.append(float(np.linalg.norm(world.truth(PEG).forces()[1])))

    result, _ = bench.run(trial, on_step=look)
    return result, active, max(forces)


def test_by_impedance_the_right_hand_alone_is_soft_and_presses_little(soft: Bench) -> None:
    """It goes straight in: without the search that the plan of `moveit` has."""
    result, active, force_n = controllers_of(soft, TASK.trial(TASK.config.seed, "driven", 0))
    assert result.success, result.text
    assert result.measured["depth_m"] > AIM_M
    assert force_n < 5.0
    by_position = {
        phase: {("both_arms",)} for phase in ("approach", "descend", "close", "lift", "carry")
    }
    by_force = {phase: {("left_arm", "right_hand")} for phase in ("insert", "settle")}
    assert {
        "settle": by_force["settle"],
    } | active == by_position | by_force  # it may be deep enough before it settles


def test_a_peg_that_lies_further_back_than_it_seems_is_pushed_deep_enough(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The camera of trial 2 is off: pushed 6 mm beyond the aim, the peg stays 7 mm short."""
    bench = Bench("impedance", MethodInputs(TASK.config, TASK.config.seed), "randomised")
    trial = TASK.trial(TASK.config.seed, "benchmark", 2)
    found, _ = bench.run(trial)
    assert found.success, found.text
    monkeypatch.setattr(inserting, "_DRIVEN_M", 0.006)
    missed, _ = bench.run(trial)
    assert (missed.failure, missed.measured["depth_m"]) == (
        "mated",
        pytest.approx(0.023, abs=0.002),
    )


def stiff_joint(method: str) -> Bench:
    return Bench(method, MethodInputs(TASK.config, TASK.config.seed), "joint friction x2")


@pytest.mark.slow
def test_by_impedance_the_peg_goes_in_where_the_search_of_moveit_fails() -> None:
    trial = TASK.trial(TASK.config.seed, "benchmark", 13)
    missed, _ = stiff_joint("moveit").run(trial)
    assert not missed.success
    found, _, force_n = controllers_of(stiff_joint("impedance"), trial)
    assert found.success, found.text
    assert force_n < 25.0


@pytest.mark.slow
def test_the_search_finds_a_bore_that_a_straight_move_misses(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With a stiff joint, the tip of trial 40 meets the rim."""
    bench = stiff_joint("moveit")
    trial = TASK.trial(TASK.config.seed, "benchmark", 40)
    found, _ = bench.run(trial)
    assert found.success, found.text
    monkeypatch.setattr(inserting, "_spiral", lambda T: ())
    missed, _ = bench.run(trial)
    assert not missed.success
    assert missed.measured["depth_m"] == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", [PlannedCarry, CompliantCarry])
def test_with_the_left_arm_frozen_the_right_one_wins_nothing(kind: type[PlannedCarry]) -> None:
    """It does all it can: it puts the peg into the socket that lies on the table."""
    trial = dataclasses.replace(
        DRAWS[0],
        start={PEG: (0.45, -0.12, 0.0), SOCKET: (0.45, 0.16, 0.0)},
    )
    depths_m = (-BEFORE_M, 0.0015, AIM_M)
    before, *way = (start_of(trial)[SOCKET] @ in_socket(y=depth_m) for depth_m in depths_m)
    right = ("right",)
    steps = [Step(phase, right, (PEG,)) for phase in ("approach", "descend", "close", "lift")]
    steps += [
        Step("carry", right, (PEG,), ({PEG: before},)),
        Step("insert", right, (PEG, SOCKET), tuple(way)),
    ]
    task = dataclasses.replace(TASK, arrange=None, steps=tuple(steps))
    world = World(TASK.scene)
    judge = begin(world, TASK, trial)
    carry = kind(
        ControlStack(world, Kinematics()),
        Planner(),
        task,
        trial,
        1,
        poses=true_poses(world, task),
    )
    assert carry.solution is not None
    while not carry.done and world.time < TASK.time_limit_s:
        carry.step()
        judge.observe(world)
    outcome = judge.outcome(world)
    assert not outcome.success
    assert {"aloft", "mated"} <= {failure.name for failure in outcome.failures}
    assert judge.stages == ()
