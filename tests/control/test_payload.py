"""Loads of the hands: told or learnt, borne in every mode and stop, and let go of with the object."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from minidual.config.scene import SceneConfig
from minidual.control.commands import JointCommand
from minidual.control.payload import Payload
from minidual.control.stack import DEFAULT_CONTROLLERS, OBJECT_CONTROLLERS, ControlStack
from minidual.errors import UsageError
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from tests.support.carried_rod import KINEMATICS, Carried
from tests.support.control_plant import HandsObject
from tests.support.panda import DOF, HOME
from tests.support.stacks import (
    CLOSED,
    Arms,
    hand_height_m,
    hand_over,
    run,
    supervised,
)

BOTH = (0, 1)
LEFT_CLOSED = np.array([0.0, 1.0])
NONE = [False, False]


# The payload alone ------------------------------------------------------------------------------------------


def test_a_told_load_lifts_the_hand_until_it_opens(kinematics: Kinematics) -> None:
    payload = Payload(kinematics, 1e-3)
    q = HOME + 0.1
    payload.bear(1, 0.5)
    torques = [payload.torque(q, q, BOTH, learn=False) for _ in range(150)]
    assert payload.force_n == [0.0, pytest.approx(0.5 * 9.81)]
    rise = kinematics.tcp_jacobians(q)[1][2]
    np.testing.assert_allclose(torques[-1], 0.5 * 9.81 * rise, atol=1e-9)
    for opening in (1.0, 0.0, 0.5, 0.3, 1.0):
        assert payload.torque(q, q, BOTH, learn=False) is not None
        payload.follow(np.array([1.0, opening]), NONE, NONE, stopped=False)
    for _ in range(150):
        payload.torque(q, q, BOTH, learn=False)
    assert payload.torque(q, q, BOTH, learn=False) is None


@pytest.mark.parametrize(
    ("arm", "mass_kg"),
    [(0, 100.0), (0, -1.0), (0, np.nan), (0, np.inf), (-1, 0.5), (2, 0.5)],
)
def test_a_load_that_no_hand_bears_is_refused(
    kinematics: Kinematics,
    arm: int,
    mass_kg: float,
) -> None:
    payload = Payload(kinematics, 1e-3)
    payload.bear(0, 1.0, at_once=True)
    with pytest.raises(UsageError, match=r"arms 0 and 1 bear 0 to 3.06 kg"):
        payload.bear(arm, mass_kg)
    assert payload.force_n == [pytest.approx(9.81), 0.0], "the earlier load is borne on"


@pytest.mark.parametrize("dt_s", [1e-3, 1e-2, 2e-2])
def test_a_told_load_is_borne_as_slowly_on_a_slow_plant(
    kinematics: Kinematics,
    dt_s: float,
) -> None:
    payload = Payload(kinematics, dt_s)
    torques = [np.zeros(DOF)]
    payload.bear(0, 2.0)
    for _ in range(round(0.5 / dt_s / payload.every)):
        tau = payload.torque(HOME, HOME, BOTH, learn=False)
        assert tau is not None
        torques.append(tau)
    steps = np.abs(np.diff(torques, axis=0)).max(axis=1)
    assert steps.max() < 1.0
    assert steps[-1] == 0.0
    assert np.abs(torques[-1]).max() > 8.0


@pytest.mark.parametrize(("holds", "below_m"), [(True, 0.005), (True, -0.005), (False, 0.005)])
def test_only_a_hand_that_holds_something_learns_what_lowers_it(
    kinematics: Kinematics,
    holds: bool,
    below_m: float,
) -> None:
    payload = Payload(kinematics, 1e-3)
    payload.follow(LEFT_CLOSED, NONE, [holds, False], stopped=False)
    rise = kinematics.tcp_jacobians(HOME)[0][2]
    q_ref = HOME + below_m * rise / (rise @ rise)
    for _ in range(1000):
        payload.torque(HOME, q_ref, BOTH, learn=True)
    assert (payload.force_n[0] > 5.0) == (holds and below_m > 0.0)
    assert payload.force_n[1] == 0.0


def test_in_a_stop_a_lost_object_is_let_go_of_at_once(kinematics: Kinematics) -> None:
    payload = Payload(kinematics, 1e-3)
    for arm in BOTH:
        payload.bear(arm, 1.5, at_once=True)
    payload.follow(CLOSED, [False, True], [True, False], stopped=True)
    assert payload.force_n == [pytest.approx(1.5 * 9.81), 0.0]


# In the simulated world -------------------------------------------------------------------------------------


def hand_mm(world: World) -> float:
    return 1e3 * float(world.data.body("left_panda_hand_tcp").xpos[2])


def pull(world: World, force_n: float) -> None:
    """Pull the left hand down."""
    world.data.xfrc_applied[world.model.body("left_panda_hand").id, 2] = -force_n


class Loaded:
    """A teleoperated stack whose left hand is closed, and pulled down by a weight."""

    def __init__(self, world: World, mass_kg: float) -> None:
        self.world = world
        self.stack = supervised(world)  # type: ignore[arg-type]
        self.torques: list[Array] = []
        self.sequence = 0
        self.posture = world.q
        hand_over(self.stack, "teleop")
        self.began_mm = hand_mm(world)
        self.tell(LEFT_CLOSED)
        pull(world, mass_kg * 9.81)

    def tell(self, openings: Array) -> None:
        self.sequence += 1
        command = JointCommand(self.posture, openings, self.world.time, self.sequence)
        assert self.stack.propose("teleop", command) is None

    def sag_mm(self, ticks: int) -> float:
        """Step; return how much lower the hand is than at the beginning."""
        for _ in range(ticks):
            run(self.stack, 1)
            self.torques.append(self.stack.applied)
        return self.began_mm - hand_mm(self.world)

    def assert_smooth(self) -> None:
        assert np.abs(np.diff(self.torques, axis=0)).max() <= 1.0 + 1e-9


def test_a_told_load_is_borne_while_the_hand_is_driven_until_it_opens(world: World) -> None:
    loaded = Loaded(world, 2.0)
    assert loaded.sag_mm(500) > 5.0
    loaded.stack.payload.bear(0, 2.0)
    assert abs(loaded.sag_mm(800)) < 1.0
    loaded.stack.request("hold")
    loaded.sag_mm(100)
    hand_over(loaded.stack, "teleop")
    loaded.tell(np.array([0.05, 1.0]))
    assert abs(loaded.sag_mm(300)) < 1.0, "a command that wavers opens no hand"
    assert loaded.stack.payload.force_n == [pytest.approx(2.0 * 9.81), 0.0]
    pull(world, 0.0)
    loaded.tell(np.ones(2))
    assert abs(loaded.sag_mm(800)) < 0.5
    assert loaded.stack.payload.force_n == [0.0, 0.0]
    loaded.assert_smooth()


@pytest.mark.parametrize("how", ["halt", "estop"])
def test_a_stop_bears_the_load_that_was_told(world: World, how: str) -> None:
    loaded = Loaded(world, 2.0)
    loaded.stack.payload.bear(0, 2.0)
    loaded.sag_mm(800)
    if how == "halt":
        loaded.stack.halt("teleop")
    else:
        loaded.stack.supervisor.estop()
    assert abs(loaded.sag_mm(1200)) < 3.0
    assert (loaded.stack.reflex is None) == (how == "halt")


@pytest.mark.parametrize("how", ["halt", "estop"])
def test_a_hand_that_opens_in_a_stop_lets_go_of_its_load(world: World, how: str) -> None:
    loaded = Loaded(world, 1.0)
    loaded.stack.payload.bear(0, 1.0)
    loaded.sag_mm(800)
    pull(world, 0.0)
    loaded.stack.halt("teleop", np.ones(2))
    if how == "estop":
        loaded.sag_mm(5)
        loaded.stack.supervisor.estop()
    assert abs(loaded.sag_mm(1200)) < 3.0
    assert loaded.stack.payload.force_n == [0.0, 0.0]


@pytest.mark.parametrize("ticks", [0, 2])
def test_a_stop_at_the_beginning_of_a_trial_bears_no_load_of_the_last_one(
    world: World,
    ticks: int,
) -> None:
    loaded = Loaded(world, 3.0)
    loaded.stack.payload.bear(0, 3.0)
    loaded.sag_mm(600)
    world.reset()
    pull(world, 0.0)
    loaded.stack.reset()
    began_mm = hand_mm(world)
    run(loaded.stack, ticks)
    loaded.stack.supervisor.estop("between two trials")
    assert run(loaded.stack, 600) == ["emergency_stop"]
    assert abs(hand_mm(world) - began_mm) < 1.0


@pytest.mark.parametrize("how", ["halt", "emergency_stop"])
def test_a_closed_hand_that_holds_nothing_learns_nobodys_weight(world: World, how: str) -> None:
    """20 N lean on it in a hold; it does not rise in a stop afterwards."""
    stack = supervised(world)  # type: ignore[arg-type]
    hand_over(stack, "teleop")
    stack.propose("teleop", JointCommand(world.q, CLOSED, world.time, 1))
    run(stack, 400)
    stack.request("hold")
    run(stack, 600)
    began_mm = hand_mm(world)
    pull(world, 20.0)
    assert run(stack, 2000) == []
    pull(world, 0.0)
    if how == "halt":
        stack.halt("teleop")
    else:
        stack.supervisor.estop()
    assert run(stack, 1000) == ([] if how == "halt" else [how])
    assert stack.payload.force_n == [0.0, 0.0]
    assert hand_mm(world) < began_mm + 1.0


def test_the_distance_to_the_reference_that_a_stop_leaves_is_no_load(world: World) -> None:
    stack = supervised(world)  # type: ignore[arg-type]
    hand_over(stack, "teleop")
    target = world.q
    for sequence in range(1, 16):
        target[1] -= 0.02
        stack.propose("teleop", JointCommand(target.copy(), CLOSED, world.time, sequence))
        run(stack, stack.every)
    stack.supervisor.estop()
    run(stack, 1500)
    assert max(stack.payload.force_n) < 0.5
    before_m = [T[2, 3] for T in KINEMATICS.tcp_poses(world.q)]
    stack.recover()
    run(stack, 1000)
    after_m = [T[2, 3] for T in KINEMATICS.tcp_poses(world.q)]
    np.testing.assert_allclose(after_m, before_m, atol=1e-3)


@pytest.mark.parametrize("drives_again", [False, True])
def test_a_soft_hand_that_is_jammed_in_a_hold_is_not_thrown_when_it_comes_free(
    world: World,
    kinematics: Kinematics,
    drives_again: bool,
) -> None:
    names = ("left_hand", "right_arm")
    stack = supervised(world)  # type: ignore[arg-type]
    hand_over(stack, "moveit", names)
    stack.propose("moveit", JointCommand(HOME, CLOSED, world.time, 1))
    began_m = hand_mm(world) / 1e3
    highest_m = 0.0
    free = 3100 if drives_again else 2500
    for tick in range(free + 1000):
        if tick == 500:
            stack.request("hold")
        if tick == 2500 and drives_again:
            stack.request("moveit", names)
        height_m = hand_mm(world) / 1e3
        pull_n = 0.0
        if tick < free:
            ledge_m = began_m - 0.006 * min(1.0, tick / 400)
            rise_m_per_s = float(kinematics.tcp_jacobians(world.q)[0][2] @ world.v)
            pull_n = max(0.0, 2e4 * (height_m - ledge_m) + 100.0 * rise_m_per_s)
        else:
            highest_m = max(highest_m, height_m - began_m)
        pull(world, pull_n)
        if tick == free - 1:
            assert 5.0 < pull_n < 15.0
        stack.step()
    assert highest_m < 0.01


# Arms alone -------------------------------------------------------------------------------------------------


def test_a_hold_after_silence_learns_what_a_driven_hand_lifts(
    scene: SceneConfig,
    kinematics: Kinematics,
) -> None:
    """20 N in a teleoperated hand, of which nobody told."""
    plant = Arms(scene)
    plant.grip_something(left_only=True)
    stack = supervised(plant)
    hand_over(stack, "teleop")

    def step(speaks: bool) -> list[str]:
        rise = kinematics.tcp_jacobians(plant.q)[0][2, :7]
        plant.pushed = -20.0 * np.r_[rise, np.zeros(7)]
        if stack.tick_next and speaks:
            command = JointCommand(HOME, LEFT_CLOSED, plant.time, round(1e3 * plant.time))
            stack.propose("teleop", command)
        return run(stack, 1)

    for _ in range(1000):
        assert step(speaks=True) == []
    assert stack.payload.force_n == [0.0, 0.0], "a driven hand learns none"
    before_m = hand_height_m(plant, 0)
    names = [name for _ in range(2000) for name in step(speaks=False)]
    assert names == []
    assert abs(hand_height_m(plant, 0) - before_m) < 0.012


@pytest.mark.parametrize("how", ["halt", "estop"])
def test_a_stop_bears_what_the_law_of_both_hands_bore(scene: SceneConfig, how: str) -> None:
    plant = Arms(scene)
    here = HandsObject(plant)
    stack = supervised(plant, sensor=here)
    stack.impedance.configure(dataclasses.replace(here.held(), mass_kg=3.0))
    hand_over(stack, "moveit", OBJECT_CONTROLLERS)
    if how == "halt":
        stack.halt("teleop")
    else:
        stack.supervisor.estop()
    run(stack, 3)
    assert stack.payload.force_n == [pytest.approx(1.5 * 9.81)] * 2
    assert stack.supervisor._stop.weights_n is stack.payload.force_n


def test_joint_control_and_its_stops_bear_what_the_object_law_bore(scene: SceneConfig) -> None:
    carried = Carried(World(scene), 2.0)  # its own model: the mass changes
    began_m = carried.height_m
    lowest_m = began_m
    carried.stack.switch_controllers(DEFAULT_CONTROLLERS)
    carried.run(400)
    carried.stop()
    for _ in range(100):
        carried.run(5)
        lowest_m = min(lowest_m, carried.height_m)
    assert lowest_m > began_m - 0.001


def test_a_latched_stop_lifts_no_hands_whose_object_is_gone_and_unseen(scene: SceneConfig) -> None:
    world = World(scene)  # its own model: the mass changes
    carried = Carried(world, 3.0)
    carried.stop()
    heights_m = np.array([T[2, 3] for T in KINEMATICS.tcp_poses(world.q)])
    command = world.command
    world.command = lambda tau, fingers: command(tau, np.full(2, 0.04))  # type: ignore[method-assign]
    carried.sensor.off_m = (np.nan, np.nan, np.nan)
    rise_m = 0.0
    for _ in range(160):
        carried.run(5)
        now_m = np.array([T[2, 3] for T in KINEMATICS.tcp_poses(world.q)])
        rise_m = max(rise_m, float((now_m - heights_m).max()))
    assert rise_m < 0.005
    assert carried.stack.payload.force_n == [0.0, 0.0]


def pressed_down(plant: Arms, kinematics: Kinematics, force_n: float) -> Callable[[], None]:
    """Return what pushes the right hand down in each tick."""

    def press() -> None:
        plant.pushed = -force_n * kinematics.tcp_jacobians(plant.true_q)[1][2]

    return press


def step_pressed(stack: ControlStack, press: Callable[[], None], ticks: int) -> float:
    """Step; return the largest speed [rad/s]."""
    fastest = 0.0
    for _ in range(ticks):
        press()
        run(stack, 1)
        fastest = max(fastest, float(np.abs(stack.plant.true_v).max()))
    return fastest


def test_a_request_after_a_halt_throws_no_pressed_arm_back(
    scene: SceneConfig,
    kinematics: Kinematics,
) -> None:
    plant = Arms(scene)
    stack = supervised(plant)
    hand_over(stack, "teleop")
    stack.halt("teleop")
    run(stack, 300)
    press = pressed_down(plant, kinematics, 6.0)
    step_pressed(stack, press, 1500)
    before_m = hand_height_m(plant, 1)
    stack.request("moveit")
    assert step_pressed(stack, press, 600) < 0.15
    assert abs(hand_height_m(plant, 1) - before_m) < 0.006


def test_a_loaded_arm_stays_while_the_other_one_changes_its_controller(
    scene: SceneConfig,
    kinematics: Kinematics,
) -> None:
    plant = Arms(scene)
    stack = supervised(plant)
    hand_over(stack, "moveit", ("left_arm", "right_arm"))
    press = pressed_down(plant, kinematics, 10.0)
    began_m = hand_height_m(plant, 1)
    step_pressed(stack, press, 1200)
    sagged_m = hand_height_m(plant, 1)
    assert sagged_m < began_m - 0.002
    for change in range(6):
        stack.switch_controllers(("left_arm" if change % 2 else "left_hand", "right_arm"))
        step_pressed(stack, press, 400)
        assert hand_height_m(plant, 1) > sagged_m - 0.002
