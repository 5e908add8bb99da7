"""Stops that begin again, near limits and beside brakes; what hides a reflex or takes back a hold, with numbers before."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest

from minidual.config.control import ArbiterConfig, SupervisorConfig
from minidual.config.learning import TeleopConfig
from minidual.config.scene import SceneConfig
from minidual.control.commands import JointCommand
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.demos.leader import ScriptedLeader
from minidual.demos.session import TeleopSession, Tick
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.skills.operator import ScriptedOperator
from minidual.trials.modes import ModesDemo
from minidual.trials.modes_turns import SwitchError, Turn
from tests.support.carry_trials import carry_task, sample_trial
from tests.support.panda import A_MAX, HOME, Q_UPPER, V_MAX
from tests.support.stacks import OPEN, Arms, hand_over, move, run, stack_on, supervised, trajectory

APART = np.r_[np.full(7, 0.5), np.full(7, -0.5)]
WIDE = SupervisorConfig(workspace_m=((-2, 2), (-2, 2), (-2, 2.5)))
Lies = Mapping[str, Callable[[np.ndarray], np.ndarray]]


def in_motion(plant: Arms) -> ControlStack:
    """Return a stack whose arms move at 0.9 rad/s."""
    stack = supervised(plant)
    hand_over(stack, "moveit")
    stack.propose("moveit", trajectory(stack, move(HOME, HOME + APART, 1.0)))
    run(stack, 480)
    assert np.abs(plant.v).max() > 0.85
    return stack


def way(
    plant: Arms,
    stack: ControlStack,
    each: Callable[[int], None],
    joints: slice = slice(None),
) -> float:
    """Run 1.5 s; return the largest way [rad] of `joints`, which are at rest in the end."""
    began = plant.__dict__["q"].copy()
    most = 0.0
    for k in range(1500):
        each(k)
        run(stack, 1)
        most = max(most, float(np.abs(plant.__dict__["q"] - began)[joints].max()))
    assert np.abs(plant.__dict__["v"])[joints].max() < 0.05
    return most


def unmeasured(joint: int) -> Lies:
    nothing = lambda x: np.where(np.arange(14) == joint, np.nan, x)  # noqa: E731
    return {"q": nothing, "v": nothing}


@pytest.mark.parametrize("period", [2, 3, 5, 10, 20, 50])
def test_an_emergency_stop_brakes_while_a_joint_is_measured_now_and_then(
    scene: SceneConfig,
    period: int,
) -> None:
    """Before, each packet that came back began the stop anew, for all joints: 0.17 to 2.0 rad, at 0.65 rad/s after 2.5 s."""
    plant = Arms(scene)
    stack = in_motion(plant)
    assert stack.supervisor is not None
    stack.supervisor.estop()

    def flaky(k: int) -> None:
        plant.lies.clear()
        plant.lies.update(unmeasured(4) if k % period == 0 else {})

    assert way(plant, stack, flaky) < 0.12


@pytest.mark.parametrize(
    ("how", "beyond_rad"),
    [("halt", 0.03), ("guarded halt", 0.02), ("stop", 0.003)],
)
@pytest.mark.parametrize("joint", [0, 2, 4, 6])
def test_a_stop_that_begins_while_a_plan_brakes_before_a_limit_hardly_passes_it(
    scene: SceneConfig,
    joint: int,
    how: str,
    beyond_rad: float,
) -> None:
    """Before, up to 107 (halt), 75 (halt that a reflex took over) and 36 mrad (emergency stop)."""
    goal = HOME.copy()
    goal[joint] = Q_UPPER[joint] - 0.002
    start = goal - 0.5 * np.eye(14)[joint]
    span_s = 1.05 * max(1.875 * 0.5 / V_MAX[joint], np.sqrt(5.7735 * 0.5 / A_MAX[joint]))
    for share in (0.5, 0.65, 0.8):
        plant = Arms(scene)
        plant.reset(start)
        stack = stack_on(
            plant,
            supervisor=None if how == "halt" else Supervisor(WIDE, dt_s=plant.dt),
        )
        hand_over(stack, "moveit")
        assert stack.propose("moveit", trajectory(stack, move(start, goal, span_s))) is None
        run(stack, round(share * span_s / plant.dt))
        if how == "stop":
            assert stack.supervisor is not None
            stack.supervisor.estop()
        else:
            stack.halt("teleop")
        highest = -np.inf
        for _ in range(800):
            run(stack, 1)
            highest = max(highest, plant.__dict__["q"][joint])
        assert highest - Q_UPPER[joint] < beyond_rad, share
        assert np.abs(plant.v).max() < 0.05


class Braked(Arms):
    """Its own brakes can hold the arms."""

    locked = False

    def step(self) -> None:
        if not self.locked:
            return super().step()
        v = 0.9 * self.__dict__["v"]
        self.__dict__["v"] = v = np.where(np.abs(v) < 1e-3, 1e-6 * (-1.0) ** self.steps, v)
        self.__dict__["q"] = self.__dict__["q"] + self.dt * v
        self.steps += 1
        return None


@pytest.mark.parametrize("locked_ticks", [300, 1000])
def test_arms_that_the_plants_own_brakes_held_stay_when_these_open(
    scene: SceneConfig,
    locked_ticks: int,
) -> None:
    """Before, the stop's reference had gone on: 0.084 rad at 0.31 rad/s, after seconds at rest."""
    plant = Braked(scene)
    stack = in_motion(plant)
    plant.locked = True
    plant.health = "robot reflex"
    assert run(stack, locked_ticks) == ["controller_failed"]
    plant.locked = False
    plant.health = ""
    assert way(plant, stack, lambda k: None) < 0.002


def test_arms_that_a_plant_only_calls_ill_hold_what_they_bear(scene: SceneConfig) -> None:
    """Negative control: a stop that begins anew in every tick would only damp them, and they would sink."""
    sunk_m = []
    for health in ("", "too warm"):
        plant = Arms(scene)
        stack = stack_on(plant, supervisor=Supervisor(dt_s=plant.dt))
        assert stack.supervisor is not None
        run(stack, 200)
        stack.supervisor.estop()
        run(stack, 100)
        push = pressed(plant, 6.0)
        began_m = height_m(plant)
        for k in range(3000):
            plant.health = health if k < 2000 else ""
            push(k)
            run(stack, 1)
        sunk_m.append(began_m - height_m(plant))
    assert sunk_m[1] == pytest.approx(sunk_m[0], abs=0.01)
    assert sunk_m[0] < 0.03


@pytest.mark.parametrize("answer", [None, ("a", None), ("a", 1.0, 2.0)])
def test_a_monitor_with_a_wrong_answer_is_a_named_stop_with_a_torque_in_every_tick(
    scene: SceneConfig,
    answer: Any,
) -> None:
    """Before, 48 of 500 ticks had no torque, and the arms went on to the motion's end."""
    plant = Arms(scene)
    told = [("a with b", 1.0)]
    stack = stack_on(plant, supervisor=Supervisor(dt_s=plant.dt, self_distance=lambda q: told[0]))
    hand_over(stack, "moveit")
    stack.propose("moveit", trajectory(stack, move(HOME, HOME + APART, 1.0)))
    run(stack, 400)
    told[0] = answer
    before = len(plant.torques)
    assert run(stack, 500) == ["controller_failed"]
    assert len(plant.torques) == before + 500
    assert np.abs(plant.v).max() < 0.05
    assert np.abs(plant.q - HOME).max() < 0.4


@pytest.mark.parametrize("error", [SwitchError("refused"), ValueError("a planner broke")])
@pytest.mark.parametrize("blind", [False, True])
def test_a_demonstration_of_modes_ends_with_arms_at_rest(
    scene: SceneConfig,
    error: Exception,
    blind: bool,
) -> None:
    """Before, a reflex in the halt, or an error of another kind, left them at 0.94 rad/s without ticks."""
    plant: Any = Arms(scene)
    stack = ControlStack(plant, Kinematics(), supervisor=Supervisor(dt_s=plant.dt))

    def drive() -> Any:
        stack.propose("moveit", trajectory(stack, move(HOME, HOME + APART, 1.0)))
        for _ in range(500):
            stack.affirm("moveit")
            yield
        plant.lies.update(unmeasured(3) if blind else {})
        raise error

    demo = ModesDemo(stack, [Turn("moveit", "", drive)])
    with (
        nullcontext()
        if isinstance(error, SwitchError)
        else pytest.raises(ValueError, match="a planner broke")
    ):
        for _ in demo.steps():
            pass
    assert demo.ended == str(error)
    assert np.abs(plant.__dict__["v"]).max() < 0.05
    assert (stack.reflex is not None) is blind


@pytest.mark.parametrize("when", [45, 60])
def test_a_halt_in_a_teleoperated_episode_ends_it_as_stopped(scene: SceneConfig, when: int) -> None:
    """Before, `stale_command` was raised 0.1 s later, in place of the result."""
    config = TeleopConfig()
    world = World(scene)
    stack = ControlStack(
        world,
        Kinematics(),
        rate_hz=config.rate_hz,
        supervisor=Supervisor(dt_s=world.dt),
    )
    trial = sample_trial(scene, 7, "demonstrations", 0, widen=1.3)
    fastest = list[float]()

    def on_tick(_: Tick) -> None:
        fastest.append(float(np.abs(world.v).max()))
        if len(fastest) == when:
            stack.halt("teleop")

    leader = ScriptedLeader(ScriptedOperator(scene).plan(trial, seed=7))
    result = TeleopSession(stack, config).run(carry_task(scene), trial, leader, on_tick=on_tick)
    assert fastest[when - 1] > 0.8
    assert result.ended_by == "stopped"
    assert stack.reflex is None
    assert np.abs(world.v).max() < 0.05


def test_a_repeated_request_of_who_drives_takes_back_no_hold(scene: SceneConfig) -> None:
    """Before, the arms went on to the end of the trajectory: 0.27 in place of 0.08 rad."""
    plant = Arms(scene)
    stack = in_motion(plant)
    stack.request("hold")
    stack.request("moveit")
    assert way(plant, stack, lambda k: None) < 0.15
    assert [(r.source, r.name) for r in stack.refusals] == [("moveit", "superseded")]
    assert stack.source is None


def test_a_dead_source_is_noticed_on_a_clock_below_zero(scene: SceneConfig) -> None:
    """Before, its trajectory ran to the end: 0.4 rad in place of 0.05."""
    plant = Arms(scene)
    plant.lies["time"] = lambda t: t - 100.0
    stack = ControlStack(plant, Kinematics(), supervisor=Supervisor(dt_s=plant.dt))
    stack.request("moveit")
    for _ in range(60):
        stack.step()
    assert stack.source == "moveit"
    stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.4, 0.8)))
    for _ in range(1000):
        stack.step()
    assert np.abs(plant.q - HOME).max() < 0.1


@pytest.mark.parametrize("sets", [(), (("left_arm", "right_arm"),)])
def test_the_speed_override_holds_from_the_first_target_on(
    scene: SceneConfig,
    sets: tuple[Any, ...],
) -> None:
    """Before, joints reached 0.41 of full speed at an override of 0.1."""
    plant = Arms(scene)
    stack = stack_on(
        plant,
        config=ArbiterConfig(speed_override=0.1),
        supervisor=Supervisor(dt_s=plant.dt),
    )
    hand_over(stack, "teleop", *sets)
    fastest = 0.0
    number = 0
    for _ in range(600):
        if stack.tick_next:
            number += 1
            stack.propose("teleop", JointCommand(HOME + 0.099, OPEN, plant.time, number))
        stack.step()
        fastest = max(fastest, float(np.max(np.abs(plant.v) / V_MAX)))
    assert 0.05 < fastest < 0.13


def pressed(plant: Arms, force_n: float) -> Callable[[int], None]:
    """Return what pushes the right hand down before every tick."""
    kinematics = Kinematics()

    def push(_: int) -> None:
        plant.pushed[:] = -force_n * kinematics.tcp_jacobians(plant.__dict__["q"])[1][2]

    return push


def height_m(plant: Arms) -> float:
    return float(Kinematics().tcp_poses(plant.__dict__["q"])[1][2, 3])


@pytest.mark.parametrize("force_n", [4.0, 6.0])
def test_a_request_after_a_halt_throws_no_pressed_arm_back(
    scene: SceneConfig,
    force_n: float,
) -> None:
    """Before, the hand rose by 11 and 17 mm, joints at up to 0.37 rad/s, and nobody had commanded anything."""
    plant = Arms(scene)
    stack = stack_on(plant, supervisor=Supervisor(dt_s=plant.dt))
    hand_over(stack, "teleop")
    stack.halt("teleop")
    run(stack, 300)
    push = pressed(plant, force_n)
    fastest = 0.0
    for k in range(1500):
        push(k)
        run(stack, 1)
    before_m = height_m(plant)
    stack.request("moveit")
    for k in range(600):
        push(k)
        run(stack, 1)
        fastest = max(fastest, float(np.abs(plant.v).max()))
    assert abs(height_m(plant) - before_m) < 0.006
    assert fastest < 0.15


def test_a_loaded_arm_stays_while_the_other_one_changes_its_controller(scene: SceneConfig) -> None:
    """Before, its target was where it sagged to, each time anew: -26 mm after eight changes."""
    plant = Arms(scene)
    stack = stack_on(plant, supervisor=Supervisor(dt_s=plant.dt))
    hand_over(stack, "moveit", ("left_arm", "right_arm"))
    push = pressed(plant, 10.0)
    began_m = height_m(plant)
    heights_m = []
    for change in range(9):
        if change:
            stack.switch_controllers(("left_hand" if change % 2 else "left_arm", "right_arm"))
        for k in range(1500 if change == 0 else 600):
            push(k)
            run(stack, 1)
        heights_m.append(height_m(plant) - began_m)
    assert heights_m[0] < -0.002, "it sags under the load"
    assert min(heights_m) > heights_m[0] - 0.002


def test_refusals_of_days_are_counted_and_the_last_are_kept(scene: SceneConfig) -> None:
    """Before, all were kept: 740 MB a day of a source that is refused at 50 Hz."""
    stack = supervised(Arms(scene))
    began_n = stack.refused_n
    for k in range(1500):
        wrong = JointCommand(np.full(14, np.nan), OPEN, stack.plant.time, k + 1)
        assert stack.propose("teleop", wrong) is not None
        stack.arbitrate()
    assert stack.refused_n - began_n == 1500
    assert len(stack.refusals) == 1000
    assert stack.refused_since(stack.refused_n) == []
    assert stack.refused_since(stack.refused_n - 3) == stack.refusals[-3:]
    assert stack.refused_since(began_n) == stack.refusals
    stack.reset()
    assert (stack.refusals, stack.refused_n) == ([], 0)
