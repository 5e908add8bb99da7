"""What `recover()` begins with, and grips that are lost beside it: both hands hold the rod in the air."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from minidual.config.scene import SceneConfig
from minidual.control.reflexes import ReflexError
from minidual.control.supervisor import Supervisor
from minidual.plant.world import World
from minidual.robot.pair import Array
from minidual.robot.trajectory import Trajectory
from tests.support.carried_rod import KINEMATICS, Carried
from tests.support.panda import HOME
from tests.support.stacks import FailingPlant, hand_over, move, stack_on, trajectory

CLOSED = np.zeros(2)
BOTH = ("both_arms",)


@pytest.fixture
def plant(scene: SceneConfig) -> FailingPlant:
    return FailingPlant(scene)


@pytest.fixture
def carried(world: World) -> Carried:
    return Carried(world)


@pytest.mark.parametrize("change", ["switch", "halt"])
def test_a_recovery_does_not_go_on_with_torques_that_were_never_applied(
    carried: Carried,
    change: str,
) -> None:
    """Before, 4.1 rad/s and 93 mm: the fade of the switch began from what the law asked for in the stop."""
    carried.lose()
    carried.run(1000)
    assert carried.names
    if change == "switch":
        carried.stack.switch_controllers(BOTH)
    else:
        carried.stack.halt("moveit")
    carried.fastest = 0.0
    tips = KINEMATICS.tcp_poses(carried.world.q)
    carried.stack.recover()
    carried.run(600)
    now = KINEMATICS.tcp_poses(carried.world.q)
    assert carried.fastest < 0.05
    assert max(np.linalg.norm((a - b)[:3, 3]) for a, b in zip(tips, now, strict=True)) < 0.002


def test_a_recovery_that_fails_leaves_the_stop_latched(carried: Carried) -> None:
    """Before, the arms went on to the old desired pose (27 mm), and the squeeze fell from 40 to 3 N."""
    carried.carry((0.0, -0.3, 0.0), 1.5)
    carried.run(700)
    carried.stop()
    carried.sensor.failing = True
    with pytest.raises(OSError, match="camera is gone"):
        carried.stack.recover()
    carried.sensor.failing = False
    before = carried.world.object_pose()
    assert carried.stack.reflex is not None
    carried.run(600)
    assert np.linalg.norm((carried.world.object_pose() - before)[:3, 3]) < 1e-3
    carried.stack.recover()
    carried.run(600)
    assert carried.names == ["emergency_stop"]


@pytest.mark.parametrize("latched", [False, True])
def test_nan_in_a_halt_does_not_prevent_a_recovery(plant: FailingPlant, latched: bool) -> None:
    """Before, each recovery ended in `not_finite`, with all sensors sound."""
    stack = stack_on(plant, supervisor=Supervisor(dt_s=plant.dt))
    hand_over(stack, "moveit")
    assert (
        stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.3, 0.6), gripper=CLOSED))
        is None
    )
    names: list[str] = []

    def run(ticks: int) -> None:
        for _ in range(ticks):
            try:
                stack.step()
            except ReflexError as error:
                names.append(error.reflex.label)

    run(130)
    if not latched:
        stack.halt("moveit")
        run(3)
    plant.lies["q"] = lambda q: q * np.nan
    run(1)
    if latched:
        stack.halt("moveit")
        run(1)
    plant.lies.clear()
    run(1000)
    stack.recover()
    run(600)
    assert names == ["not_finite"]
    hand_over(stack, "moveit")


@pytest.mark.parametrize("off_m", [(0.05, 0.0, 0.0), (0.0, 0.0, -0.06), (np.nan, 0.0, 0.0)])
def test_a_pose_that_jumps_in_a_hold_stops_the_arms_by_its_name(
    carried: Carried,
    off_m: tuple[float, ...],
) -> None:
    """Before, a jump of 50 mm drove joints by 0.12 rad to where the object was not, and no fault said so."""
    stack = carried.stack
    q = carried.world.q.copy()
    carried.sensor.off_m = off_m
    carried.run(600)
    assert len(carried.names) == 1
    assert stack.reflex is not None
    if np.isfinite(off_m).all():
        assert f"the object is {1e3 * abs(sum(off_m)):.0f} mm" in stack.reflex.message
        assert "away from where the left hand holds it" in stack.reflex.message
    assert np.abs(carried.world.q - q).max() < 0.02
    assert carried.height_m > 0.13, "the hands keep what they hold"


def test_an_object_that_is_torn_out_is_named_under_joint_control(carried: Carried) -> None:
    """Before, a trial went on with empty hands: fingers that close further counted as shaken."""
    carried.stack.switch_controllers(BOTH)
    carried.hold(300)
    assert carried.names == []
    carried.lose()
    carried.hold(60)
    assert carried.names == ["gripper_opened"]


def test_a_grip_that_reads_too_high_does_not_open_the_hand_unnamed(
    carried: Carried,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Before, it opened from 9 to 40 mm; now it is named after 2 mm, and the drive stays where it is."""
    carried.stack.switch_controllers(BOTH)
    carried.hold(300)
    true = World.grip.fget
    monkeypatch.setattr(
        World,
        "grip",
        property(lambda world: true(world) * [0.0, 1.0] + [80.0, 0.0]),
    )
    held_m = float(carried.world.fingers[0])
    carried.hold(1500)
    assert carried.names == ["gripper_opened"]
    assert carried.world.fingers[0] < held_m + 0.004


def test_a_grip_that_was_lost_in_a_stop_is_named_once_after_the_recovery(carried: Carried) -> None:
    """Before, a source went on with empty hands."""
    carried.stack.switch_controllers(BOTH)
    carried.hold(300)
    carried.stop()
    carried.lose()
    carried.run(400)
    carried.stack.recover()
    carried.run(50)
    assert carried.names == ["emergency_stop", "gripper_opened"]
    carried.stack.recover()
    carried.run(400)
    assert carried.names == ["emergency_stop", "gripper_opened"]


def test_after_a_lost_grip_the_object_law_does_not_recover(scene: SceneConfig) -> None:
    """Before, the empty hand rose by 294 mm, at up to 2.2 rad/s, under the weight of 1 kg that the law bore."""
    world = World(scene)  # its own model: the mass changes
    carried = Carried(world, 1.0)
    command = world.command
    world.command = lambda tau, fingers: command(tau, np.array([0.04, fingers[1]]))  # type: ignore[method-assign]
    carried.run(1000)
    assert carried.names == ["gripper_opened"]
    carried.fastest = 0.0
    tips = KINEMATICS.tcp_poses(world.q)
    carried.stack.recover()
    carried.run(1000)
    assert carried.stack.manager.active == BOTH
    assert carried.fastest < 0.5
    assert KINEMATICS.tcp_poses(world.q)[0][2, 3] < tips[0][2, 3] + 0.005


@pytest.mark.parametrize("then_stopped", [False, True])
def test_joint_control_bears_what_the_object_law_bore(
    scene: SceneConfig,
    then_stopped: bool,
) -> None:
    """Before, 2 kg sank by 4.2 mm, and by 20 mm in an emergency stop after it."""
    carried = Carried(World(scene), 2.0)  # its own model: the mass changes
    began_m = carried.height_m
    lowest_m = carried.height_m
    carried.stack.switch_controllers(BOTH)
    carried.run(400)
    if then_stopped:
        carried.stop()
    for _ in range(100):
        carried.run(10)
        lowest_m = min(lowest_m, carried.height_m)
    assert lowest_m > began_m - 0.001


@pytest.mark.parametrize("every", [1, 50])
def test_velocities_that_do_not_belong_to_their_positions_are_refused(
    plant: FailingPlant,
    every: int,
) -> None:
    """Waypoints with zero velocities: before, the reference had up to 41 times the acceleration limit."""
    stack = stack_on(plant, supervisor=Supervisor(dt_s=plant.dt))
    hand_over(stack, "moveit")
    motion = move(HOME, HOME + 0.4, 0.8)
    q = motion.q[::every]
    still = Trajectory(np.arange(len(q)) * motion.dt_s * every, q, 0.0 * q, 0.0 * q, "both_arms")
    refusal = stack.propose("moveit", trajectory(stack, still))
    assert refusal is not None
    assert refusal.name == "too_sharp"
    assert "velocities do not belong to its positions" in refusal.detail
    assert stack.propose("moveit", trajectory(stack, motion, 2)) is None


@pytest.mark.parametrize(
    ("reading", "lie"),
    [
        ("q", lambda q: q[:13]),
        ("v", lambda v: v[:7]),
        ("q", lambda _: "x"),
        ("time", lambda _: None),
    ],
    ids=["13 positions", "7 velocities", "a text", "no time"],
)
def test_a_malformed_reading_is_named_and_stops_the_arms(
    plant: FailingPlant,
    reading: str,
    lie: Callable[[Array], object],
) -> None:
    """Before, `step` raised ValueError or TypeError in each tick, and no torque was commanded."""
    stack = stack_on(plant, supervisor=Supervisor(dt_s=plant.dt))
    hand_over(stack, "moveit")
    assert stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.4, 0.8))) is None
    for _ in range(400):
        stack.step()
    plant.lies[reading] = lie
    before = len(plant.torques)
    names = list[str]()
    for _ in range(600):
        try:
            stack.step()
        except ReflexError as error:
            names.append(error.reflex.label)
    plant.lies.clear()
    assert len(names) == 1
    assert len(plant.torques) == before + 600
    assert np.isfinite(plant.torques[-600:]).all()
    assert np.abs(plant.v).max() < 0.05


def test_a_stack_that_is_reset_bears_the_arms_before_its_first_step(world: World) -> None:
    """Before, `recover()` began at no torque, and the hands fell by 3.3 mm."""
    stack = stack_on(world, supervisor=Supervisor(dt_s=world.dt))
    world.reset()
    stack.reset()
    stack.recover()
    began = [T[2, 3] for T in KINEMATICS.tcp_poses(world.q)]
    lowest = np.full(2, np.inf)
    for _ in range(300):
        stack.step()
        lowest = np.minimum(lowest, [T[2, 3] for T in KINEMATICS.tcp_poses(world.q)])
    np.testing.assert_allclose(lowest, began, atol=2e-4)
