"""Whatever fails in the control loop, the tick has its torque, the arms stop softly and the fault has its name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from minidual.config.scene import SceneConfig
from minidual.control.commands import JointCommand, ObjectCommand, TrajectoryCommand
from minidual.control.controller_manager import ControllerSwitchError
from minidual.control.reflexes import ReflexError
from minidual.control.stack import OBJECT_CONTROLLERS, ControlStack
from minidual.control.supervisor import Supervisor
from minidual.errors import UsageError
from tests.support.control_plant import HandsObject
from tests.support.panda import HOME, TAU_RATE_MAX
from tests.support.random_driver import Path, jumps
from tests.support.stacks import (
    CLOSED,
    FailingPlant,
    breaks,
    hand_over,
    move,
    stack_on,
    trajectory,
    under_way,
)


@pytest.fixture
def plant(scene: SceneConfig) -> FailingPlant:
    return FailingPlant(scene)


def stopped(plant: FailingPlant, stack: ControlStack, steps: int = 1500) -> ReflexError:
    """Step on; return the only reflex. Every tick must have its torque, near the last one."""
    caught: list[ReflexError] = []
    told = len(plant.torques)
    fastest = np.abs(plant.v).max()
    for _ in range(steps):
        try:
            stack.affirm("moveit")
            stack.step()
        except ReflexError as error:
            caught.append(error)
    torques = np.array(plant.torques[told - 1 :])
    assert len(torques) == steps + 1, "a tick without torque"
    assert np.isfinite(torques).all()
    assert np.abs(np.diff(torques, axis=0)).max() <= TAU_RATE_MAX * plant.dt + 1e-9
    plant.lies.clear()
    assert np.abs(np.diff(torques, axis=0)).max() > 0.0
    assert np.abs(plant.v).max() < 0.05 < fastest, "not at rest"
    assert len(caught) == 1
    return caught[0]


def controller(plant: FailingPlant, stack: ControlStack) -> None:
    stack.manager["both_arms"].update = breaks  # type: ignore[method-assign]


def acceleration(plant: FailingPlant, stack: ControlStack) -> None:
    stack.manager.update = breaks  # type: ignore[method-assign]


def reading(name: str) -> Callable[[FailingPlant, ControlStack], None]:
    def fail(plant: FailingPlant, stack: ControlStack) -> None:
        plant.lies[name] = breaks

    return fail


def monitor(plant: FailingPlant, stack: ControlStack) -> None:
    stack.supervisor.distance[0] = breaks  # type: ignore[union-attr]


def listener(plant: FailingPlant, stack: ControlStack) -> None:
    stack.on_flush(breaks)
    stack.request("teleop")


def source(plant: FailingPlant, stack: ControlStack) -> None:
    stack.fail(ZeroDivisionError("the bus is gone"))


def trajectory_in_braking(plant: FailingPlant, stack: ControlStack) -> None:
    motion = stack.output.executions[0].command.motion
    object.__setattr__(motion, "sample", breaks)
    stack.request("hold")


FAILURES: dict[str, Callable[[FailingPlant, ControlStack], None]] = {
    "a controller": controller,
    "the controller manager": acceleration,
    "positions": reading("q"),
    "the stamp": reading("stamp_s"),
    "the health": reading("health"),
    "the gripper's force": reading("grip"),
    "a monitor": monitor,
    "a flush listener": listener,
    "a source": source,
    "a trajectory": trajectory_in_braking,
}


@pytest.mark.parametrize("what", FAILURES)
def test_an_exception_in_the_loop_is_a_soft_stop_and_leaves_no_tick_without_torque(
    plant: FailingPlant,
    what: str,
) -> None:
    """Before, each of these left `step` by its exception, before the plant was commanded."""
    stack = under_way(plant)
    FAILURES[what](plant, stack)
    error = stopped(plant, stack)
    assert error.reflex.label == "controller_failed"
    assert "ZeroDivisionError: the bus is gone" in error.message
    assert stack.reflex is error


CLOCKS: dict[str, Callable[[float], Callable[[float], float]]] = {
    "stands": lambda began: lambda t: min(t, began + 0.05),
    "jumps back": lambda began: lambda t: t - 0.3 * (t > began + 0.05),
    "is NaN": lambda began: lambda t: np.nan if t > began + 0.05 else t,
    "fails": lambda began: lambda t: breaks() if t > began + 0.05 else t,
}


@pytest.mark.parametrize("what", CLOCKS)
def test_a_clock_that_fails_is_a_soft_stop(plant: FailingPlant, what: str) -> None:
    """Before, UsageError left the tick without torque."""
    stack = under_way(plant)
    plant.lies["time"] = CLOCKS[what](plant.time)
    error = stopped(plant, stack)
    assert error.reflex.label == "measurement.clock"


def test_a_clock_that_fails_after_the_encoders_leaves_a_stop_that_sees(plant: FailingPlant) -> None:
    """Before, a stamp of NaN made the replaced positions NaN, and the stop kept its last torque."""
    stack = under_way(plant)
    plant.lies["q"], began = breaks, plant.time
    plant.lies["time"] = plant.lies["stamp_s"] = lambda t: np.nan if t > began + 0.1 else t
    assert stopped(plant, stack).reflex.label == "controller_failed"


def test_a_clock_that_jumps_ahead_is_a_soft_stop(plant: FailingPlant) -> None:
    stack = under_way(plant)
    began = plant.time
    plant.lies["time"] = lambda t: t + 0.5 * (t > began + 0.05)
    assert stopped(plant, stack).reflex.label == "stale_command"


@pytest.mark.parametrize("stamp", [np.inf, 100.0])
def test_a_stamp_of_the_future_is_a_soft_stop(plant: FailingPlant, stamp: float) -> None:
    """Before, an infinite one left a tick without torque, and one second ahead was not noticed."""
    stack = under_way(plant)
    plant.lies["stamp_s"] = lambda t: stamp
    error = stopped(plant, stack)
    assert error.reflex.label == "controller_failed"
    assert "the measurements are" in error.message


def test_arms_that_were_measured_a_second_ago_do_not_recover(plant: FailingPlant) -> None:
    """Before, the next tick stopped them again."""
    stack = under_way(plant)
    plant.lies["stamp_s"] = lambda t: t - 1.0
    assert stopped(plant, stack).reflex.label == "controller_failed"
    plant.lies["stamp_s"] = lambda t: t - 1.0
    with pytest.raises(UsageError, match="measured 1000 ms ago"):
        stack.recover()
    assert stack.reflex is not None
    plant.lies.clear()
    stack.recover()
    for _ in range(100):
        stack.step()
    assert stack.reflex is None


@pytest.mark.parametrize("bias", [0.3, 1.0])
def test_a_velocity_that_lies_does_not_drive_the_arm(plant: FailingPlant, bias: float) -> None:
    """Before, the model took over from the wrong velocity: 3.8 rad/s and 1 rad (4.2 rad/s)."""
    stack = stack_on(plant, supervisor=Supervisor(dt_s=plant.dt))
    for _ in range(100):
        stack.step()
    plant.lies["v"] = lambda v: v + bias * np.eye(14)[1]
    fastest = 0.0
    way = 0.0
    names = []
    for _ in range(1500):
        try:
            stack.step()
        except ReflexError as error:
            names.append(error.reflex.label)
        fastest = max(fastest, float(np.abs(plant.__dict__["v"]).max()))
        way = max(way, float(np.abs(plant.__dict__["q"] - HOME).max()))
    assert len(names) == 1
    assert fastest < 0.6
    assert way < 0.12


@pytest.mark.parametrize("joint", [2, 9])
def test_a_push_on_frozen_positions_does_not_cost_the_velocity(
    plant: FailingPlant,
    joint: int,
) -> None:
    """Before, the push counted as a lying velocity and the stop was blind: 63 rad/s; now below 1.3."""
    stack = stack_on(plant, supervisor=Supervisor(dt_s=plant.dt))
    for _ in range(50):
        stack.step()
    frozen = plant.q
    names = []
    fastest = 0.0
    plant.lies["q"] = lambda q: frozen
    for tick in range(1500):
        plant.v = plant.v + (0.04 if tick < 30 else 0.0) * np.eye(14)[joint]
        try:
            stack.step()
        except ReflexError as error:
            names.append(error.reflex.label)
        fastest = max(fastest, float(np.abs(plant.v).max()))
    assert names == ["contact.joint"]
    assert 0.3 < fastest < 1.3, fastest
    assert np.abs(plant.v).max() < 0.05


@pytest.mark.parametrize(("period", "phase"), [(1, 0), (2, 1), (4, 3), (20, 2)])
def test_contact_is_felt_whatever_the_phase_of_the_measurements(period: int, phase: int) -> None:
    """Before, states of every second tick or rarer were never compared unless they came in the right one."""
    supervisor = Supervisor()
    rng = np.random.default_rng(0)
    name = ""
    stamp_s = 0.0
    gravity = np.array(supervisor._kinematics.gravity(HOME))
    q = HOME
    v = np.zeros(14)
    for tick in range(1, 400):
        if tick == 1 or tick % period == phase:
            stamp_s = 1e-3 * tick
            (q, v) = (HOME, np.zeros(14)) + 1e-6 * rng.standard_normal((2, 14))
        try:
            supervisor.guard(
                1e-3 * tick,
                q,
                v,
                gravity + min(40.0, 0.5 * tick) * np.eye(14)[1],
                None,
                stamp_s,
            )
        except ReflexError as error:
            name = error.reflex.label
            break
    assert name in ("contact.joint", "contact.stuck", "contact.hand")


def carrying(plant: FailingPlant) -> tuple[ControlStack, Path]:
    here = HandsObject(plant)
    stack = stack_on(plant, sensor=here, supervisor=Supervisor(dt_s=plant.dt))
    stack.impedance.configure(here.held())
    hand_over(stack, "moveit", OBJECT_CONTROLLERS)
    return stack, Path(here.pose())


@pytest.mark.parametrize(
    ("lie", "named"),
    [(breaks, "ZeroDivisionError: the bus is gone"), (jumps, "path jumps")],
)
def test_an_object_path_that_changes_after_it_was_accepted_is_a_soft_stop(
    plant: FailingPlant,
    lie: Any,
    named: str,
) -> None:
    stack, path = carrying(plant)
    assert (
        stack.propose("moveit", ObjectCommand(path, lambda t: 0.0, CLOSED, plant.time, 1)) is None
    )
    for _ in range(300):
        stack.affirm("moveit")
        stack.step()
    assert np.abs(plant.v).max() > 0.1
    path.lie = lie
    error = stopped(plant, stack)
    assert error.reflex.label == "controller_failed"
    assert named in error.message


def test_an_object_path_that_jumps_is_refused(plant: FailingPlant) -> None:
    stack, path = carrying(plant)
    path.lie = jumps
    refusal = stack.propose("moveit", ObjectCommand(path, lambda t: 0.0, CLOSED, plant.time, 1))
    assert refusal is not None
    assert refusal.name == "pose_jump"
    assert refusal.detail.startswith("50 mm")


def test_what_a_source_does_to_its_arrays_after_the_proposal_changes_nothing(
    plant: FailingPlant,
) -> None:
    """Before, the target moved to NaN or past the limits without a check."""
    stack = stack_on(plant, supervisor=Supervisor(dt_s=plant.dt))
    hand_over(stack, "teleop")
    q = HOME + 0.01
    gripper = np.zeros(2)
    assert stack.propose("teleop", JointCommand(q, gripper, plant.time, 1)) is None
    q[:] = np.nan
    gripper[:] = 5.0
    for _ in range(20):
        stack.step()
    assert np.array_equal(stack.output.q_target, HOME + 0.01)
    assert np.array_equal(stack.output.gripper, CLOSED)
    openings = np.ones(2)
    stack.halt("teleop", openings)
    openings[:] = np.nan
    stack.step()
    assert np.array_equal(stack.output.gripper, np.ones(2))


def test_a_trajectory_is_the_arbiters_own(plant: FailingPlant) -> None:
    stack = stack_on(plant, supervisor=Supervisor(dt_s=plant.dt))
    hand_over(stack, "moveit")
    command = trajectory(stack, move(HOME, HOME + 0.1, 0.5), gripper=np.ones(2))
    assert isinstance(command, TrajectoryCommand)
    assert stack.propose("moveit", command) is None
    for values in (command.motion.q, command.motion.v, command.motion.a, command.gripper):
        values[:] = np.nan
    for _ in range(700):
        stack.affirm("moveit")
        stack.step()
    assert np.abs(plant.q - HOME - 0.1).max() < 1e-3


def test_without_a_supervisor_the_error_is_the_callers(plant: FailingPlant) -> None:
    stack = stack_on(plant)
    plant.lies["q"] = breaks
    told = len(plant.torques)
    with pytest.raises(ZeroDivisionError):
        stack.step()
    plant.lies.clear()
    with pytest.raises(UsageError, match="a source gave up"):
        stack.fail(UsageError("a source gave up"))
    for _ in range(100):
        stack.step()
    assert len(plant.torques) - told == 101
    assert np.abs(plant.q - HOME).max() < 1e-3


@pytest.mark.parametrize("names", [("left_hand", "right_hand"), ("left_arm", "right_arm")])
def test_arms_that_are_not_measured_may_not_switch_their_controllers(
    plant: FailingPlant,
    names: tuple[str, ...],
) -> None:
    """The law of a hand raised numpy's "Eigenvalues did not converge"; a joint controller started at NaN."""
    stack = stack_on(plant, supervisor=Supervisor(dt_s=plant.dt))
    stack.step()
    plant.lies["q"] = lambda q: q * np.nan
    with pytest.raises(ControllerSwitchError, match="not_ready: the arms are not measured"):
        stack.switch_controllers(names)
    assert stack.manager.active == ("both_arms",)
    plant.lies.clear()
    stack.switch_controllers(names)
    assert stack.manager.active == names
