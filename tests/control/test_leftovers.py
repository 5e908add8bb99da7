"""What an earlier command, a halt, an error or another program has left behind must not move arms or drop an object."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from minidual.config.scene import SceneConfig
from minidual.control.commands import JointCommand, ObjectCommand
from minidual.control.impedance import ObjectState
from minidual.control.stack import DEFAULT_CONTROLLERS, ControlStack
from minidual.control.supervisor import Supervisor
from minidual.errors import UsageError
from minidual.plant.world import World
from minidual.robot.pair import Array
from minidual.skills.object_path import ObjectPath, Waypoint
from tests.support.carried_rod import Carried
from tests.support.panda import HOME
from tests.support.random_driver import Driver
from tests.support.stacks import (
    CLOSED,
    OPEN,
    Arms,
    FailingPlant,
    hand_over,
    move,
    run,
    stack_on,
    supervised,
    trajectory,
    under_way,
)

WAY = np.array([0.9, 0.9, 0.0, 0.0, 0.0, 0.0, 0.0])


def halted(stack: ControlStack) -> None:
    """Halt a trajectory at 1.9 rad/s, and wait for rest."""
    hand_over(stack, "moveit")
    assert (
        stack.propose("moveit", trajectory(stack, move(HOME, HOME + np.tile(WAY, 2), 0.9))) is None
    )
    for _ in range(450):
        stack.affirm("moveit")
        stack.step()
    assert np.abs(stack.plant.v).max() > 1.5
    stack.halt("moveit")
    for _ in range(1200):
        stack.step()


def strayed(stack: ControlStack, ticks: int = 1500) -> float:
    """Return how far the arms move [rad]."""
    rest = stack.plant.q.copy()
    far = 0.0
    for _ in range(ticks):
        stack.step()
        far = max(far, float(np.abs(stack.plant.q - rest).max()))
    return far


def test_after_a_halt_a_change_of_controllers_moves_nothing(scene: SceneConfig) -> None:
    """Before, the arms went on to the halted command's target: 0.42 rad at 2.3 rad/s, and nobody drove."""
    stack = supervised(Arms(scene))
    halted(stack)
    stack.switch_controllers(DEFAULT_CONTROLLERS)
    assert strayed(stack) < 1e-3


def test_after_a_halt_one_lost_packet_moves_nothing(scene: SceneConfig) -> None:
    """Without a supervisor; before, 0.56 rad."""
    plant = FailingPlant(scene)
    stack = stack_on(plant)
    halted(stack)
    plant.lies["health"] = lambda _: "a packet was lost"
    with pytest.raises(Exception, match="a packet was lost"):
        stack.step()
    plant.lies.clear()
    assert strayed(stack) < 1e-3


def test_after_an_error_without_a_supervisor_nothing_of_the_old_trajectory_comes_back(
    scene: SceneConfig,
) -> None:
    """Before, at the end of the next trajectory the reference jumped by 0.53 rad and the torque by 90 Nm."""
    plant = Arms(scene)
    stack = stack_on(plant)
    hand_over(stack, "moveit")
    way = np.array([0.9, 0.5, 0.0, 0.6, 0.0, 0.0, 0.0])
    assert (
        stack.propose(
            "moveit",
            trajectory(stack, move(HOME[:7], HOME[:7] + way, 0.9, "left_arm"), group="left_arm"),
        )
        is None
    )
    run(stack, 450)
    plant.lies["health"] = lambda _: "a packet was lost"
    with pytest.raises(Exception, match="a packet was lost"):
        stack.step()
    plant.lies.clear()
    run(stack, 1000)
    hand_over(stack, "moveit")
    q = plant.q.copy()
    assert (
        stack.propose(
            "moveit",
            trajectory(stack, move(q[:7], q[:7] - 0.8 * way, 0.9, "left_arm"), 2, group="left_arm"),
        )
        is None
    )
    references = []
    first = len(plant.torques)
    for _ in range(1500):
        stack.affirm("moveit")
        stack.step()
        references.append(stack.manager.reference.copy())
    assert np.abs(np.diff(references, axis=0)).max() < 0.005
    assert np.abs(np.diff(plant.torques[first:], axis=0)).max() < 10.0
    np.testing.assert_allclose(plant.q[:7], q[:7] - 0.8 * way, atol=0.01)


@pytest.mark.parametrize("step_rad", [0.02, 0.04])
def test_a_trajectory_does_not_begin_on_an_arm_that_moves(
    scene: SceneConfig,
    step_rad: float,
) -> None:
    """Before, the reference stopped at once: 86 Nm in 1 ms without a supervisor, `torque_saturation` with one."""
    plant = Arms(scene)
    stack = supervised(plant)
    q = HOME.copy()
    hand_over(stack, "moveit")
    sequence = 0
    for _ in range(461):
        if stack.tick_next:
            sequence += 1
            q = q + step_rad * np.sign(np.tile(WAY, 2))
            stack.propose("moveit", JointCommand(q, OPEN, plant.time, sequence))
        stack.step()
    assert np.abs(plant.v).max() > 0.7
    stack.propose(
        "moveit",
        trajectory(stack, move(plant.q, plant.q + 0.1 * np.eye(14)[6], 1.0), sequence + 1),
    )
    assert run(stack, 20) == []
    assert "not_still" in [refusal.name for refusal in stack.refusals]
    assert run(stack, 1000) == []


@pytest.mark.parametrize("anew", ["reset", "another stack"])
def test_control_that_begins_anew_lets_no_object_fall(world: World, anew: str) -> None:
    """Before, hands at rest that held the rod were told to open in the first tick."""
    carried = Carried(world)
    carried.run(800)
    stack = carried.stack
    if anew == "reset":
        stack.reset()
    else:
        stack = stack_on(world, supervisor=Supervisor(dt_s=world.dt))
    assert run(stack, 1500) == []
    assert carried.height_m > 0.13
    assert stack.output.gripper.tolist() == [0.0, 0.0]


@pytest.mark.parametrize("mode", ["hold", "policy"])
def test_a_velocity_that_reads_zero_once_confirms_no_switch(scene: SceneConfig, mode: str) -> None:
    """Before, a policy was let in at 1.97 rad/s."""
    plant = FailingPlant(scene)
    stack = supervised(plant)
    q = HOME.copy()
    hand_over(stack, "teleop")
    for sequence in range(23):
        q = q + 0.04 * np.eye(14)[0]
        stack.propose("teleop", JointCommand(q, OPEN, plant.time, sequence + 1))
        run(stack, stack.every)
    assert np.abs(plant.v).max() > 1.5
    stack.request(mode)
    run(stack, stack.every - 1)
    assert stack.state == "settling"
    while not stack.tick_next:
        run(stack, 1)
    plant.lies["v"] = lambda v: 0.0 * v
    run(stack, 1)
    plant.lies.clear()
    assert np.abs(plant.v).max() > 0.5
    assert stack.state == "settling"


def test_a_reset_does_not_believe_velocities_alone(scene: SceneConfig) -> None:
    """Before, it was let in at 1.48 rad/s."""
    plant = FailingPlant(scene)
    stack = under_way(plant)
    plant.lies["v"] = lambda v: 0.0 * v
    with pytest.raises(UsageError, match="control starts at rest"):
        stack.reset()


class Motion:
    """An object path that stays, unless `lie` changes a state; it may return the same array each time."""

    duration_s = 2.0

    def __init__(self, T: Array, *, reuses: bool = False) -> None:
        self._T = T.copy()
        self._kept = T.copy()
        self._reuses = reuses
        self.lie: Callable[[ObjectState, float], ObjectState] = lambda state, t: state

    def at(self, t_s: float) -> ObjectState:
        state = self.lie(ObjectState(self._T.copy(), np.zeros(6), np.zeros(6)), t_s)
        if not self._reuses:
            return state
        self._kept[:] = state.T_world_object
        return state._replace(T_world_object=self._kept)


def offer(carried: Carried, motion: Any) -> str | None:
    carried.sequence += 1
    stamp_s = carried.world.time
    refusal = carried.stack.propose(
        "moveit",
        ObjectCommand(motion, lambda _: 40.0, CLOSED, stamp_s, carried.sequence),
    )
    return None if refusal is None else refusal.name


def jump(state: ObjectState, t_s: float) -> ObjectState:
    T = state.T_world_object.copy()
    T[1, 3] += 0.12 if t_s > 0.5 else 0.0
    return state._replace(T_world_object=T)


@pytest.mark.parametrize("reuses", [False, True])
def test_a_path_that_reuses_its_array_is_checked_like_any_other(world: World, reuses: bool) -> None:
    """Before, a jump of 120 mm was followed: an array was compared with itself."""
    carried = Carried(world)
    motion = Motion(world.object_pose(), reuses=reuses)
    motion.lie = jump
    assert offer(carried, motion) == "pose_jump"
    motion.lie = lambda state, _: state
    assert offer(carried, motion) is None
    carried.run(100)
    motion.lie = jump  # under way
    before = world.object_pose()[:3, 3].copy()
    carried.run(1000)
    assert carried.names == ["controller_failed"]
    assert np.linalg.norm(world.object_pose()[:3, 3] - before) < 0.01


@pytest.mark.parametrize(
    "lie",
    [
        lambda state, t: state._replace(acceleration=(20.0 if t > 0.5 else 0.0) * np.eye(6)[1]),
        lambda state, t: state._replace(twist=(4.0 if t > 0.5 else 0.0) * np.eye(6)[5]),
    ],
)
def test_the_motion_of_a_path_is_checked_under_way_too(
    world: World,
    lie: Callable[[ObjectState, float], ObjectState],
) -> None:
    """Before, an acceleration of 20 m/s^2 moved the object by 97 mm, joints at 1.19 times their limit."""
    carried = Carried(world)
    motion = Motion(world.object_pose())
    assert offer(carried, motion) is None
    carried.run(100)
    motion.lie = lie
    before = world.object_pose()[:3, 3].copy()
    carried.run(1000)
    assert carried.names == ["controller_failed"]
    assert np.linalg.norm(world.object_pose()[:3, 3] - before) < 0.01


def test_a_turn_that_no_arm_can_follow_is_refused(world: World) -> None:
    carried = Carried(world)
    T = world.object_pose()
    yaw = float(np.arctan2(T[1, 0], T[0, 0]))
    p = tuple(T[:3, 3].tolist())
    start = Waypoint(p, yaw, 0.0)
    assert offer(carried, ObjectPath(start, [Waypoint(p, yaw + 1.5, 0.8)])) == "too_fast"
    assert offer(carried, ObjectPath(start, [Waypoint(p, yaw + 0.6, 0.45)])) == "too_sharp"
    assert offer(carried, ObjectPath(start, [Waypoint(p, yaw + 0.6, 2.0)])) is None


@pytest.mark.parametrize(("by_m", "duration_s"), [((0.2, 0.0, 0.0), 0.6), ((0.0, 0.0, 0.25), 0.8)])
def test_a_path_that_left_its_object_behind_presses_no_longer(
    world: World,
    by_m: tuple[float, float, float],
    duration_s: float,
) -> None:
    """An object is held back with 40 N and then let go. Before, it leapt by 97 and 75 mm at 0.15 m/s."""
    carried = Carried(world)
    body = world.model.body("rod").id
    carried.carry(by_m, duration_s)
    start = world.object_pose()[:3, 3].copy()
    along = np.array(by_m) / np.linalg.norm(by_m)
    pressed_n = 0.0
    for _ in range(3500):
        p = world.object_pose()[:3, 3]
        v = world.truth().twist()[:3]
        pressed_n = float(
            np.clip(3000.0 * (along @ (start - p)) - 100.0 * (along @ v), -40.0, 40.0),
        )
        world.data.xfrc_applied[body, :3] = pressed_n * along
        carried.run(1)
    world.data.xfrc_applied[body] = 0.0
    assert "off_path" in [refusal.name for refusal in carried.stack.refusals]
    assert abs(pressed_n) < 10.0
    held = world.object_pose()[:3, 3].copy()
    far = 0.0
    for _ in range(1000):
        carried.run(1)
        far = max(far, float(np.linalg.norm(world.object_pose()[:3, 3] - held)))
    assert far < 0.025
    assert carried.names == []


class Rarely(FailingPlant):
    """Exact measurements that arrive every `period` ticks, with true stamps."""

    def __init__(self, scene: SceneConfig, period: int) -> None:
        self.period = period
        self.kept = dict[str, Any]()
        super().__init__(scene)
        for name in ("q", "v", "stamp_s"):
            self.lies[name] = lambda value, name=name: self.kept.get(name, value)

    def step(self) -> None:
        super().step()
        if self.steps % self.period == 0:
            kept = self.lies
            self.lies = {}
            self.kept = {"q": self.q.copy(), "v": self.v.copy(), "stamp_s": self.time}
            self.lies = kept


@pytest.mark.parametrize("period", [5, 12, 15, 19])
def test_exact_readings_that_come_rarely_are_plausible(scene: SceneConfig, period: int) -> None:
    """Before, an ordinary motion was stopped (`implausible_measurement`): a mean rate was taken for the last one."""
    plant = Rarely(scene, period)
    stack = supervised(plant)
    hand_over(stack, "moveit")
    goal = HOME + 1.2 * np.eye(14)[6]
    assert stack.propose("moveit", trajectory(stack, move(HOME, goal, 0.9))) is None
    names = []
    for _ in range(1500):
        stack.affirm("moveit")
        names += run(stack, 1)
    assert names == []
    np.testing.assert_allclose(plant.__dict__["q"], goal, atol=0.02)


@pytest.mark.parametrize("rate_hz", [50.0, 10.0])
def test_a_halt_from_a_flush_listener_acts_in_the_next_step(
    scene: SceneConfig,
    rate_hz: float,
) -> None:
    """Before, it waited for the arbiter's next regular tick: 70 ms at 10 Hz."""
    plant = Arms(scene)
    stack = supervised(plant, rate_hz=rate_hz)
    asked = list[int]()
    hand_over(stack, "moveit")
    assert (
        stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.8 * np.eye(14)[0], 0.9)))
        is None
    )
    run(stack, 430)

    def listener(mode: str) -> None:
        if not asked:
            asked.append(plant.steps)
            stack.halt("teleop")

    stack.on_flush(listener)
    stack.request("teleop")
    while not stack.output.halted and plant.steps < 2000:
        run(stack, 1)
    assert plant.steps - asked[0] <= 2


def test_a_latched_stop_learns_no_load_while_the_arbiter_fails(scene: SceneConfig) -> None:
    """The clock jumps back, power is lost and returns: before, the stop bore 30 N that nothing weighs."""
    driver = Driver(scene)
    driver.play(5071)
    assert driver.seen["clock"] > 0
    assert max(driver.stack.payload.force_n) < 5.0
