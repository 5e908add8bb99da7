"""What a latched stop makes of measurements that come back, of one wrong sample, of fingers and of readers that write."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from minidual.config.scene import SceneConfig
from minidual.control.commands import JointCommand, TrajectoryCommand
from minidual.plant.world import World
from minidual.robot.pair import Array
from tests.support.carried_rod import Carried
from tests.support.control_plant import ArmsPlant
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

JOINT_2 = np.eye(14)[1]


class Gap:
    """A world whose measurements can be changed, or stop."""

    def __init__(self, world: World) -> None:
        self.__dict__.update(world=world, instead={})

    def __getattr__(self, name: str) -> Any:
        change = self.__dict__["instead"].get(name, lambda value: value)
        return change(getattr(self.__dict__["world"], name))

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self.world, name, value)

    def stop(self, *names: str) -> None:
        for name in names:
            kept = np.copy(getattr(self.world, name))[()]
            self.instead[name] = lambda value, kept=kept: np.copy(kept)[()]


def nan_left(value: Array) -> Array:
    return np.where(np.arange(14) < 7, np.nan, value)


GAPS: dict[str, tuple[int, Callable[[Gap], None]]] = {
    "one packet of NaN": (1, lambda gap: gap.instead.update(q=nan_left, v=nan_left)),
    "25 ms of NaN": (25, lambda gap: gap.instead.update(q=nan_left, v=nan_left)),
    "25 ms without packets": (25, lambda gap: gap.stop("q", "v", "stamp_s", "fingers", "grip")),
    "100 ms without packets": (100, lambda gap: gap.stop("q", "v", "stamp_s", "fingers", "grip")),
    "25 ms of the same values": (25, lambda gap: gap.stop("q", "v")),
}


@pytest.mark.parametrize("moving", [False, True], ids=["at rest", "in a carry"])
@pytest.mark.parametrize("kind", GAPS)
def test_a_stop_looks_again_when_measurements_come_back(
    world: World,
    kind: str,
    moving: bool,
) -> None:
    """Before, one packet of NaN let the stopped arms reach 10 rad/s and drop the rod; 25 ms without packets, 18 rad/s."""
    gap = Gap(world)
    carried = Carried(gap)  # type: ignore[arg-type]
    if moving:
        carried.carry((0.25, 0.0, 0.05), 0.9)
        carried.run(850)
        assert np.abs(world.v).max() > 1.0
    ticks, begin = GAPS[kind]
    begin(gap)
    carried.run(ticks)
    gap.instead.clear()
    carried.run(600)
    if kind == "25 ms of the same values" and not moving:
        assert carried.names == []  # nothing moved that could have changed
    else:
        assert len(carried.names) == 1
        assert carried.names[0] in (
            "not_finite",
            "stale_measurement",
            "controller_failed",
            "implausible_measurement",
        )
    fastest = 0.0
    height_m = carried.height_m
    for _ in range(2000):
        carried.run(1)
        fastest = max(fastest, float(np.abs(world.v).max()))
    assert fastest < 0.05
    assert abs(carried.height_m - height_m) < 0.001
    assert carried.height_m > 0.14
    if carried.names:
        carried.stack.recover()
        carried.run(300)
        assert len(carried.names) == 1


@pytest.mark.parametrize("how", ["joint_velocity", "emergency_stop", "halt"])
def test_one_wrong_velocity_moves_no_resting_arm_in_a_stop(scene: SceneConfig, how: str) -> None:
    """Before, the stop began at the wrong speed: 0.41 rad at 1.74 rad/s, 0.35 rad, and 0.18 rad."""
    plant = FailingPlant(scene)
    stack = supervised(plant)
    hand_over(stack, "moveit")
    assert run(stack, 200) == []
    plant.lies["v"] = lambda v: v + (3.0 if how == "joint_velocity" else 2.0) * JOINT_2
    if how == "emergency_stop":
        stack.supervisor.estop()
    if how == "halt":
        stack.halt("moveit")
    names = run(stack, 1)
    plant.lies.clear()
    far = 0.0
    for _ in range(1500):
        names += run(stack, 1)
        far = max(far, float(np.abs(plant.q - HOME).max()))
    assert names == ([] if how == "halt" else [how])
    assert far < 0.005


class Slow(Arms):
    """Controlled at 50 Hz; its physics stays at 1 kHz."""

    def __init__(self, scene: SceneConfig) -> None:
        super().__init__(scene)
        self.dt = 0.02

    @property
    def time(self) -> float:
        return self.steps * 1e-3

    def step(self) -> None:
        self.dt = 1e-3
        for _ in range(20):
            super().step()
        self.dt = 0.02


@pytest.mark.parametrize(
    ("joint", "push_nm", "peak_rad_s"),
    [(0, 40.0, 2.4), (1, 60.0, 1.6), (3, 25.0, 1.0)],
)
def test_a_latched_arm_that_is_pushed_away_does_not_spring_back(
    scene: SceneConfig,
    joint: int,
    push_nm: float,
    peak_rad_s: float,
) -> None:
    """Let go half a radian away, it came back all the way, at 3.3, 1.8 and 1.7 rad/s; now by 0.11 rad."""
    plant = Arms(scene)
    stack = supervised(plant)
    hand_over(stack, "moveit")
    stack.supervisor.estop()
    assert run(stack, 200) == ["emergency_stop"]
    for k in range(1500):
        plant.pushed = push_nm * min(1.0, k / 300.0) * np.eye(14)[joint]
        run(stack, 1)
    away = plant.q - HOME
    assert np.abs(away).max() > 0.4
    plant.touch_nothing()
    fastest = 0.0
    for _ in range(1500):
        run(stack, 1)
        fastest = max(fastest, float(np.abs(plant.v).max()))
    assert np.abs(plant.q - HOME - away).max() < 0.12
    assert fastest < peak_rad_s
    assert np.abs(plant.v).max() < 0.01


@pytest.mark.parametrize("lie", ["jump", "frozen"])
def test_a_plant_of_50_hz_is_checked_too(scene: SceneConfig, lie: str) -> None:
    """Before, rounding of its stamps began each comparison anew: 0.3 rad were `tracking_error` after 60 ms."""
    plant = Slow(scene)
    stack = supervised(plant)
    hand_over(stack, "moveit")
    assert stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.4, 2.0))) is None
    assert run(stack, 40) == []
    frozen = plant.q.copy()
    plant.lies["q"] = (
        (lambda q: q + 0.3 * JOINT_2) if lie == "jump" else lambda q: np.where(JOINT_2, frozen, q)
    )
    assert run(stack, 2) == ["implausible_measurement"]
    run(stack, 150)
    assert np.abs(plant.__dict__["v"]).max() < 0.2


def test_who_reads_the_output_cannot_drive_with_it(plant: ArmsPlant) -> None:
    """Before, it moved a joint by 0.5 rad at 2.1 rad/s, and opened both hands: the rod fell, and no fault said so."""
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


def test_an_emergency_stop_stops_closing_fingers(world: World) -> None:
    """Before, they closed to the end and pinched with 48 N: somebody's finger may be why it was pressed."""
    stack = supervised(world)
    hand_over(stack, "teleop")
    stack.propose("teleop", JointCommand(world.q, CLOSED, world.time, 1))
    run(stack, 200)
    began_m = world.fingers.copy()
    assert began_m.min() > 0.02
    assert began_m.max() < 0.039
    stack.supervisor.estop()
    assert run(stack, 1500) == ["emergency_stop"]
    assert np.abs(world.fingers - began_m).max() < 0.002
    assert world.grip.max() < 5.0
    stack.recover()
    run(stack, 1500)
    assert world.fingers.max() < 0.001, "what was commanded goes on"


def test_an_emergency_stop_keeps_what_closed_hands_hold(world: World) -> None:
    carried = Carried(world)
    carried.stack.supervisor.estop()
    carried.run(1500)
    assert carried.names == ["emergency_stop"]
    assert carried.height_m > 0.14
    assert world.grip.min() > 55.0


@pytest.fixture
def plant(scene: SceneConfig) -> ArmsPlant:
    return ArmsPlant(scene)


@pytest.mark.parametrize("how", ["halt", "emergency_stop"])
def test_a_closed_hand_that_holds_nothing_learns_nobodys_weight(world: World, how: str) -> None:
    """Before, 28 N that somebody leant on it were learnt: it rose by 175 mm in a halt, by 72 in an emergency stop."""
    stack = supervised(world)
    hand_over(stack, "teleop")
    stack.propose("teleop", JointCommand(world.q, CLOSED, world.time, 1))
    run(stack, 400)
    stack.request("hold")
    run(stack, 800)
    before_m = float(world.data.body("left_panda_hand_tcp").xpos[2])
    hand = world.model.body("left_panda_hand").id
    world.data.xfrc_applied[hand, 2] = -20.0
    assert run(stack, 3000) == []
    world.data.xfrc_applied[hand, 2] = 0.0
    if how == "halt":
        stack.halt("teleop")
    else:
        stack.supervisor.estop()
    assert run(stack, 1500) == ([] if how == "halt" else [how])
    assert stack.payload.force_n == [0.0, 0.0]
    assert float(world.data.body("left_panda_hand_tcp").xpos[2]) < before_m + 0.001


def test_a_long_trajectory_does_not_hold_up_the_tick_in_which_it_starts(scene: SceneConfig) -> None:
    """Before, 60 s were sampled at once, which took 131 ms; its rows are those of the whole."""
    plant = Arms(scene)
    stack = stack_on(plant)
    hand_over(stack, "moveit")
    sampled: list[int] = []
    command: TrajectoryCommand = trajectory(stack, move(HOME, HOME + 0.4, 60.0))
    whole = command.motion.sample_many
    object.__setattr__(command.motion, "sample_many", lambda t: sampled.append(len(t)) or whole(t))
    assert stack.propose("moveit", command) is None
    sampled.clear()
    asked = []
    for _ in range(1500):
        stack.affirm("moveit")
        stack.step()
        asked.append(stack.manager.reference.copy())
    assert max(sampled) <= 500
    first = next(k for k, q in enumerate(asked) if not np.array_equal(q, HOME)) - 1
    np.testing.assert_allclose(
        asked[first:],
        whole(np.arange(len(asked) - first) * plant.dt)[0],
        atol=1e-12,
    )
