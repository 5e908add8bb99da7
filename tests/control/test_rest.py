"""A callback in a stop, hands that open, a halt of two arms, an object unseen."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.config.scene import SceneConfig
from minidual.control.commands import JointCommand, ObjectCommand
from minidual.control.reflexes import ReflexError
from minidual.control.supervisor import Supervisor
from minidual.plant.world import World
from minidual.robot.pair import Array
from minidual.skills.object_path import ObjectPath, Waypoint
from tests.support.carried_rod import Carried
from tests.support.panda import HOME
from tests.support.stacks import CLOSED, OPEN, Arms, hand_over, run, supervised


def test_the_first_torque_of_a_stop_does_not_wait_for_the_callback(scene: SceneConfig) -> None:
    """Before, the callback ran first: a dump on a slow disk left the motors without a stop for as long."""
    plant = Arms(scene)
    sent = []
    seen = []
    stack = supervised(plant)
    stack.supervisor = Supervisor(dt_s=plant.dt, on_reflex=lambda reflex: seen.append(len(sent)))
    hand_over(stack, "moveit")
    command = plant.command
    plant.command = lambda tau, fingers: sent.append(tau) or command(tau, fingers)  # type: ignore[method-assign]
    run(stack, 5)
    stack.supervisor.estop()
    with pytest.raises(ReflexError) as caught:
        stack.step()
    assert seen == [6]
    np.testing.assert_array_equal(sent[-1], caught.value.tau)


@pytest.mark.parametrize("after_ms", [20, 200])
def test_an_emergency_stop_stops_opening_fingers(world: World, after_ms: int) -> None:
    """Before, they opened to the end; after `recover()`, what was commanded goes on."""
    stack = supervised(world)
    hand_over(stack, "teleop")
    sequence = 0
    for opening, ticks in ((CLOSED, 900), (OPEN, after_ms)):
        q = world.q
        for _ in range(ticks):
            sequence += 1
            if stack.tick_next:
                stack.propose("teleop", JointCommand(q, opening, world.time, sequence))
            stack.step()
    began_m = world.fingers.copy()
    assert began_m.max() < 0.02
    stack.supervisor.estop()
    assert run(stack, 1500) == ["emergency_stop"]
    assert np.abs(world.fingers - began_m).max() < 0.003
    stack.recover()
    run(stack, 1500)
    assert world.fingers.min() > 0.039


@pytest.mark.parametrize("gripper", [OPEN, CLOSED], ids=["open", "closed"])
def test_a_halt_brakes_each_arm_in_its_own_time_unless_both_hands_are_closed(
    scene: SceneConfig,
    gripper: Array,
) -> None:
    """Before, it carried the slower arm up to 0.16 rad past a goal that it had almost reached."""
    plant = Arms(scene)
    stack = supervised(plant)
    hand_over(stack, "teleop")
    target = HOME.copy()
    sequence = 0
    for _ in range(400):
        if stack.tick_next:
            target[[0, 7]] += 0.03, 0.008
            sequence += 1
            assert (
                stack.propose("teleop", JointCommand(target, gripper, plant.time, sequence)) is None
            )
        assert run(stack, 1) == []
    fast, slow = np.abs(plant.v)[[0, 7]].tolist()
    assert fast > 1.2
    assert 0.3 < slow < 0.5
    began = plant.q
    stack.halt("teleop")
    assert run(stack, 2000) == []
    way = np.abs(plant.q - began)[[0, 7]]
    assert np.abs(plant.v).max() < 0.01
    if gripper is CLOSED:  # they may hold one object: one profile, ways as the speeds
        assert way[0] / way[1] == pytest.approx(fast / slow, rel=0.15)
        assert way[1] > 0.04
    else:
        assert way[1] < 0.03


@pytest.mark.parametrize(
    ("what", "spoilt"),
    [
        ("the object's pose is", {"off_m": (0.0, np.nan, 0.0)}),
        ("the object's twist is", {"twist_off": (0.0, 0.0, np.nan, 0.0, 0.0, 0.0)}),
        ("the object's internal force is", {"felt": np.nan}),
    ],
)
def test_an_object_that_is_not_measured_is_named_in_the_same_tick(
    world: World,
    what: str,
    spoilt: dict[str, object],
) -> None:
    """Before, it was `not_finite`, "torque of left_panda_joint1"."""
    carried = Carried(world)
    if "felt" in spoilt:
        read = carried.sensor.read
        carried.sensor.read = lambda: (read()[0], np.nan)  # type: ignore[method-assign]
    else:
        carried.sensor.__dict__.update(spoilt)
    with pytest.raises(ReflexError) as caught:
        carried.stack.step()
    assert caught.value.reflex.label == "controller_failed"
    assert what in caught.value.message
    assert "what measures it" in str(caught.value.__cause__)
    carried.run(1500)
    assert carried.height_m > 0.14


def test_an_object_path_that_opens_the_hands_is_refused(world: World) -> None:
    """Before, it was followed, and the rod fell, until `joint_contact`."""
    carried = Carried(world)
    T = world.object_pose()
    stack = carried.stack
    start = Waypoint(tuple(T[:3, 3].tolist()), float(np.arctan2(T[1, 0], T[0, 0])), 0.0)
    path = ObjectPath(start, [Waypoint(start.xyz_m, start.yaw_rad, 1.0)])
    command = ObjectCommand(
        path,
        lambda t: 40.0,
        np.array([0.0, 1.0]),
        world.time,
        carried.sequence + 1,
    )
    assert stack.propose("moveit", command) is None
    carried.run(1500)
    assert carried.names == []
    assert [(r.name, r.detail) for r in stack.refusals][-1] == (
        "gripper_out_of_range",
        "gripper [0. 1.] would open the hands that hold the object",
    )
    assert carried.height_m > 0.14


@pytest.mark.parametrize("began", range(0, 20, 4))
def test_a_loop_that_stalled_is_told_from_a_silent_arbiter(scene: SceneConfig, began: int) -> None:
    """Before, it was "no command", and nothing at all where an arbiter's tick was due at its end."""
    plant = Arms(scene)
    stack = supervised(plant)
    hand_over(stack, "moveit")
    assert run(stack, 100 + began) == []
    for _ in range(70):
        plant.step()  # the motors keep their torque
    assert run(stack, 100) == [], "0.07 s are no reflex"
    for _ in range(150):
        plant.step()
    with pytest.raises(
        ReflexError,
        match=r"stale_command at .*: no control step \(0.15 s, bound 0.1 s\)",
    ):
        stack.step()
    assert run(stack, 500) == []
    assert np.abs(plant.v).max() < 0.01
