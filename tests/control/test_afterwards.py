"""Samples that are wrong by little, and what must not undo a stop, with the numbers before."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from minidual.config.control import ArbiterConfig, SupervisorConfig
from minidual.config.scene import SceneConfig
from minidual.control.commands import ArbiterState, JointCommand
from minidual.control.controller_manager import ControllerSwitchError
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.errors import UsageError
from minidual.plant.world import World
from minidual.robot.pair import Array
from minidual.skills.pipeline.drive import Drive
from minidual.skills.states import still
from tests.control.test_gaps import Gap
from tests.control.test_gaps import Slow as At50Hz
from tests.control.test_glitch import off_by
from tests.control.test_late import Slow as At100Hz
from tests.support.carried_rod import Carried
from tests.support.panda import HOME
from tests.support.stacks import (
    OPEN,
    Arms,
    hand_over,
    move,
    run,
    stack_on,
    supervised,
    trajectory,
    under_way,
)

STRIDE = HOME + np.eye(14)[0] * 0.9 + np.eye(14)[7] * 0.9


def in_a_second(plant: Arms, stack: ControlStack) -> float:
    """Return the largest speed in a second of sound packets."""
    fastest = 0.0
    for _ in range(round(1.0 / plant.dt)):
        run(stack, 1)
        fastest = max(fastest, float(np.abs(plant.__dict__["v"]).max()))
    return fastest


def after_one_lie(plant: Arms, stack: ControlStack, **lies: Any) -> tuple[float, Array]:
    """Return the largest speed in a second after one packet of lies, and where the arms were."""
    was = plant.__dict__["q"].copy()
    plant.lies.update(lies)
    assert run(stack, 1) == ["measurement.implausible"]
    plant.lies.clear()
    return in_a_second(plant, stack), was


@pytest.mark.parametrize("dv", [0.5, 1.0, 2.0, 2.4])
@pytest.mark.parametrize("dq", [0.05, 1.0])
def test_a_velocity_that_is_wrong_by_little_with_its_position_moves_no_resting_arm(
    scene: SceneConfig,
    dq: float,
    dv: float,
) -> None:
    """Before, the stop drove the joint by up to 0.37 rad at 1.6 rad/s: from 2.5 rad/s on it was not believed."""
    plant = Arms(scene)
    stack = supervised(plant)
    assert run(stack, 200) == []
    fastest, was = after_one_lie(plant, stack, q=off_by(1, dq), v=off_by(1, dv))
    assert fastest < 0.02
    assert np.abs(plant.q - was).max() < 0.005


@pytest.mark.parametrize("dv", [5.5, 8.0, 20.0])
def test_a_velocity_that_was_wrong_in_the_last_packet_starts_no_stop_in_motion(
    scene: SceneConfig,
    dv: float,
) -> None:
    """Before, 0.33 rad/s: it is named in the next packet, and the stop began with a part of it."""
    plant = Arms(scene)
    stack = supervised(plant)
    assert run(stack, 200) == []
    plant.lies["v"] = off_by(5, dv)
    names = run(stack, 1)
    plant.lies.clear()
    fastest = 0.0
    for _ in range(1000):
        names += run(stack, 1)
        fastest = max(fastest, float(np.abs(plant.v).max()))
    assert names == ["speed.joint" if dv < 10.0 else "measurement.implausible"]
    assert fastest < 0.03
    assert np.abs(plant.q - HOME).max() < 0.005


@pytest.mark.parametrize(
    ("kind", "dq"),
    [(At100Hz, 0.006), (At100Hz, 0.01), (At100Hz, 0.03), (At50Hz, 0.03), (At50Hz, 0.08)],
)
def test_a_position_that_is_wrong_by_little_moves_no_resting_arm_of_a_slow_plant(
    scene: SceneConfig,
    kind: type[Arms],
    dq: float,
) -> None:
    """Before, its velocity was given up, and the stop began with the slope of the jump: 1.6 to 2.2 rad/s, 0.3 rad."""
    plant = kind(scene)
    stack = supervised(plant)
    assert run(stack, 30) == []
    fastest, was = after_one_lie(plant, stack, q=off_by(1, dq))
    assert fastest < 0.02
    assert np.abs(plant.q - was).max() < 0.005


def test_a_velocity_that_is_wrong_alone_is_the_one_given_up(scene: SceneConfig) -> None:
    """The negative control: the position is sound."""
    plant = At100Hz(scene)
    stack = supervised(plant)
    assert run(stack, 30) == []
    fastest, was = after_one_lie(plant, stack, v=off_by(1, 1.1))
    assert stack.supervisor is not None
    assert stack.supervisor._sense.lost[:, 1].tolist() == [False, True]
    assert fastest < 0.1
    assert np.abs(plant.q - was).max() < 0.005


def test_what_fails_before_a_recovery_stops_the_arms_after_it(scene: SceneConfig) -> None:
    """Before, it was forgotten."""
    stack = supervised(Arms(scene))
    run(stack, 50)
    stack.supervisor.estop()
    assert run(stack, 300) == ["emergency_stop"]
    stack.fail(RuntimeError("the camera is gone"))
    stack.recover()
    assert run(stack, 5) == ["controller_failed"]
    assert "the camera is gone" in str(stack.reflex)


def test_controllers_do_not_change_while_a_halt_brakes(scene: SceneConfig) -> None:
    """Before, the arms came back by 0.144 rad."""
    plant = Arms(scene)
    stack = under_way(plant)
    stack.halt("teleop")
    assert run(stack, 20) == []
    with pytest.raises(ControllerSwitchError, match="are being stopped"):
        stack.switch_controllers(("both_arms",))
    run(stack, 1000)
    rest = plant.q.copy()
    stack.switch_controllers(("both_arms",))
    run(stack, 500)
    assert np.abs(plant.q - rest).max() < 1e-3


def test_a_source_that_does_not_drive_holds_nobody_up(scene: SceneConfig) -> None:
    """Before, a task of 0.4 s was stopped after 1 s, as silent."""
    plant = Arms(scene)
    stack = supervised(plant)
    drive = Drive(stack, [still(name, HOME, 0.2, (1.0, 1.0)) for name in ("a", "b")])
    sequence = 0
    while not drive.done and plant.time < 2.0:
        sequence += 1
        command = trajectory(stack, move(HOME, HOME + 0.1, 1.0))
        assert stack.propose("policy", dataclasses.replace(command, sequence=sequence)) is None
        drive.step()
    assert drive.aborted is None
    assert plant.time < 0.5


def test_an_error_between_two_segments_is_a_reflex_in_the_same_tick(
    scene: SceneConfig,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Before, `step` raised, and the tick had no torque."""
    plant = Arms(scene)
    stack = supervised(plant)
    drive = Drive(stack, [still(name, HOME, 0.2, (1.0, 1.0)) for name in ("a", "b")])

    def refuse(names: tuple[str, ...]) -> None:
        raise ControllerSwitchError("not_ready", f"the arms are not measured: {names}")

    def take(segment: Any) -> None:
        if segment.phase == "b":
            refuse(())

    monkeypatch.setattr(drive, "_take_control", take)
    sent = 0
    while not drive.done:
        drive.step()
        sent += 1
    assert len(plant.torques) == sent
    assert drive.aborted is not None
    assert drive.aborted.startswith("phase 'b': ")
    assert "the arms are not measured" in drive.aborted


def test_what_was_refused_before_does_not_end_the_next_drive(scene: SceneConfig) -> None:
    """Before, it ended at once, by the reason of long ago."""
    stack = supervised(Arms(scene))
    hand_over(stack, "moveit")
    late = dataclasses.replace(trajectory(stack, move(HOME, HOME, 0.2)), stamp_s=-1.0)
    stack.propose("moveit", late)
    run(stack, 40)
    assert [r.source for r in stack.refusals] == ["moveit"]
    stack.request("hold")
    run(stack, 200)
    drive = Drive(stack, [still("a", HOME, 0.2, (1.0, 1.0))])
    while not drive.done:
        drive.step()
    assert drive.aborted is None


def test_hands_whose_grip_is_not_measured_begin_nothing(world: World) -> None:
    """Before, the hand opened fully, and no reflex said so."""
    carried = Carried(world)
    gap = Gap(world)
    carried.stack.plant = carried.stack.grippers._plant = gap  # type: ignore[assignment]
    gap.instead["grip"] = lambda x: x * [np.nan, 1.0]
    with pytest.raises(UsageError, match="the grip is not measured"):
        carried.stack.reset()
    gap.instead.clear()
    carried.stack.reset()
    assert carried.stack.grippers.closed.all()


@pytest.mark.parametrize(
    ("config", "values"),
    [
        (SupervisorConfig, {"stop_deceleration_scale": 0.1}),
        (ArbiterConfig, {"switch_step_max_rad": 0.5}),
    ],
)
def test_a_configuration_that_defeats_a_stop_is_refused(
    config: Any,
    values: dict[str, float],
) -> None:
    """Before: an emergency stop went on by 1.03 rad; a start faded with 1.9 times the acceleration limit."""
    with pytest.raises(ValidationError, match=next(iter(values))):
        config(**values)


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_a_start_beside_the_reference_fades_no_faster_than_the_override(
    scene: SceneConfig,
    share: float,
) -> None:
    """Before, 0.099 rad at a tenth of full speed moved joints at 0.37 rad/s."""
    plant = Arms(scene)
    stack = stack_on(plant, config=ArbiterConfig(speed_override=share))
    hand_over(stack, "moveit")
    start = HOME + 0.099
    references = [HOME.copy()]
    assert stack.propose("moveit", trajectory(stack, move(start, start, 1.0))) is None
    while stack.executing:
        run(stack, 1)
        references.append(stack.manager.reference.copy())
    fastest = np.abs(np.diff(references, axis=0)).max() / plant.dt
    assert fastest == pytest.approx(share * 0.099 * 1.875 / 0.5, rel=0.02)
    np.testing.assert_allclose(references[-1], start, atol=1e-6)


def test_an_arm_that_nobody_drives_does_not_sink_where_the_others_source_falls_silent(
    scene: SceneConfig,
) -> None:
    """Before, by the sag of its load at each silence."""
    plant = Arms(scene)
    stack = supervised(plant)
    hand_over(stack, "teleop")
    plant.pushed[8] = 1.0
    run(stack, 300)
    target = HOME[:7].copy()
    sequence = 0
    for k in range(600):
        if stack.tick_next and k < 400:
            target[0] += 0.08
            sequence += 1
            assert (
                stack.propose(
                    "teleop",
                    JointCommand(target, OPEN, plant.time, sequence, "left_arm"),
                )
                is None
            )
        run(stack, 1)
    assert stack.state is not ArbiterState.ACTIVE
    np.testing.assert_allclose(stack.output.q_target[7:], HOME[7:], atol=1e-12)
    assert abs(stack.output.q_target[0] - target[0]) > 0.01, "the silent arm stops where it can"


@pytest.mark.parametrize("dv", [6.0, 8.0, 9.5])
def test_a_joint_that_comes_back_starts_no_stop_of_the_others_anew(
    scene: SceneConfig,
    dv: float,
) -> None:
    """Before, 1.6 rad/s and 0.36 rad: one packet lied of a joint's both values, and of another one's velocity."""
    plant = Arms(scene)
    stack = supervised(plant)
    assert run(stack, 200) == []
    lie = np.eye(14)[8]
    plant.lies.update(q=lambda q: q + 0.5 * lie, v=lambda v: v + 1000.0 * lie + dv * np.eye(14)[1])
    assert len(run(stack, 1)) == 1
    plant.lies.clear()
    fastest = in_a_second(plant, stack)
    assert fastest < 0.12
    assert np.abs(plant.q - HOME).max() < 0.01


@pytest.mark.parametrize("dq", [0.0, 0.3])
@pytest.mark.parametrize("dv", [0.5, 1.0, 2.0])
def test_the_first_packet_after_an_outage_is_not_believed_alone(
    scene: SceneConfig,
    dq: float,
    dv: float,
) -> None:
    """Before, it began the stop anew: 1.5 rad/s and 0.33 rad at rest."""
    plant = Arms(scene)
    stack = supervised(plant)
    run(stack, 50)
    stack.supervisor.estop()
    run(stack, 400)
    plant.lies.update(q=lambda q: q * np.nan, v=lambda v: v * np.nan)
    run(stack, 30)
    plant.lies.update(q=off_by(1, dq), v=off_by(1, dv))
    run(stack, 1)
    plant.lies.clear()
    fastest = in_a_second(plant, stack)
    assert fastest < 0.1
    assert np.abs(plant.q - HOME).max() < 0.01


@pytest.mark.parametrize(
    ("share", "then", "after"),
    [(0.1, "silence", 120), (0.1, "hold", 500), (1.0, "hold", 200)],
)
def test_what_brakes_beside_its_path_stays_there(
    scene: SceneConfig,
    share: float,
    then: str,
    after: int,
) -> None:
    """Before, the arms came to rest and then travelled the rest of the offset, up to 0.099 rad, with nobody driving."""
    plant = Arms(scene)
    stack = stack_on(
        plant,
        config=ArbiterConfig(speed_override=share),
        supervisor=Supervisor(dt_s=plant.dt),
    )
    hand_over(stack, "moveit")
    start = HOME + 0.099
    assert stack.propose("moveit", trajectory(stack, move(start, start, 1.0))) is None
    assert run(stack, after) == []
    if then == "hold":
        stack.request("hold")
    stack.dead = True
    run(stack, 300)
    rest = plant.q.copy()
    run(stack, 3000)
    assert stack.output.active_source is None
    assert np.abs(plant.q - rest).max() < 0.015
    assert np.abs(plant.q - start).max() > 0.015


def test_a_reset_that_is_refused_forgets_no_failure(scene: SceneConfig) -> None:
    """Before, it did: no reflex."""
    plant = Arms(scene)
    stack = under_way(plant)
    stack.fail(RuntimeError("the camera is gone"))
    with pytest.raises(UsageError, match="the arms move"):
        stack.reset()
    assert run(stack, 5) == ["controller_failed"]


def test_a_drive_that_is_never_handed_the_arms_ends(scene: SceneConfig) -> None:
    """Before, it waited for ever."""
    stack = supervised(Arms(scene))
    drive = Drive(stack, [still("a", HOME, 0.2, (1.0, 1.0))])
    stack.request("hold")
    for _ in range(300):
        drive.step()
    assert drive.done
    assert drive.aborted is not None
    assert "not handed over" in drive.aborted


def test_who_drives_after_a_halt_may_change_the_controllers(scene: SceneConfig) -> None:
    """A halt is over once a source has the arms."""
    plant = Arms(scene)
    stack = under_way(plant)
    stack.halt("teleop")
    run(stack, 400)
    hand_over(stack, "teleop")
    assert stack.propose("teleop", JointCommand(plant.q + 0.09, OPEN, plant.time, 1)) is None
    run(stack, 60)
    assert np.abs(plant.v).max() > 0.05
    stack.switch_controllers(("left_arm", "right_arm"))
