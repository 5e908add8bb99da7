"""Controller C on a stack: paths that are refused, checked under way, slowed down and stopped; sensors that are wrong."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from minidual.config.control import ImpedanceConfig
from minidual.config.scene import SceneConfig
from minidual.control.commands import ObjectCommand
from minidual.control.controller_manager import ControllerSwitchError
from minidual.control.execution import ObjectExecution
from minidual.control.impedance import HeldObject, ObjectState
from minidual.control.reflexes import ReflexError
from minidual.control.stack import DEFAULT_CONTROLLERS, OBJECT_CONTROLLERS, ControlStack
from minidual.errors import UsageError
from minidual.plant.world import World
from minidual.robot.pair import Array
from minidual.skills.object_path import ObjectPath, Waypoint
from tests.support.carried_rod import KINEMATICS, Carried
from tests.support.control_plant import HandsObject
from tests.support.random_driver import Path, jumps
from tests.support.stacks import CLOSED, OPEN, Arms, hand_over, run, supervised


class Holding:
    """Arms whose hands hold an imagined object by controller C."""

    def __init__(self, scene: SceneConfig, **options: Any) -> None:
        self.plant = Arms(scene)
        self.here = HandsObject(self.plant)
        self.stack = supervised(self.plant, sensor=self.here, **options)
        self.stack.impedance.configure(self.here.held())
        hand_over(self.stack, "moveit", OBJECT_CONTROLLERS)
        self.sequence = 0

    @property
    def position_m(self) -> Array:
        return self.here.pose()[:3, 3].copy()

    def offer(self, motion: Any, openings: Array = OPEN) -> str:
        """Propose a path; return the name of its refusal, or nothing."""
        self.sequence += 1
        command = ObjectCommand(motion, lambda t: 0.0, openings, self.plant.time, self.sequence)
        refusal = self.stack.propose("moveit", command)
        return "" if refusal is None else refusal.name

    def path(self, by_m: tuple[float, float, float], duration_s: float) -> ObjectPath:
        start = self.position_m
        goal = Waypoint(tuple((start + by_m).tolist()), 0.0, duration_s)
        return ObjectPath(Waypoint(tuple(start.tolist()), 0.0, 0.0), [goal])


@pytest.fixture
def holding(scene: SceneConfig) -> Holding:
    return Holding(scene)


@pytest.fixture
def carried(world: World) -> Carried:
    return Carried(world)


# What is held -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mass_kg", [-2.0, 6.2, 200.0, np.nan])
def test_an_object_that_no_hands_bear_is_refused(holding: Holding, mass_kg: float) -> None:
    axis = np.array([0.0, 1.0, 0.0])
    held = HeldObject(mass_kg, np.eye(3), (np.eye(4), np.eye(4)), axis)
    with pytest.raises(UsageError, match="two hands cannot hold"):
        holding.stack.impedance.configure(held)


def test_a_configuration_acts_at_the_next_activation(holding: Holding) -> None:
    """A law that has not taken over has no damping and no posture."""
    stack = holding.stack
    run(stack, 50)
    stiff = ImpedanceConfig(stiffness_n_per_m=3000.0, stiffness_nm_per_rad=200.0)
    stack.impedance.configure(holding.here.held(), stiff)
    last = stack.applied
    run(stack, 1)
    assert np.abs(stack.applied - last).max() < 0.1
    stack.switch_controllers(DEFAULT_CONTROLLERS)
    stack.impedance.configure(holding.here.held())
    stack.switch_controllers(OBJECT_CONTROLLERS)


def test_after_a_reset_it_must_be_told_what_is_held_again(holding: Holding) -> None:
    stack = holding.stack
    assert stack.impedance.desired is not None
    holding.plant.reset()
    stack.reset()
    assert stack.manager.active == DEFAULT_CONTROLLERS
    assert stack.impedance.desired is None
    with pytest.raises(ControllerSwitchError, match=r"not_ready: .*not been told what is held"):
        stack.switch_controllers(OBJECT_CONTROLLERS)


# Paths that are refused -------------------------------------------------------------------------------------


def test_a_path_that_jumps_is_refused(holding: Holding) -> None:
    path = Path(holding.here.pose())
    path.lie = jumps
    assert holding.offer(path) == "pose_jump"


def test_a_turn_that_no_arm_can_follow_is_refused(holding: Holding) -> None:
    here = tuple(holding.position_m.tolist())
    start = Waypoint(here, 0.0, 0.0)
    assert holding.offer(ObjectPath(start, [Waypoint(here, 1.5, 0.8)])) == "too_fast"
    assert holding.offer(ObjectPath(start, [Waypoint(here, 0.6, 0.45)])) == "too_sharp"
    assert holding.offer(ObjectPath(start, [Waypoint(here, 0.6, 2.0)])) == ""


def test_a_path_that_opens_the_hands_is_refused_at_its_start(carried: Carried) -> None:
    T = carried.world.object_pose()
    start = Waypoint(tuple(T[:3, 3].tolist()), float(np.arctan2(T[1, 0], T[0, 0])), 0.0)
    path = ObjectPath(start, [Waypoint(start.xyz_m, start.yaw_rad, 1.0)])
    right_opens = np.array([0.0, 1.0])
    sequence = carried.sequence + 1
    command = ObjectCommand(path, lambda t: 40.0, right_opens, carried.world.time, sequence)
    assert carried.stack.propose("moveit", command) is None
    carried.run(600)
    assert carried.names == []
    refusal = carried.stack.refusals[-1]
    assert refusal.name == "gripper_out_of_range"
    assert refusal.detail == "gripper [0. 1.] would open the hands that hold the object"
    assert carried.height_m > 0.14


# Paths under way --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate_hz", [50.0, 10.0])
@pytest.mark.parametrize("by_m", [(0.25, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.25)])
def test_a_path_is_followed_at_every_rate_of_the_arbiter(
    scene: SceneConfig,
    by_m: tuple[float, float, float],
    rate_hz: float,
) -> None:
    holding = Holding(scene, rate_hz=rate_hz)
    start = holding.position_m
    seconds = 1.875 * float(np.linalg.norm(by_m)) / 0.6
    assert holding.offer(holding.path(by_m, seconds)) == ""
    assert run(holding.stack, int(1000 * seconds) + 800) == []
    assert holding.stack.refusals == []
    assert np.linalg.norm(holding.position_m - start - by_m) < 0.005


class Motion:
    """An object path that stays, unless `lie` changes a state; it may return the same array each time."""

    duration_s = 2.0

    def __init__(self, T: Array, *, reuses: bool = False) -> None:
        self._T = T.copy()
        self._array = T.copy()
        self._reuses = reuses
        self.lie: Callable[[ObjectState, float], ObjectState] = lambda state, t: state

    def at(self, t_s: float) -> ObjectState:
        state = self.lie(ObjectState(self._T.copy(), np.zeros(6), np.zeros(6)), t_s)
        if not self._reuses:
            return state
        self._array[:] = state.T_world_object
        return state._replace(T_world_object=self._array)


def jump(state: ObjectState, t_s: float) -> ObjectState:
    T = state.T_world_object.copy()
    T[1, 3] += 0.12 if t_s > 0.5 else 0.0
    return state._replace(T_world_object=T)


def accelerate(state: ObjectState, t_s: float) -> ObjectState:
    return state._replace(acceleration=(20.0 if t_s > 0.5 else 0.0) * np.eye(6)[1])


def spin(state: ObjectState, t_s: float) -> ObjectState:
    return state._replace(twist=(4.0 if t_s > 0.5 else 0.0) * np.eye(6)[5])


@pytest.mark.parametrize("lie", [jump, accelerate, spin])
@pytest.mark.parametrize("reuses", [False, True])
def test_a_path_is_checked_under_way_as_at_its_proposal(
    holding: Holding,
    lie: Callable[[ObjectState, float], ObjectState],
    reuses: bool,
) -> None:
    motion = Motion(holding.here.pose(), reuses=reuses)
    motion.lie = lie
    assert holding.offer(motion) in ("pose_jump", "too_sharp", "too_fast")
    motion.lie = lambda state, _: state
    assert holding.offer(motion) == ""
    run(holding.stack, 100)
    motion.lie = lie
    before_m = holding.position_m
    assert run(holding.stack, 800) == ["controller_failed"]
    assert np.linalg.norm(holding.position_m - before_m) < 0.01


@pytest.mark.parametrize("squeeze_n", [np.nan, -50.0, 1000.0])
def test_the_squeeze_of_a_path_is_checked_under_way(holding: Holding, squeeze_n: float) -> None:
    squeezes_n = [0.0]
    path = holding.path((0.05, 0.0, 0.0), 2.0)
    command = ObjectCommand(path, lambda t: squeezes_n[0], OPEN, holding.plant.time, 1)
    assert holding.stack.propose("moveit", command) is None
    assert run(holding.stack, 300) == []
    squeezes_n[0] = squeeze_n
    assert run(holding.stack, 500) == ["controller_failed"]
    assert "the path's squeeze is" in str(holding.stack.reflex)
    assert np.abs(holding.plant.v).max() < 0.05


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
def test_a_path_out_of_reach_slows_down_and_stops_by_name_and_the_way_back_is_free(
    holding: Holding,
    way_m: float,
    duration_s: float,
    name: str,
    detail: str,
) -> None:
    stack = holding.stack

    def drive(way_m: float, duration_s: float) -> None:
        assert holding.offer(holding.path((way_m, 0.0, 0.0), duration_s)) == ""
        run(stack, 1)
        while stack.executing:
            run(stack, 1)

    drive(way_m, duration_s)
    run(stack, 200)
    assert [refusal.name for refusal in stack.refusals] == [name]
    assert re.search(detail, stack.refusals[0].detail)
    assert stack.reflex is None
    assert np.abs(holding.plant.v).max() < 0.05
    stretched_m = holding.position_m[0]
    hand_over(stack, "moveit", OBJECT_CONTROLLERS)
    drive(-0.1 * np.sign(way_m), 1.0)
    assert len(stack.refusals) == 1
    assert abs(holding.position_m[0] - stretched_m) == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize(("by_m", "duration_s"), [((0.2, 0.0, 0.0), 0.6), ((0.0, 0.0, 0.25), 0.8)])
def test_a_path_that_left_its_object_behind_presses_no_longer(
    carried: Carried,
    by_m: tuple[float, float, float],
    duration_s: float,
) -> None:
    """An object is held back with 40 N and then let go; it does not leap."""
    world = carried.world
    body = world.model.body("rod").id
    carried.carry(by_m, duration_s)
    start = world.object_pose()[:3, 3].copy()
    along = np.array(by_m) / np.linalg.norm(by_m)
    pressed_n = 0.0
    for _ in range(3500):
        back_m = along @ (start - world.object_pose()[:3, 3])
        speed = along @ world.truth().twist()[:3]
        pressed_n = float(np.clip(3000.0 * back_m - 100.0 * speed, -40.0, 40.0))
        world.data.xfrc_applied[body, :3] = pressed_n * along
        carried.run(1)
    world.data.xfrc_applied[body] = 0.0
    assert "off_path" in [refusal.name for refusal in carried.stack.refusals]
    assert abs(pressed_n) < 10.0
    held = world.object_pose()[:3, 3].copy()
    far_m = 0.0
    for _ in range(1000):
        carried.run(1)
        far_m = max(far_m, float(np.linalg.norm(world.object_pose()[:3, 3] - held)))
    assert far_m < 0.025
    assert carried.names == []


# Sensors ----------------------------------------------------------------------------------------------------


def moved_m(carried: Carried, before: list[Array]) -> float:
    after = [T[:3, 3] for T in KINEMATICS.tcp_poses(carried.world.q)]
    return max(float(np.linalg.norm(b - a)) for a, b in zip(after, before, strict=True))


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("the object's pose is", {"off_m": (0.0, np.nan, 0.0)}),
        ("the object's twist is", {"twist_off": (0.0, 0.0, np.nan, 0.0, 0.0, 0.0)}),
        ("the object's internal force is", {"felt_off_n": np.nan}),
    ],
)
def test_an_object_that_is_not_measured_is_named_in_the_same_tick(
    carried: Carried,
    text: str,
    wrong: dict[str, Any],
) -> None:
    for name, value in wrong.items():
        setattr(carried.sensor, name, value)
    with pytest.raises(ReflexError) as caught:
        carried.stack.step()
    assert caught.value.reflex.label == "controller_failed"
    assert text in caught.value.message
    assert "what measures it" in str(caught.value.__cause__)
    carried.run(1000)
    assert carried.height_m > 0.14


@pytest.mark.parametrize("off_m", [(0.05, 0.0, 0.0), (0.0, 0.0, -0.06)])
def test_a_pose_that_jumps_in_a_hold_stops_the_arms_by_its_name(
    carried: Carried,
    off_m: tuple[float, float, float],
) -> None:
    q = carried.world.q.copy()
    carried.sensor.off_m = off_m
    carried.run(600)
    assert carried.names == ["controller_failed"]
    assert carried.stack.reflex is not None
    message = carried.stack.reflex.message
    assert f"the object is {1e3 * abs(sum(off_m)):.0f} mm" in message
    assert "away from where the left hand holds it" in message
    assert np.abs(carried.world.q - q).max() < 0.02
    assert carried.height_m > 0.13, "the hands keep what they hold"


@pytest.mark.parametrize("rate_m_per_s", [0.1, 2.0])
def test_a_pose_that_drifts_in_a_hold_is_named(carried: Carried, rate_m_per_s: float) -> None:
    before = [T[:3, 3].copy() for T in KINEMATICS.tcp_poses(carried.world.q)]
    ticks = 0

    def drift() -> None:
        nonlocal ticks
        ticks += 1
        carried.sensor.off_m = (0.0, min(0.3, rate_m_per_s * 1e-3 * ticks), 0.0)

    carried.run(3500, drift)
    assert carried.names == ["controller_failed"]
    assert carried.stack.reflex is not None
    assert "away from where the left hand holds it" in carried.stack.reflex.message
    assert moved_m(carried, before) < 0.06


@pytest.mark.parametrize(
    ("off", "fails"),
    [(0.1 * np.eye(6)[1], True), (2.0 * np.eye(6)[3], True), (0.025 * np.eye(6)[0], False)],
)
def test_a_twist_that_the_hands_do_not_have_is_named(
    carried: Carried,
    off: Array,
    fails: bool,
) -> None:
    before = [T[:3, 3].copy() for T in KINEMATICS.tcp_poses(carried.world.q)]
    carried.sensor.twist_off = tuple(off.tolist())
    carried.run(1500)
    assert carried.names == (["controller_failed"] if fails else [])
    if fails:
        assert carried.stack.reflex is not None
        assert "off the motion of its pose" in carried.stack.reflex.message
    assert moved_m(carried, before) < 0.03


def test_a_noisy_twist_and_a_small_slide_are_no_faults(carried: Carried) -> None:
    """0.02 m/s and 0.2 rad/s of white noise along each axis in every step, and 20 mm."""
    rng = np.random.default_rng(0)

    def noise() -> None:
        twist = rng.standard_normal(6) * np.repeat([0.02, 0.2], 3)
        carried.sensor.twist_off = tuple(twist.tolist())

    carried.run(1500, noise)
    carried.sensor.off_m = (0.0, 0.02, 0.0)
    carried.run(800)
    assert carried.names == []


class Reusing(HandsObject):
    """A sensor that returns the same array in each reading."""

    array = np.eye(4)

    def read(self) -> tuple[ObjectState, float]:
        state, felt_n = super().read()
        self.array[:] = state.T_world_object
        return ObjectState(self.array, state.twist), felt_n


def test_a_sensor_may_reuse_its_array(scene: SceneConfig) -> None:
    """An object that is pushed away comes back to where it was held."""
    plant = Arms(scene)
    here = Reusing(plant)
    stack: ControlStack = supervised(plant, sensor=here)
    stack.impedance.configure(here.held())
    hand_over(stack, "moveit", OBJECT_CONTROLLERS)
    start_m = here.pose()[1, 3]
    run(stack, 300)
    left, right = KINEMATICS.tcp_jacobians(plant.q)
    plant.pushed = 5.0 * (left + right)[1]
    run(stack, 500)
    assert here.pose()[1, 3] - start_m > 0.01
    plant.touch_nothing()
    run(stack, 2000)
    assert abs(here.pose()[1, 3] - start_m) < 0.001
