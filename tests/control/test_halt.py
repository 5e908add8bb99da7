"""A halt stops the arms where they are, whatever is under way; arms that are switched off are told nothing."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest

from minidual.config.control import ImpedanceConfig
from minidual.config.scene import SceneConfig
from minidual.control.commands import ArbiterState, JointCommand, ObjectCommand
from minidual.control.controller_manager import ControllerSwitchError
from minidual.control.execution import ObjectExecution
from minidual.control.payload import Payload
from minidual.control.reflexes import ReflexError
from minidual.control.stack import OBJECT_CONTROLLERS, ControlStack
from minidual.control.supervisor import Supervisor
from minidual.errors import UsageError
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.skills.object_path import ObjectPath, Waypoint
from tests.support.control_plant import ArmsPlant, HandsObject
from tests.support.panda import A_MAX, HOME
from tests.support.stacks import PAIR, hand_over, move, stack_on, trajectory

STOPPING = ("soft_stop",)
CLOSED = np.zeros(2)


@pytest.fixture
def plant(scene: SceneConfig) -> ArmsPlant:
    return ArmsPlant(scene)


def under_way(plant: Any, *, gripper: Array = CLOSED, **options: Any) -> ControlStack:
    """Return a stack whose planner is in the middle of a motion, hands closed."""
    stack = stack_on(plant, **options)
    hand_over(stack, "moveit")
    stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.4, 0.8), gripper=gripper))
    for _ in range(400):
        stack.step()
    assert np.abs(plant.v).max() > 0.5
    return stack


def test_a_halt_acts_in_the_next_step_and_brings_the_arms_to_rest(plant: ArmsPlant) -> None:
    stack = under_way(plant)
    v = plant.v.copy()
    told = [plant.torques[-1]]
    stack.halt("moveit")
    stack.step()
    assert stack.output.halted
    assert stack.manager.active == STOPPING
    assert (stack.state, stack.source, stack.executing) == (ArbiterState.STOPPED, None, False)
    speeds = [v, plant.v.copy()]
    for _ in range(500):
        stack.step()
        speeds.append(plant.v.copy())
    assert not stack.output.halted  # once
    assert np.abs(plant.v).max() < 1e-3
    told += plant.torques[-501:]
    assert np.abs(np.diff(told, axis=0)).max() < 1.5, "a jolt"
    slower = (np.abs(speeds[:-20]) - np.abs(speeds[20:])).max(axis=0) / 0.02 / A_MAX
    assert slower.max() < 0.7  # half of the limits, and how the arms follow it
    assert slower.max() > 0.3  # a stop, not a drift
    assert np.array_equal(stack.output.gripper, CLOSED), "the hands let go"


@pytest.mark.parametrize(("who", "opens"), [("moveit", True), ("teleop", False)])
def test_everybody_may_halt_and_only_who_drives_may_open_the_hands(
    plant: ArmsPlant,
    who: str,
    opens: bool,
) -> None:
    stack = under_way(plant)
    stack.halt(who, np.ones(2))
    stack.step()
    assert stack.manager.active == STOPPING
    assert np.array_equal(stack.output.gripper, np.full(2, float(opens)))
    assert [(r.source, r.name) for r in stack.refusals] == ([] if opens else [(who, "not_driving")])


def test_openings_that_are_none_are_refused_and_the_arms_stop_all_the_same(
    plant: ArmsPlant,
) -> None:
    stack = under_way(plant)
    stack.halt("moveit", np.array([0.5, np.nan]))
    stack.step()
    assert stack.manager.active == STOPPING
    assert [r.name for r in stack.refusals] == ["not_finite"]
    assert np.array_equal(stack.output.gripper, CLOSED)
    with pytest.raises(UsageError, match="no command source 'somebody'"):
        stack.halt("somebody")


def test_a_halted_object_path_pushes_the_hands_no_more(plant: ArmsPlant) -> None:
    here = HandsObject(plant)
    stack = stack_on(plant, sensor=here)
    stack.impedance.configure(
        dataclasses.replace(here.held(), mass_kg=1e-6),
    )  # nothing weighs on this plant's hands
    hand_over(stack, "moveit", OBJECT_CONTROLLERS)
    x, y, z = (float(value) for value in here.pose()[:3, 3])
    path = ObjectPath(Waypoint((x, y, z), 0.0, 0.0), [Waypoint((x, y, z + 0.1), 0.0, 0.8)])
    assert (
        stack.propose("moveit", ObjectCommand(path, lambda t: 0.0, CLOSED, plant.time, 1)) is None
    )
    for _ in range(300):
        stack.step()
    assert np.abs(plant.v).max() > 0.1
    stack.halt("moveit")
    for _ in range(500):
        stack.step()
    assert stack.manager.active == STOPPING
    assert np.abs(plant.v).max() < 1e-3


def test_what_is_held_may_not_change_in_the_hands_that_hold_it(plant: ArmsPlant) -> None:
    """A law that has not taken over has no damping and no posture: it must not be put in the place of one that drives."""
    here = HandsObject(plant)
    stack = stack_on(plant, sensor=here)
    stack.impedance.configure(here.held())
    stack.impedance.configure(here.held())  # not yet active: the last one counts
    hand_over(stack, "moveit", OBJECT_CONTROLLERS)
    for _ in range(50):
        stack.step()
    stack.impedance.configure(
        here.held(),
        ImpedanceConfig(stiffness_n_per_m=3000.0, stiffness_nm_per_rad=200.0),
    )
    last = plant.torques[-1]
    stack.step()
    assert np.abs(plant.torques[-1] - last).max() < 0.1, "the law that drives has changed"
    stack.switch_controllers(("both_arms",))
    stack.impedance.configure(here.held())
    stack.switch_controllers(OBJECT_CONTROLLERS)


def test_after_a_reset_it_must_be_told_what_is_held_again(plant: ArmsPlant) -> None:
    here = HandsObject(plant)
    stack = stack_on(plant, sensor=here)
    stack.impedance.configure(here.held())
    hand_over(stack, "moveit", OBJECT_CONTROLLERS)
    assert stack.impedance.desired is not None
    plant.reset()
    stack.reset()
    assert stack.manager.active == ("both_arms",)
    assert stack.impedance.desired is None
    with pytest.raises(ControllerSwitchError, match=r"not_ready: .*not been told what is held"):
        stack.switch_controllers(OBJECT_CONTROLLERS)
    stack.impedance.configure(here.held())
    stack.switch_controllers(OBJECT_CONTROLLERS)
    stack.step()


@pytest.mark.parametrize("settling", [False, True])
def test_a_switch_that_waits_is_refused_by_a_halt_and_may_be_asked_for_again(
    plant: ArmsPlant,
    settling: bool,
) -> None:
    stack = under_way(plant)
    stack.request("teleop")
    if settling:  # else both are asked for in one tick
        stack.step()
        assert stack.state is ArbiterState.SETTLING
    stack.halt("moveit")
    stack.step()
    assert [(r.source, r.name) for r in stack.refusals] == [("teleop", "superseded")]
    for _ in range(400):
        stack.step()
    assert stack.source is None
    # No command gets past: nobody drives, and the controller takes none.
    stack.propose("moveit", JointCommand(HOME, CLOSED, plant.time, 9))
    reason = stack.manager.refuses(JointCommand(HOME, CLOSED, plant.time, 9))
    assert reason is not None
    assert reason[0] == "wrong_controller"
    hand_over(stack, "teleop")
    assert stack.manager.active == ("both_arms",)
    last = plant.torques[-1]
    stack.propose("teleop", JointCommand(plant.q + 0.05, CLOSED, plant.time, 10))
    for _ in range(30):
        stack.step()
    assert stack.output.active_source == "teleop"
    assert np.abs(np.diff([last, *plant.torques[-30:]], axis=0)).max() < 40.0


def test_a_hold_that_was_asked_for_with_a_halt_leaves_the_stop_in_charge(plant: ArmsPlant) -> None:
    stack = under_way(plant)
    stack.halt("moveit")
    stack.request("hold")
    for _ in range(700):
        stack.step()
    assert stack.state is ArbiterState.HOLDING
    assert stack.manager.active == STOPPING
    assert np.abs(plant.v).max() < 1e-3


@pytest.mark.parametrize("first", ["hold", "switch"])
def test_a_hold_keeps_the_set_that_is_active_when_it_is_confirmed(
    plant: ArmsPlant,
    first: str,
) -> None:
    stack = stack_on(plant)
    hand_over(stack, "moveit", PAIR)
    if first == "hold":
        stack.request("hold")
        stack.switch_controllers(
            ("both_arms",),
        )  # of who drives, in the same step: it has let go of what it held
    else:
        stack.switch_controllers(("both_arms",))
        stack.request("hold")
    for _ in range(100):
        stack.step()
    assert stack.state is ArbiterState.HOLDING
    assert stack.manager.active == ("both_arms",)


def test_a_hold_that_names_its_set_gets_it(plant: ArmsPlant) -> None:
    """The negative control: only what nobody named follows the active set."""
    stack = stack_on(plant)
    hand_over(stack, "moveit")
    stack.request("hold", PAIR)
    stack.switch_controllers(("both_arms",))
    for _ in range(100):
        stack.step()
    assert stack.state is ArbiterState.HOLDING
    assert stack.manager.active == PAIR


# Recovery ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("after_s", [0.1, 0.4])
def test_arms_recover_at_rest_where_they_are_and_without_a_step_of_torque(
    world: World,
    after_s: float,
) -> None:
    """They went back 0.24 rad at 1.2 rad/s with no source, and the torque stepped by 9.4 Nm; now 1e-5 rad and 0.17 Nm."""
    supervisor = Supervisor(dt_s=world.dt)
    stack = stack_on(world, supervisor=supervisor)
    hand_over(stack, "moveit")
    stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.6, 1.0)))
    for _ in range(500):
        stack.step()
    supervisor.estop("pressed")
    with pytest.raises(ReflexError, match="emergency_stop"):
        stack.step()
    fast = float(np.abs(world.v).max())
    assert fast > 1.0
    with pytest.raises(
        UsageError,
        match=f"may not recover while they move \\({fast:.3f} rad/s; at rest is below",
    ):
        stack.recover()
    with pytest.raises(UsageError, match="may not drive: the supervisor stopped the arms"):
        stack.request("moveit")
    while np.abs(world.v).max() > 0.015:
        stack.step()
    for _ in range(round(after_s / world.dt)):
        stack.step()
    rest = world.q
    told = [stack.applied]
    stack.recover()
    for _ in range(500):
        stack.step()
        told.append(stack.applied)
    assert np.abs(world.q - rest).max() < 1e-4
    assert np.abs(np.diff(told, axis=0)).max() < 0.25
    assert (stack.state, stack.source, stack.reflex) == (ArbiterState.HOLDING, None, None)
    hand_over(stack, "teleop")


@pytest.mark.parametrize(("weight_n", "kept"), [(-2.0 * 9.81, True), (2.0 * 9.81, False)])
def test_holds_under_a_load_do_not_creep(world: World, weight_n: float, kept: bool) -> None:
    """2 kg: before, 138 mm down in eight holds, each from the posture that had sagged; now none lowers it.

    What presses a hand up is no load: the hold gives way to it, as before.
    """
    stack = stack_on(world)
    hand_over(stack, "teleop")
    world.data.xfrc_applied[world.model.body("left_panda_hand").id, 2] = weight_n
    for _ in range(300):
        stack.step()
    heights = []
    for mode in ("hold", "teleop") * 2:
        stack.request(mode)
        for _ in range(300):
            stack.step()
        heights.append(float(world.data.body("left_panda_hand_tcp").xpos[2]))
    crept = (heights[-1] - heights[0]) * np.sign(weight_n)
    assert (crept < 1e-5) == kept, f"{1e3 * crept:.2f} mm"


def test_a_hold_learns_the_load_of_a_hand_and_an_opening_hand_lets_go_of_it(world: World) -> None:
    """2 kg: before, the hand stayed 10 mm too low; now within 0.5 mm. No torque jumps, not even as the load leaves."""
    stack = stack_on(world)
    hand_over(stack, "teleop")
    posture = world.q
    height = world.data.body("left_panda_hand_tcp").xpos[2:].copy()
    hand = world.model.body("left_panda_hand").id
    told = []
    sag_mm = {}

    def wait(seconds: float, name: str) -> None:
        for _ in range(round(seconds / world.dt)):
            stack.step()
            told.append(stack.applied)
        sag_mm[name] = 1e3 * float(height[0] - world.data.body("left_panda_hand_tcp").xpos[2])

    world.data.xfrc_applied[hand, 2] = -2.0 * 9.81
    stack.grippers.holds = lambda arm: (
        arm == 0
    )  # the load hangs on the hand, not between its fingers
    stack.propose("teleop", JointCommand(posture, np.array([0.0, 1.0]), world.time, 1))
    wait(0.3, "driven")
    stack.request("hold")
    wait(3.0, "held")
    assert sag_mm["driven"] > 5.0
    assert abs(sag_mm["held"]) < 0.5
    hand_over(stack, "teleop")
    stack.propose("teleop", JointCommand(posture, np.ones(2), world.time, 2))
    stack.grippers.holds = lambda arm: False
    world.data.xfrc_applied[hand, 2] = 0.0
    wait(1.0, "let go")
    assert abs(sag_mm["let go"]) < 0.5
    assert np.abs(np.diff(told, axis=0)).max() <= 1.0 + 1e-9


def test_a_load_that_is_told_is_borne_while_the_hand_is_driven(world: World) -> None:
    """2 kg lower a driven hand by 10 mm if nobody tells; told, they lower it by less than 1 mm. No torque jumps."""
    stack = stack_on(world)
    hand_over(stack, "teleop")
    posture = world.q
    told = []
    height = float(world.data.body("left_panda_hand_tcp").xpos[2])
    hand = world.model.body("left_panda_hand").id

    def sag_mm(openings: tuple[float, float]) -> float:
        stack.propose(
            "teleop",
            JointCommand(posture, np.array(openings), world.time, len(told) + 1),
        )
        for step in range(800):
            if step % stack.every == 0:
                stack.affirm("teleop")
            stack.step()
            told.append(stack.applied)
        return 1e3 * (height - float(world.data.body("left_panda_hand_tcp").xpos[2]))

    assert abs(sag_mm((0.0, 1.0))) < 0.1
    world.data.xfrc_applied[hand, 2] = -2.0 * 9.81
    stack.payload.bear(0, 2.0)
    assert abs(sag_mm((0.0, 1.0))) < 1.0
    assert abs(sag_mm((0.05, 1.0))) < 1.0, "a command that wavers opens no hand"
    assert stack.payload.force_n == [pytest.approx(2.0 * 9.81), 0.0]
    world.data.xfrc_applied[hand, 2] = 0.0
    assert abs(sag_mm((1.0, 1.0))) < 0.5, "an opening hand lets go of it"
    assert stack.payload.force_n == [0.0, 0.0]
    assert np.abs(np.diff(told, axis=0)).max() <= 1.0 + 1e-9


def test_a_load_that_is_told_lifts_the_hand_until_it_opens() -> None:
    kinematics = Kinematics()
    payload = Payload(kinematics, 1e-3)
    q = HOME + 0.1
    payload.bear(1, 0.5)
    told = [payload.torque(q, q, (0, 1), learn=False) for _ in range(150)]
    assert payload.force_n == [0.0, pytest.approx(0.5 * 9.81)]
    np.testing.assert_allclose(told[-1], 0.5 * 9.81 * kinematics.tcp_jacobians(q)[1][2], atol=1e-9)
    for opening in (1.0, 0.0, 0.5, 0.3, 1.0):
        assert payload.torque(q, q, (0, 1), learn=False) is not None
        payload.follow(np.array([1.0, opening]), [False, False], [False, False])
    for _ in range(150):
        payload.torque(q, q, (0, 1), learn=False)
    assert payload.torque(q, q, (0, 1), learn=False) is None


@pytest.mark.parametrize(
    ("arm", "mass_kg"),
    [(0, 100.0), (0, -1.0), (0, np.nan), (0, np.inf), (-1, 0.5), (2, 0.5)],
)
def test_a_load_that_no_hand_bears_is_refused(arm: int, mass_kg: float) -> None:
    """Before, NaN and negative masses took a load away, and -1 was the right arm."""
    payload = Payload(Kinematics(), 1e-3)
    payload.bear(0, 1.0)
    with pytest.raises(UsageError, match=r"arms 0 and 1 bear 0 to 3.06 kg"):
        payload.bear(arm, mass_kg)
    payload.torque(HOME, HOME, (0, 1), learn=False)
    assert payload.force_n == [1.0, 0.0], "the load before is borne on"


def loaded(world: World, mass_kg: float) -> tuple[ControlStack, Callable[[], float]]:
    """Return a stack whose left hand is closed and told what it bears, and the height of that hand [mm]."""
    stack = stack_on(world, supervisor=Supervisor(dt_s=world.dt))
    hand_over(stack, "teleop")
    world.data.xfrc_applied[world.model.body("left_panda_hand").id, 2] = -mass_kg * 9.81
    stack.propose("teleop", JointCommand(world.q, np.array([0.0, 1.0]), world.time, 1))
    stack.payload.bear(0, mass_kg)
    for step in range(1000):
        if step % stack.every == 0:
            stack.affirm("teleop")
        stack.step()
    return stack, lambda: 1e3 * float(world.data.body("left_panda_hand_tcp").xpos[2])


def steps(stack: ControlStack, count: int) -> None:
    """Go on, also after a reflex."""
    for _ in range(count):
        with suppress(ReflexError):
            stack.step()


@pytest.mark.parametrize("how", ["halt", "estop"])
def test_a_stop_bears_the_load_that_was_told(world: World, how: str) -> None:
    """2 kg: before, an emergency stop let them sink by 40 mm, and a halt by 91 mm, into the reflex tracking_error."""
    stack, height_mm = loaded(world, 2.0)
    before = height_mm()
    if how == "halt":
        stack.halt("teleop")
    else:
        stack.supervisor.estop("pressed")
    steps(stack, 1500)
    assert abs(height_mm() - before) < 3.0
    assert (stack.reflex is None) == (how == "halt")


@pytest.mark.parametrize("how", ["halt", "estop"])
def test_a_hand_that_opens_in_a_stop_lets_go_of_its_load(world: World, how: str) -> None:
    """Before, a halt that opened the hand kept the load of what it let go: 0.5 kg threw it up by 17 mm, 2 kg by 103."""
    stack, height_mm = loaded(world, 1.0)
    before = height_mm()
    world.data.xfrc_applied[world.model.body("left_panda_hand").id, 2] = 0.0
    stack.halt("teleop", np.ones(2))
    if how == "estop":
        steps(stack, 5)
        stack.supervisor.estop("pressed")
    steps(stack, 1500)
    assert stack.payload.force_n == [0.0, 0.0]
    assert abs(height_mm() - before) < 3.0


def test_a_stop_bears_what_the_law_of_both_hands_bore(
    plant: ArmsPlant,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Before, an emergency stop let a board of 3 kg sink by 22 mm and a halt by 34 mm."""
    for how in ("halt", "estop"):
        plant.reset()
        here = HandsObject(plant)
        stack = stack_on(plant, sensor=here, supervisor=Supervisor(dt_s=plant.dt))
        stack.impedance.configure(dataclasses.replace(here.held(), mass_kg=3.0))
        hand_over(stack, "moveit", OBJECT_CONTROLLERS)
        stack.propose("moveit", JointCommand(HOME, CLOSED, plant.time, 1))
        if how == "halt":
            stack.halt("teleop")
        else:
            stack.supervisor.estop("pressed")
        steps(stack, 3)
        assert stack.payload.force_n == [pytest.approx(1.5 * 9.81)] * 2
        assert stack.supervisor._stop.bears_n == stack.payload.force_n
        monkeypatch.setattr(stack.grippers, "lost", lambda arm: arm == 1)
        steps(stack, 200)
        assert stack.payload.force_n == [pytest.approx(1.5 * 9.81), 0.0], (
            "what has slid out weighs no more"
        )


def test_what_a_stopped_arm_misses_is_no_load(world: World) -> None:
    """Before, the hold learnt the distance to the reference that a stop had left: recover() threw an empty hand up 43 mm."""
    stack = stack_on(world, supervisor=Supervisor(dt_s=world.dt))
    hand_over(stack, "teleop")
    target = world.q
    for sequence in range(1, 16):
        target[1] -= 0.02
        stack.propose("teleop", JointCommand(target.copy(), CLOSED, world.time, sequence))
        for _ in range(stack.every):
            stack.step()
    stack.supervisor.estop("pressed")
    steps(stack, 2000)
    assert max(stack.payload.force_n) < 0.5
    before = [
        1e3 * float(world.data.body(f"{side}_panda_hand_tcp").xpos[2]) for side in ("left", "right")
    ]
    stack.recover()
    steps(stack, 1000)
    after = [
        1e3 * float(world.data.body(f"{side}_panda_hand_tcp").xpos[2]) for side in ("left", "right")
    ]
    np.testing.assert_allclose(after, before, atol=1.0)


def test_a_paced_path_is_the_same_path_driven_smoothly() -> None:
    path = ObjectPath(Waypoint((0.0, 0.0, 0.0), 0.0, 0.0), [Waypoint((0.5, 0.0, 0.0), 0.0, 2.0)])
    paced = ObjectExecution(ObjectCommand(path, lambda t: 0.0, CLOSED, 0.0, 1), 1e-3)
    rows = []
    while not paced.finished:
        paced.pace = 0.2 if 600 <= len(rows) < 1800 else 1.0
        paced.step()
        state = paced.desired
        rows.append((state.T_world_object[0, 3], state.twist[0], state.acceleration[0]))
        assert len(rows) < 3500
    x, v, a = np.array(rows).T
    assert x[-1] == pytest.approx(0.5)
    assert np.abs(np.diff(x) / 1e-3 - v[1:]).max() < 1e-3
    assert np.abs(np.diff(v) / 1e-3 - a[1:]).max() < 1e-2
    assert np.abs(a).max() < 2.0
    assert v[1000:1800].max() < 0.3 * v[:600].max()


@pytest.mark.parametrize(
    ("way_m", "duration_s", "name", "detail"),
    [
        (0.4, 3.0, "singular", "condition number"),
        (0.4, 1.0, "singular", "condition number"),
        (-0.4, 4.0, "joint_limit", "joint2 is 0.0.. rad from its limit"),
    ],
)
def test_a_path_out_of_reach_slows_down_and_stops_by_name(
    plant: ArmsPlant,
    way_m: float,
    duration_s: float,
    name: str,
    detail: str,
) -> None:
    """Before, the stretched arms ended in the reflex joint_velocity at condition number 599, fast ones until later."""
    here = HandsObject(plant)
    stack = stack_on(plant, sensor=here, supervisor=Supervisor(dt_s=plant.dt))
    stack.impedance.configure(here.held())
    hand_over(stack, "moveit", OBJECT_CONTROLLERS)

    def drive(way_m: float, duration_s: float) -> None:
        x, y, z = (float(value) for value in here.pose()[:3, 3])
        path = ObjectPath(
            Waypoint((x, y, z), 0.0, 0.0),
            [Waypoint((x + way_m, y, z), 0.0, duration_s)],
        )
        assert (
            stack.propose(
                "moveit",
                ObjectCommand(path, lambda t: 0.0, CLOSED, plant.time, plant.steps),
            )
            is None
        )
        stack.step()
        while stack.executing:
            stack.affirm("moveit")
            stack.step()

    drive(way_m, duration_s)
    for _ in range(200):
        stack.step()
    assert [refusal.name for refusal in stack.refusals] == [name]
    assert re.search(detail, stack.refusals[0].detail)
    assert stack.reflex is None
    assert np.abs(plant.v).max() < 0.05
    stretched = here.pose()[0, 3]
    hand_over(stack, "moveit")
    drive(-0.1 * np.sign(way_m), 1.0)  # the way back is free
    assert len(stack.refusals) == 1
    assert abs(here.pose()[0, 3] - stretched) == pytest.approx(0.1, abs=0.01)
