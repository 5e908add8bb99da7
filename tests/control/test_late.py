"""Packets that overtake one another or come late, and what a stop, a hold and a fresh start make of them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np
import pytest

from minidual.config.scene import SceneConfig
from minidual.control.commands import JointCommand, ObjectCommand
from minidual.control.supervisor import Supervisor
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.skills.object_path import ObjectPath, Waypoint
from tests.support.carried_rod import Carried
from tests.support.panda import HOME
from tests.support.stacks import (
    CLOSED,
    Arms,
    FailingPlant,
    hand_over,
    move,
    run,
    stack_on,
    supervised,
    trajectory,
)

WAY = np.tile([0.8, 0.4, 0.0, 0.5, 0.0, 0.4, 0.5], 2)


class Net:
    """Delivers what a plant measured `late(tick)` ticks ago, with its true stamp."""

    def __init__(self, plant: Arms, late: Callable[[int], int] = lambda tick: 0) -> None:
        self.plant = plant
        self.late = late
        self._tick = 0
        self._sent = deque([(plant.q.copy(), plant.v.copy(), plant.time)], maxlen=60)

    def step(self) -> None:
        self.plant.step()
        self._tick += 1
        self._sent.append((self.plant.q.copy(), self.plant.v.copy(), self.plant.time))

    def _last(self) -> tuple[Array, Array, float]:
        return self._sent[-1 - min(self.late(self._tick), len(self._sent) - 1)]

    @property
    def q(self) -> Array:
        return self._last()[0].copy()

    @property
    def v(self) -> Array:
        return self._last()[1].copy()

    @property
    def stamp_s(self) -> float:
        return self._last()[2]

    def __getattr__(self, name: str):
        return getattr(self.__dict__["plant"], name)


def reordered(share: float, most: int, seed: int = 0) -> Callable[[int], int]:
    """Return a lateness by tick: up to `most` ticks for a share of the packets."""
    rng = np.random.default_rng(seed)
    late = np.where(rng.random(8000) < share, rng.integers(1, most + 1, 8000), 0).tolist()
    return late.__getitem__


@pytest.mark.parametrize(("share", "most"), [(0.05, 15), (0.5, 8)])
def test_a_stop_rests_when_packets_overtake_one_another(
    scene: SceneConfig,
    share: float,
    most: int,
) -> None:
    """Before, all readings were judged lost, and the latched stop flailed at 13 to 42 rad/s."""
    net = Net(Arms(scene))
    stack = supervised(net)
    hand_over(stack, "moveit")
    assert stack.propose("moveit", trajectory(stack, move(HOME, HOME + WAY, 0.9))) is None
    for _ in range(430):
        stack.affirm("moveit")
        stack.step()
    assert np.abs(net.plant.v).max() > 1.5
    stack.supervisor.estop()
    assert run(stack, 1) == ["emergency_stop"]
    net.late = reordered(share, most)
    assert run(stack, 400) == []
    fastest = 0.0
    for _ in range(2600):
        stack.step()
        fastest = max(fastest, float(np.abs(net.plant.v).max()))
    assert fastest < 0.05


@pytest.mark.parametrize("late_s", [0.004, 0.012, 0.0197])
def test_a_stop_rests_when_its_stamps_jump_back_and_stay_there(
    scene: SceneConfig,
    late_s: float,
) -> None:
    """Where each was taken for an overtaken packet, the stop sped up to 2.4 rad/s (the random driver's seed 4690)."""
    plant = FailingPlant(scene)
    stack = supervised(plant)
    hand_over(stack, "moveit")
    assert stack.propose("moveit", trajectory(stack, move(HOME, HOME + WAY, 0.9))) is None
    for _ in range(430):
        stack.affirm("moveit")
        stack.step()
    stack.supervisor.estop()
    assert run(stack, 1) == ["emergency_stop"]
    plant.lies["stamp_s"] = lambda t: t - late_s
    assert run(stack, 1500) == []
    assert not stack.supervisor._sense.lost[1].any(), "the velocities are sound"
    assert np.abs(plant.__dict__["v"]).max() < 0.05


@pytest.mark.parametrize(
    "late",
    [lambda tick: tick % 2, reordered(0.5, 8), lambda tick: 5 if tick % 20 == 0 else 0],
)
def test_sound_motion_goes_on_when_packets_overtake_one_another(
    scene: SceneConfig,
    late: Callable[[int], int],
) -> None:
    """Before, `implausible_measurement` blamed the encoders."""
    net = Net(Arms(scene))
    stack = supervised(net)
    hand_over(stack, "moveit")
    assert stack.propose("moveit", trajectory(stack, move(HOME, HOME + WAY, 0.9))) is None
    net.late = late
    for _ in range(1200):
        stack.affirm("moveit")
        stack.step()
    assert np.abs(net.plant.q - HOME - WAY).max() < 0.01


def test_a_sensor_that_freezes_among_overtaken_packets_is_still_named(scene: SceneConfig) -> None:
    net = Net(Arms(scene), reordered(0.2, 8))
    stack = supervised(net)
    hand_over(stack, "moveit")
    assert stack.propose("moveit", trajectory(stack, move(HOME, HOME + WAY, 0.9))) is None
    for _ in range(300):
        stack.affirm("moveit")
        stack.step()
    frozen = net.plant.q[3]
    sound = net._last

    def stuck() -> tuple[Array, Array, float]:
        q, v, stamp_s = sound()
        q[3] = frozen
        return q, v, stamp_s

    net._last = stuck
    assert run(stack, 100)[:1] == ["measurement.implausible"]


def test_measurements_that_are_always_late_are_named_by_their_age(scene: SceneConfig) -> None:
    """Before, 40 ms were `joint_velocity`, 80 ms `cartesian_contact`, and the latched stop diverged."""
    net = Net(Arms(scene))
    stack = supervised(net)
    assert run(stack, 100) == []
    net.late = lambda tick: min(50, tick // 10)  # grows by 1 ms in 10
    assert run(stack, 600) == ["controller_failed"]
    assert "the measurements are 0.02" in str(stack.reflex)
    for _ in range(1500):
        stack.step()
    assert np.abs(net.plant.v).max() < 0.01


@pytest.mark.parametrize("late", [14, 19])
def test_a_fresh_start_and_a_recovery_on_late_measurements_feel_no_contact(
    scene: SceneConfig,
    late: int,
) -> None:
    """Before, `joint_stuck` or `cartesian_contact` in 20 ms: torques before the start counted as zero."""
    net = Net(Arms(scene), lambda tick: late)
    stack = supervised(net)
    assert run(stack, 500) == []
    stack.supervisor.estop()
    assert run(stack, 600) == ["emergency_stop"]
    stack.recover()
    assert run(stack, 600) == []


@pytest.mark.parametrize("closed", [False, True])
def test_an_open_hand_that_is_leant_on_learns_no_load(
    scene: SceneConfig,
    kinematics: Kinematics,
    closed: bool,
) -> None:
    """Before, it bore 16 N, and a later stop lifted it by 41 mm, a halt by 92 mm."""
    plant = Arms(scene)
    stack = supervised(plant)
    rise = kinematics.tcp_jacobians(HOME)[0][2]
    if closed:
        plant.grip = np.array([60.0, 60.0])
        plant.fingers = np.array([0.01, 0.01])
        plant.limp = True
        stack.reset()
    for tick in range(2500):
        plant.pushed = -15.0 * min(1.0, tick / 300) * rise
        stack.step()
    assert (stack.payload.force_n[0] > 5.0) == closed
    assert stack.reflex is None


@pytest.mark.parametrize("how", ["halt", "estop", "silence"])
def test_a_stop_bears_what_a_driven_hand_lifts(
    scene: SceneConfig,
    kinematics: Kinematics,
    how: str,
) -> None:
    """2 kg in a teleoperated hand, of which nobody told: before, they sank by 39 mm, and by 90 in a halt."""
    plant = Arms(scene)
    quiet = 0
    plant.grip = np.array([60.0, 0.0])
    plant.fingers = np.array([0.01, 0.04])
    plant.limp = True
    stack = supervised(plant)
    hand_over(stack, "teleop")

    def step() -> list[str]:
        nonlocal quiet
        plant.pushed = -20.0 * np.r_[kinematics.tcp_jacobians(plant.q)[0][2, :7], np.zeros(7)]
        if stack.tick_next and not quiet:
            stack.propose(
                "teleop",
                JointCommand(HOME, np.array([0.0, 1.0]), plant.time, round(1e3 * plant.time)),
            )
        return run(stack, 1)

    def height_mm() -> float:
        return 1e3 * float(kinematics.tcp_poses(plant.q)[0][2, 3])

    for _ in range(1500):
        assert step() == []
    assert stack.payload.force_n == [0.0, 0.0], "a driven hand learns none"
    before = height_mm()
    quiet = 1
    if how == "halt":
        stack.halt("teleop")
    elif how == "estop":
        stack.supervisor.estop()
    found = [name for _ in range(2500) for name in step()]
    assert found == (["emergency_stop"] if how == "estop" else [])
    assert abs(height_mm() - before) < (5.0 if how != "silence" else 12.0)
    if how == "estop":
        stack.recover()
        assert [name for _ in range(1500) for name in step()] == []
        assert abs(height_mm() - before) < 12.0


@pytest.mark.parametrize("mass_kg", [0.2, 3.0])
@pytest.mark.parametrize("new", [False, True])
def test_a_program_that_begins_with_full_hands_goes_on_from_the_torques_that_hold(
    scene: SceneConfig,
    mass_kg: float,
    new: bool,
) -> None:
    """Before, a step of 21 to 23 Nm in the first tick."""
    world = World(scene)
    told = list[Array]()
    command = world.command

    def noted(tau: Array, fingers_m: Array) -> None:
        told.append(tau.copy())
        command(tau, fingers_m)

    world.command = noted
    carried = Carried(world, mass_kg)
    carried.run(800)
    n = len(told)
    height_m = carried.height_m
    if new:
        stack = stack_on(world, supervisor=Supervisor(dt_s=world.dt))
    else:
        (stack := carried.stack).reset()
    lowest_m = height_m
    for _ in range(1500):
        stack.step()
        lowest_m = min(lowest_m, carried.height_m)
    assert np.abs(np.diff(told[n - 1 :], axis=0)).max() <= 1.0 + 1e-9
    assert height_m - lowest_m < 0.007


def test_no_distance_at_all_leaves_no_tick_without_torque(scene: SceneConfig) -> None:
    """Before, an infinite one raised OverflowError out of `step`."""
    plant = FailingPlant(scene)
    stack = stack_on(
        plant,
        supervisor=Supervisor(dt_s=plant.dt, self_distance=lambda q: ("none", math.inf)),
    )
    before = len(plant.torques)
    assert run(stack, 30) == []
    assert len(plant.torques) == before + 30


@pytest.mark.parametrize("squeeze_n", [math.nan, -50.0, 1000.0])
def test_the_squeeze_of_an_object_path_is_checked_under_way(
    scene: SceneConfig,
    squeeze_n: float,
) -> None:
    """Before, -50 N had no name, and 1000 N was `torque_saturation` of a joint."""
    carried = Carried(World(scene))
    stack = carried.stack
    world = carried.world
    T = world.object_pose()
    live = [40.0]
    x, y, z = T[:3, 3].tolist()
    yaw = float(np.arctan2(T[1, 0], T[0, 0]))
    path = ObjectPath(Waypoint((x, y, z), yaw, 0.0), [Waypoint((x + 0.05, y, z), yaw, 2.0)])
    command = ObjectCommand(path, lambda t: live[0], CLOSED, world.time, carried.sequence + 1)
    assert stack.propose("moveit", command) is None
    for _ in range(600):
        stack.affirm("moveit")
        stack.step()
    live[0] = squeeze_n
    height_m = carried.height_m
    assert run(stack, 900) == ["controller_failed"]
    assert "the path's squeeze is" in str(stack.reflex)
    assert abs(carried.height_m - height_m) < 0.005


class Slow(Arms):
    """Arms that are controlled at 100 Hz."""

    def __init__(self, scene: SceneConfig) -> None:
        super().__init__(scene)
        self.dt = 0.01
        self._ticks = 0

    @property
    def time(self) -> float:
        return self.__dict__.get("_ticks", 0) * 0.01

    @time.setter
    def time(self, value: float) -> None: ...

    def step(self) -> None:
        self.dt = 1e-3
        for _ in range(10):
            super().step()
        self.dt = 0.01
        self._ticks += 1


def test_one_sample_without_grip_at_100_hz_loses_nothing(scene: SceneConfig) -> None:
    """Before, `gripper_opened`."""
    plant = Slow(scene)
    plant.grip = np.array([60.0, 60.0])
    plant.fingers = np.array([0.01, 0.01])
    plant.limp = True
    stack = supervised(plant)
    assert run(stack, 30) == []
    plant.grip = np.array([0.0, 60.0])
    assert run(stack, 1) == []
    plant.grip = np.array([60.0, 60.0])
    assert run(stack, 30) == []
    plant.grip = np.array([0.0, 60.0])
    assert run(stack, 30) == ["gripper_opened"]


def test_a_push_at_100_hz_is_named_as_one(scene: SceneConfig, kinematics: Kinematics) -> None:
    """Before, `joint_velocity` after 50 ms."""
    plant = Slow(scene)
    stack = supervised(plant)
    assert run(stack, 30) == []
    plant.pushed = 100.0 * kinematics.tcp_jacobians(HOME)[0][1]
    assert run(stack, 3) == ["contact.joint"]
