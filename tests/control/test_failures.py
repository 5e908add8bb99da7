"""Whatever fails in the control loop, the tick has its torque, the arms stop softly and the fault has its name."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from minidual.config.scene import SceneConfig
from minidual.control.commands import ArbiterState, JointCommand, ObjectCommand
from minidual.control.reflexes import ReflexError
from minidual.control.stack import DEFAULT_CONTROLLERS, OBJECT_CONTROLLERS, ControlStack
from minidual.control.supervisor import Supervisor
from minidual.errors import UsageError
from minidual.plant.protocol import PlantEndedError
from minidual.robot.pair import Array
from tests.support.control_plant import HandsObject
from tests.support.panda import HOME, TAU_RATE_MAX
from tests.support.random_driver import Path, jumps
from tests.support.stacks import (
    APART,
    CLOSED,
    OPEN,
    Arms,
    FailingPlant,
    breaks,
    hand_height_m,
    hand_over,
    in_motion,
    move,
    run,
    stack_on,
    supervised,
    trajectory,
    under_way,
)


@pytest.fixture
def plant(scene: SceneConfig) -> FailingPlant:
    return FailingPlant(scene)


def stopped(plant: FailingPlant, stack: ControlStack, ticks: int = 1000) -> ReflexError:
    """Step on to rest; return the only reflex. Every tick must have its torque, near the last one."""
    reflexes: list[ReflexError] = []
    commands_n = len(plant.torques)
    fastest = np.abs(plant.true_v).max()
    for _ in range(ticks):
        try:
            stack.step()
        except ReflexError as error:
            reflexes.append(error)
    torques = np.array(plant.torques[commands_n - 1 :])
    assert len(torques) == ticks + 1, "a tick without torque"
    assert np.isfinite(torques).all()
    assert np.abs(np.diff(torques, axis=0)).max() <= TAU_RATE_MAX * plant.dt + 1e-9
    plant.lies.clear()
    assert np.abs(plant.v).max() < 0.05 < fastest, "not at rest"
    assert len(reflexes) == 1
    return reflexes[0]


# What the loop calls ----------------------------------------------------------------------------------------


def controller(plant: FailingPlant, stack: ControlStack) -> None:
    stack.manager["both_arms"].update = breaks  # type: ignore[method-assign]


def manager(plant: FailingPlant, stack: ControlStack) -> None:
    stack.manager.update = breaks  # type: ignore[method-assign]


def expectation(plant: FailingPlant, stack: ControlStack) -> None:
    stack.supervisor.expected = breaks


def monitor(plant: FailingPlant, stack: ControlStack) -> None:
    stack.supervisor.distance[0] = breaks  # type: ignore[attr-defined]


def listener(plant: FailingPlant, stack: ControlStack) -> None:
    stack.on_flush(breaks)
    stack.request("teleop")


def source(plant: FailingPlant, stack: ControlStack) -> None:
    stack.fail(ZeroDivisionError("the bus is gone"))


def trajectory_in_braking(plant: FailingPlant, stack: ControlStack) -> None:
    motion = stack.output.executions[0].command.motion
    object.__setattr__(motion, "sample", breaks)
    stack.request("hold")


def reading(name: str) -> Callable[[FailingPlant, ControlStack], None]:
    def fail(plant: FailingPlant, stack: ControlStack) -> None:
        plant.lies[name] = breaks

    return fail


FAILURES: dict[str, tuple[str, Callable[[FailingPlant, ControlStack], None]]] = {
    "a controller": ("controller_failed", controller),
    "the controller manager": ("controller_failed", manager),
    "what the supervisor expects": ("controller_failed", expectation),
    "a monitor": ("controller_failed", monitor),
    "a flush listener": ("controller_failed", listener),
    "a source": ("controller_failed", source),
    "a trajectory": ("controller_failed", trajectory_in_braking),
    "positions": ("plant_failed", reading("q")),
    "the clock": ("plant_failed", reading("time")),
    "the stamp": ("plant_failed", reading("stamp_s")),
    "the health": ("plant_failed", reading("health")),
    "the grip": ("plant_failed", reading("grip")),
}


@pytest.mark.parametrize("what", FAILURES)
def test_an_exception_in_the_loop_is_a_soft_stop_and_leaves_no_tick_without_torque(
    plant: FailingPlant,
    what: str,
) -> None:
    label, fail = FAILURES[what]
    stack = under_way(plant)
    fail(plant, stack)
    error = stopped(plant, stack)
    assert error.reflex.label == label
    assert "ZeroDivisionError: the bus is gone" in error.message
    assert stack.reflex is error


@pytest.mark.parametrize("what", ["a controller", "a source", "positions"])
def test_a_stack_without_bounds_stops_for_failures_too(plant: FailingPlant, what: str) -> None:
    label, fail = FAILURES[what]
    stack = stack_on(plant)
    hand_over(stack, "moveit")
    assert stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.4, 0.8))) is None
    assert run(stack, 400) == []
    fail(plant, stack)
    assert stopped(plant, stack).reflex.label == label
    assert stack.source is None
    with pytest.raises(UsageError, match="may not drive"):
        stack.request("moveit")


@pytest.mark.parametrize("answer", [None, ("a", None), ("a", 1.0, 2.0)])
def test_a_monitor_with_a_wrong_answer_is_a_soft_stop(plant: FailingPlant, answer: Any) -> None:
    stack = under_way(plant)
    stack.supervisor.distance[0] = lambda q: answer  # type: ignore[attr-defined]
    assert stopped(plant, stack).reflex.label == "controller_failed"


def test_an_infinite_distance_is_no_failure(scene: SceneConfig) -> None:
    plant = FailingPlant(scene)
    supervisor = Supervisor(dt_s=plant.dt, self_distance=lambda q: ("none", math.inf))
    stack = stack_on(plant, supervisor=supervisor)
    assert run(stack, 30) == []
    assert len(plant.torques) == 30


def test_a_failure_before_a_recovery_or_a_refused_reset_is_not_forgotten(
    plant: FailingPlant,
) -> None:
    stack = under_way(plant)
    stack.fail(RuntimeError("the camera is gone"))
    with pytest.raises(UsageError, match="control starts at rest"):
        stack.reset()
    assert run(stack, 500) == ["controller_failed"]
    stack.fail(RuntimeError("the gripper is gone"))
    stack.recover()
    assert run(stack, 5) == ["controller_failed"]
    assert "the gripper is gone" in str(stack.reflex)


CLOCKS: dict[str, tuple[str, Callable[[float], Callable[[float], float]]]] = {
    "stands": ("measurement.clock", lambda began: lambda t: min(t, began + 0.05)),
    "jumps back": ("measurement.clock", lambda began: lambda t: t - 0.3 * (t > began + 0.05)),
    "is NaN": ("measurement.clock", lambda began: lambda t: np.nan if t > began + 0.05 else t),
    "jumps ahead": ("stale", lambda began: lambda t: t + 0.5 * (t > began + 0.05)),
}


@pytest.mark.parametrize("what", CLOCKS)
def test_a_clock_that_fails_is_a_soft_stop(plant: FailingPlant, what: str) -> None:
    label, lie = CLOCKS[what]
    stack = under_way(plant)
    plant.lies["time"] = lie(plant.time)
    assert label in stopped(plant, stack).reflex.label


def test_a_dead_source_is_noticed_on_a_clock_below_zero(scene: SceneConfig) -> None:
    plant = Arms(scene)
    plant.lies["time"] = lambda t: t - 100.0
    stack = supervised(plant)
    hand_over(stack, "moveit")
    stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.4, 0.8)))
    stack.dead = True  # type: ignore[attr-defined]
    run(stack, 800)
    assert np.abs(plant.q - HOME).max() < 0.1


@pytest.mark.parametrize("late_ms", range(0, 20, 7))
def test_a_loop_that_stood_still_is_told_from_a_silent_arbiter(
    scene: SceneConfig,
    late_ms: int,
) -> None:
    plant = Arms(scene)
    stack = supervised(plant)
    hand_over(stack, "moveit")
    assert run(stack, 100 + late_ms) == []
    for _ in range(70):
        plant.step()  # the motors keep their torque
    assert run(stack, 100) == [], "0.07 s are no reflex"
    for _ in range(150):
        plant.step()
    message = r"stale_command at .*: no control step \(0.15 s, bound 0.1 s\)"
    with pytest.raises(ReflexError, match=message):
        stack.step()
    assert run(stack, 300) == []
    assert np.abs(plant.v).max() < 0.01


# The plant --------------------------------------------------------------------------------------------------


class Linked(Arms):
    """Arms on a link: `fails[call]` is how often a call fails, and by which error."""

    def __init__(self, scene: SceneConfig) -> None:
        self.fails: dict[str, tuple[int, Exception]] = {}
        super().__init__(scene)

    def _may_fail(self, call: str) -> None:
        left, error = self.fails.get(call, (0, OSError()))
        if left:
            self.fails[call] = left - 1, error
            raise error

    def command(self, tau: Array, fingers: Array) -> None:
        self._may_fail("command")
        super().command(tau, fingers)

    def step(self) -> None:
        super().step()
        self._may_fail("step")


DOWN = OSError("the link is down")


@pytest.mark.parametrize("call", ["command", "step"])
@pytest.mark.parametrize("times", [1, 5])
def test_a_call_of_the_plant_that_fails_stops_the_arms_by_its_name(
    scene: SceneConfig,
    call: str,
    times: int,
) -> None:
    plant = Linked(scene)
    stack = in_motion(plant)
    plant.fails[call] = times, DOWN
    began = plant.q.copy()
    assert run(stack, 1000) == ["controller_failed"]
    assert stack.reflex is not None
    assert "OSError: the link is down" in stack.reflex.message
    assert np.abs(plant.v).max() < 0.01
    assert np.abs(plant.q - began).max() < 0.12, "of 0.3 rad that were left"


@pytest.mark.parametrize("pressed", [False, True])
def test_torques_go_on_from_the_last_ones_taken_when_the_link_returns(
    scene: SceneConfig,
    pressed: bool,
) -> None:
    plant = Linked(scene)
    stack = in_motion(plant)
    if pressed:
        stack.supervisor.estop()
        run(stack, 30)
    plant.fails["command"] = 40, DOWN
    began = len(plant.torques) - 1
    assert run(stack, 1000) == ([] if pressed else ["controller_failed"])
    assert np.abs(np.diff(plant.torques[began:], axis=0)).max() < 1.0 + 1e-9
    assert np.abs(plant.v).max() < 0.01


def test_a_reflex_is_raised_also_if_its_first_command_fails(scene: SceneConfig) -> None:
    plant = Linked(scene)
    stack = in_motion(plant)
    stack.supervisor.estop()
    plant.fails["command"] = 1, DOWN
    assert run(stack, 1000) == ["emergency_stop"]
    assert np.abs(plant.v).max() < 0.01


@pytest.mark.parametrize("call", ["command", "step"])
def test_the_error_of_a_plant_that_has_ended_is_raised(scene: SceneConfig, call: str) -> None:
    plant = Linked(scene)
    stack = supervised(plant)
    run(stack, 10)
    plant.fails[call] = 1, PlantEndedError("diverged")
    with pytest.raises(PlantEndedError):
        stack.step()


@pytest.mark.parametrize("ill", [False, True])
def test_arms_of_a_plant_that_calls_itself_ill_hold_what_they_bear(
    scene: SceneConfig,
    ill: bool,
) -> None:
    plant = Arms(scene)
    stack = supervised(plant)
    run(stack, 100)
    if ill:
        plant.health = "too warm"
    else:
        stack.supervisor.estop()
    assert run(stack, 100) == ["plant_failed" if ill else "emergency_stop"]
    began_m = hand_height_m(plant, 1)
    for _ in range(1500):
        plant.pushed = -6.0 * stack.kinematics.tcp_jacobians(plant.true_q)[1][2]
        run(stack, 1)
    assert hand_height_m(plant, 1) > began_m - 0.03


# Sources ----------------------------------------------------------------------------------------------------


def test_a_source_cannot_change_a_command_that_was_accepted(plant: FailingPlant) -> None:
    stack = supervised(plant)
    hand_over(stack, "teleop")
    q = HOME + 0.01
    gripper = np.zeros(2)
    assert stack.propose("teleop", JointCommand(q, gripper, plant.time, 1)) is None
    q[:] = np.nan
    gripper[:] = 5.0
    run(stack, 20)
    np.testing.assert_array_equal(stack.output.q_target, HOME + 0.01)
    np.testing.assert_array_equal(stack.output.gripper, CLOSED)
    openings = np.ones(2)
    stack.halt("teleop", openings)
    openings[:] = np.nan
    run(stack, 1)
    np.testing.assert_array_equal(stack.output.gripper, OPEN)


def test_a_source_cannot_change_a_trajectory_that_was_accepted(plant: FailingPlant) -> None:
    stack = supervised(plant)
    hand_over(stack, "moveit")
    command = trajectory(stack, move(HOME, HOME + 0.1, 0.5), gripper=np.ones(2))
    assert stack.propose("moveit", command) is None
    for values in (command.motion.q, command.motion.v, command.motion.a, command.gripper):
        values[:] = np.nan
    assert run(stack, 700) == []
    assert np.abs(plant.q - HOME - 0.1).max() < 1e-3


def test_who_reads_the_output_cannot_drive_with_it(plant: FailingPlant) -> None:
    stack = supervised(plant)
    hand_over(stack, "teleop")
    stack.propose("teleop", JointCommand(HOME, CLOSED, plant.time, 1))
    assert run(stack, 100) == []
    stack.request("hold")
    for _ in range(500):
        assert run(stack, 1) == []
        stack.output.q_target[3] += 0.5
        stack.output.gripper[:] = 1.0
    assert np.abs(plant.q - HOME).max() < 1e-3
    assert plant.fingers.max() < 0.01


# Object paths -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lie", "text"),
    [(breaks, "ZeroDivisionError: the bus is gone"), (jumps, "path jumps")],
)
def test_an_object_path_that_changes_after_it_was_accepted_is_a_soft_stop(
    plant: FailingPlant,
    lie: Any,
    text: str,
) -> None:
    here = HandsObject(plant)
    stack = supervised(plant, sensor=here)
    stack.impedance.configure(here.held())
    hand_over(stack, "moveit", OBJECT_CONTROLLERS)
    path = Path(here.pose())
    command = ObjectCommand(path, lambda t: 0.0, CLOSED, plant.time, 1)
    assert stack.propose("moveit", command) is None
    run(stack, 300)
    assert np.abs(plant.v).max() > 0.1
    path.lie = lie
    error = stopped(plant, stack)
    assert error.reflex.label == "controller_failed"
    assert text in error.message
    stack.switch_controllers(DEFAULT_CONTROLLERS)
    stack.recover()
    assert stack.state is not ArbiterState.STOPPED
    hand_over(stack, "moveit")
    assert (
        stack.propose("moveit", trajectory(stack, move(plant.q, plant.q + 0.1 * APART, 1.0)))
        is None
    )
    assert run(stack, 500) == []
