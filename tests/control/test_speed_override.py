"""The speed override scales all motion: the same path, slower, changeable in motion, without a reflex or a jump."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.config.control import ArbiterConfig
from minidual.config.scene import SceneConfig
from minidual.control.commands import JointCommand, ObjectCommand
from minidual.control.execution import ObjectExecution, TrajectoryExecution
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.errors import UsageError
from minidual.robot.pair import DUAL_PANDA
from minidual.skills.object_path import ObjectPath, Waypoint
from tests.support.control_plant import ArmsPlant
from tests.support.panda import A_MAX, HOME, V_MAX
from tests.support.stacks import (
    OPEN,
    Arms,
    hand_over,
    move,
    stack_on,
    supervised,
    trajectory,
)

SLOW = ArbiterConfig(speed_override=0.1)
STEP = np.where(np.arange(14) % 7 == 0, 0.1, 0.025)


@pytest.fixture
def plant(scene: SceneConfig) -> ArmsPlant:
    return ArmsPlant(scene)


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_a_trajectory_keeps_its_path_and_takes_longer(plant: ArmsPlant, share: float) -> None:
    stack = stack_on(plant, config=ArbiterConfig(speed_override=share))
    hand_over(stack, "moveit")
    motion = move(plant.q, plant.q + STEP, 0.2)
    stack.propose("moveit", trajectory(stack, motion))
    began = plant.time
    references = []
    while stack.executing:
        stack.step()
        references.append(stack.manager.reference)
    assert plant.time - began == pytest.approx(0.2 / share, abs=0.005)
    gone = (np.array(references) - motion.q[0]) / STEP
    np.testing.assert_allclose(
        gone,
        np.tile(gone[:, :1], 14),
        atol=1e-9,
    )  # all joints at one place of the path
    assert references[-1] == pytest.approx(motion.q[-1], abs=1e-9)
    fastest = np.abs(np.diff(references, axis=0)).max(axis=0) / plant.dt
    np.testing.assert_allclose(fastest, share * np.abs(motion.v).max(axis=0), rtol=0.01)


@pytest.mark.parametrize("supervised", [True, False])
def test_controllers_that_last_drove_slowly_take_over_at_full_speed(
    plant: ArmsPlant,
    supervised: bool,
) -> None:
    """Their reference loses no speed in one tick."""
    stack = stack_on(
        plant,
        config=SLOW,
        supervisor=Supervisor(dt_s=plant.dt) if supervised else None,
    )
    pair = ("left_arm", "right_arm")
    hand_over(stack, "teleop", pair)
    for _ in range(600):
        stack.step()
    stack.switch_controllers(("both_arms",))
    stack.speed_override = 1.0
    for _ in range(200):
        stack.step()
    target = HOME.copy()
    told = []
    for k in range(600):
        if stack.tick_next:
            target[0] += 0.03
            assert stack.propose("teleop", JointCommand(target, OPEN, plant.time, k + 1)) is None
        if k == 500:
            assert plant.v[0] > 1.3
            stack.switch_controllers(pair)
        stack.step()
        told.append(plant.torques[-1])
    assert stack.reflex is None
    assert np.abs(np.diff(told, axis=0)).max() < 3.0


@pytest.mark.parametrize("share", [0.1, 0.3, 1.0])
def test_arms_whose_leader_falls_silent_stop_where_they_are(plant: ArmsPlant, share: float) -> None:
    """They do not go on to its last target."""
    stack = stack_on(
        plant,
        config=ArbiterConfig(speed_override=share),
        supervisor=Supervisor(dt_s=plant.dt),
    )
    hand_over(stack, "teleop")
    target = HOME.copy()
    for k in range(1500):
        if stack.tick_next:
            target[0] += 0.02
            assert stack.propose("teleop", JointCommand(target, OPEN, plant.time, k + 1)) is None
        stack.step()
    silent_at = plant.q[0]
    for _ in range(3000):
        ControlStack.step(stack)  # nobody affirms the source
    assert stack.source is None
    assert 0.0 < plant.q[0] - silent_at < 0.12
    assert np.abs(plant.v).max() < 1e-3


def test_it_changes_in_motion_and_the_reference_stays_smooth(plant: ArmsPlant) -> None:
    """At nearly all the speed and acceleration that plans may use."""
    stack = stack_on(plant, supervisor=Supervisor(dt_s=plant.dt))
    hand_over(stack, "moveit")
    far = np.where(np.arange(14) % 7 == 0, 2.0, 0.0)
    stack.propose("moveit", trajectory(stack, move(plant.q, plant.q + far, 1.9)))
    q = [plant.q]
    k = 0
    while stack.executing:
        if k in (300, 1500):
            stack.speed_override = 0.1 if k == 300 else 1.0
        stack.step()
        q.append(stack.manager.reference)
        k += 1
    assert stack.reflex is None
    assert 2150 < k < 2300
    assert plant.q == pytest.approx(HOME + far, abs=0.01)
    acceleration = np.abs(np.diff(q, n=2, axis=0)).max(axis=0) / plant.dt**2
    assert np.max(acceleration / A_MAX) < 1.0


def test_streamed_targets_are_followed_no_faster(plant: ArmsPlant) -> None:
    stack = stack_on(plant, supervisor=Supervisor(dt_s=plant.dt))
    hand_over(stack, "teleop")
    target = plant.q
    speeds = []
    for k in range(2000):
        if k == 500:
            stack.speed_override = 0.2
        if stack.tick_next:
            target = target + 0.02 * (np.arange(14) % 7 < 3)  # 1 rad/s
            stack.propose("teleop", JointCommand(target, OPEN, plant.time, k))
        stack.step()
        speeds.append(np.abs(plant.v))
    assert stack.reflex is None, "a lower speed trips nothing"
    assert np.max(speeds[:500]) == pytest.approx(1.0, abs=0.1)
    assert (np.max(speeds[1200:], axis=0) < 0.2 * V_MAX).all(), "of each joint, its own limit"
    assert np.diff(np.max(speeds, axis=1)).min() > -0.05


def test_a_far_target_is_approached_no_faster(plant: ArmsPlant) -> None:
    stack = stack_on(plant, config=SLOW)
    hand_over(stack, "teleop")
    began = plant.q
    for k in range(500):
        if stack.tick_next:
            stack.propose("teleop", JointCommand(began + 0.5 * np.eye(14)[0], OPEN, plant.time, k))
        stack.step()
    assert 0.03 < plant.q[0] - began[0] <= 0.05


def test_an_object_path_is_scaled_with_its_twist_and_squeeze() -> None:
    path = ObjectPath(Waypoint((0.0, 0.0, 0.1), 0.0, 0.0), [Waypoint((0.3, 0.0, 0.1), 0.0, 1.0)])
    command = ObjectCommand(path, lambda t: 40.0 * min(t, 1.0), OPEN, 0.0, 1)
    execution = ObjectExecution(command, 1e-3)
    execution.limit_speed(0.25)
    places = []
    squeezes = []
    while not execution.finished:
        execution.step()
        places.append(execution.desired.T_world_object[0, 3])
        squeezes.append(execution.squeeze_n)
        if len(places) == 2001:
            assert execution.desired.twist[0] == pytest.approx(
                0.25 * path.at(0.5).twist[0],
                rel=1e-3,
            )
    assert len(places) == pytest.approx(4000, abs=2)
    assert places[-1] == pytest.approx(0.3)
    assert squeezes[2000] == pytest.approx(20.0, rel=1e-3)


def test_a_slowed_trajectory_brakes_on_its_path(plant: ArmsPlant) -> None:
    execution = TrajectoryExecution(
        trajectory(stack_on(plant), move(HOME, HOME + STEP, 0.2)),
        1e-3,
        DUAL_PANDA,
    )
    execution.limit_speed(0.5)
    for _ in range(150):
        execution.step()
    execution.brake()
    before = execution.v
    while not execution.finished:
        execution.step()
        assert np.abs(execution.v - before).max() < 0.02
        before = execution.v
    gone = (execution.q - HOME) / STEP
    np.testing.assert_allclose(gone, gone[0])
    assert 0.3 < gone[0] < 0.9


@pytest.mark.parametrize("share", [0.0, 0.05, 1.01, float("nan")])
def test_a_share_out_of_range_is_refused_by_value(plant: ArmsPlant, share: float) -> None:
    stack = stack_on(plant)
    with pytest.raises(UsageError, match=r"speed override of .* refused; it may be 0.1 to 1.0"):
        stack.speed_override = share
    assert stack.speed_override == 1.0


def test_it_outlasts_a_recovery(plant: ArmsPlant) -> None:
    stack = stack_on(plant, supervisor=Supervisor(dt_s=plant.dt))
    stack.speed_override = 0.3
    stack.reset()
    assert stack.arbiter.speed == stack.speed_override == 0.3


@pytest.mark.parametrize("controllers", [("both_arms",), ("left_arm", "right_arm")])
def test_it_holds_from_the_first_target_on(
    scene: SceneConfig,
    controllers: tuple[str, ...],
) -> None:
    plant = Arms(scene)
    stack = supervised(plant, config=ArbiterConfig(speed_override=0.1))
    hand_over(stack, "teleop", controllers)
    fastest = 0.0
    for tick in range(600):
        if stack.tick_next:
            stack.propose("teleop", JointCommand(HOME + 0.099, OPEN, plant.time, tick + 1))
        stack.step()
        fastest = max(fastest, float(np.max(np.abs(plant.v) / V_MAX)))
    assert 0.05 < fastest < 0.13


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_a_start_beside_the_reference_fades_no_faster(scene: SceneConfig, share: float) -> None:
    plant = Arms(scene)
    stack = stack_on(plant, config=ArbiterConfig(speed_override=share))
    hand_over(stack, "moveit")
    start = HOME + 0.099
    references = [HOME.copy()]
    assert stack.propose("moveit", trajectory(stack, move(start, start, 1.0))) is None
    while stack.executing:
        stack.step()
        references.append(stack.manager.reference.copy())
    fastest = np.abs(np.diff(references, axis=0)).max() / plant.dt
    assert fastest == pytest.approx(share * 0.099 * 1.875 / 0.5, rel=0.02)
    np.testing.assert_allclose(references[-1], start, atol=1e-6)
