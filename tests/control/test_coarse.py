"""Readings as real sensors give them: coarse, wrong once, from a clock that began anew; and what no plant should be told."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from minidual import emergency
from minidual.config.control import CarryConfig, SupervisorConfig
from minidual.config.scene import SceneConfig
from minidual.control.commands import JointCommand
from minidual.control.gripper import Grippers
from minidual.control.impedance import HeldObject
from minidual.errors import UsageError
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA
from minidual.robot.trajectory import Trajectory
from minidual.skills.impedance_carry import ImpedanceCarry
from minidual.skills.supervised import trial_supervisor
from minidual.skills.things import thing_of
from tests.control.test_again import APART
from tests.control.test_late import Slow
from tests.support.carry_trials import sample_trial
from tests.support.panda import HOME, Q_UPPER
from tests.support.stacks import (
    CLOSED,
    OPEN,
    Arms,
    hand_over,
    move,
    run,
    stack_on,
    supervised,
    trajectory,
)

COARSE = [(20, 1e-3), (16, 2e-3)]


class CoarseWorld(World):
    """Its encoders have this many bits a turn, and this step of velocity."""

    bits = 20
    step_rad_s = 1e-3

    @property
    def q(self) -> np.ndarray:
        quantum = 2.0 * np.pi / 2**self.bits
        return np.round(super().q / quantum) * quantum

    @property
    def v(self) -> np.ndarray:
        return np.round(super().v / self.step_rad_s) * self.step_rad_s


def coarse(scene: SceneConfig, bits: int, step_rad_s: float) -> CoarseWorld:
    world = CoarseWorld(scene)
    world.bits = bits
    world.step_rad_s = step_rad_s
    return world


@pytest.mark.parametrize(("bits", "step_rad_s"), COARSE)
def test_coarse_encoders_carry(
    scene: SceneConfig,
    kinematics: Kinematics,
    bits: int,
    step_rad_s: float,
) -> None:
    """Before, each of 10 such carries ended in `implausible_measurement`: a joint that stands looked frozen."""
    world = coarse(scene, bits, step_rad_s)
    trial = sample_trial(scene, 0, "driver", 0)
    world.reset(poses=trial.start)
    shapes = (thing_of(scene.object).shape,)
    supervisor = trial_supervisor(SupervisorConfig(), world.dt, world.robot, shapes=shapes)
    carry = ImpedanceCarry(world, kinematics, CarryConfig(), trial, supervisor=supervisor)
    while not carry.done and world.time < 15.0:
        carry.step()
    assert carry.aborted is None
    assert carry.done


@pytest.mark.parametrize("joint", [1, 3])
def test_a_leader_that_moves_one_joint_goes_on_with_coarse_encoders(
    scene: SceneConfig,
    joint: int,
) -> None:
    """Before, the joints that stand were taken for frozen in 8 of 8 runs."""
    world = coarse(scene, 17, 1e-3)
    stack = supervised(world)  # type: ignore[arg-type]
    stack.request("teleop")
    q = world.q
    sent = 0
    for _ in range(3000):
        if stack.tick_next and stack.source == "teleop":
            sent += 1
            target = q.copy()
            target[joint] += 0.3 * (1.0 - np.cos(2.0 * np.pi * world.time / 3.0))
            assert stack.propose("teleop", JointCommand(target, OPEN, world.time, sent)) is None
        assert run(stack, 1) == []
    assert sent > 100


@pytest.mark.parametrize("joint", [0, 1, 3, 5])
def test_one_joint_that_freezes_alone_at_rest_is_still_named(
    scene: SceneConfig,
    joint: int,
) -> None:
    """The negative control of the two above."""
    plant = Arms(scene)
    stack = supervised(plant)
    hand_over(stack, "moveit")
    run(stack, 100)
    for name in "qv":
        stuck = float(plant.__dict__[name][joint])
        plant.lies[name] = lambda x, stuck=stuck: np.where(np.arange(14) == joint, stuck, x)
    assert stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.8 * APART, 0.8))) is None
    assert run(stack, 90) == ["measurement.implausible"]
    assert np.abs(plant.__dict__["v"][joint]) < 0.2


class SlowAndStill(Slow):
    """Arms at 100 Hz that carry a load, with readings that are exactly constant at rest."""

    def __init__(self, scene: SceneConfig) -> None:
        super().__init__(scene)
        self.lies |= {"q": lambda q: np.round(q, 3), "v": lambda v: np.round(v, 2)}


@pytest.mark.parametrize("kind", [Arms, SlowAndStill])
def test_arms_that_stand_under_a_load_are_no_frozen_ones(
    scene: SceneConfig,
    kinematics: Kinematics,
    kind: Any,
) -> None:
    """Neither at the start, nor while they are stopped: nothing but the model would hold a joint taken for frozen."""
    plant = kind(scene)
    plant.lies |= {"q": lambda q: np.round(q, 3), "v": lambda v: np.round(v, 2)}
    stack = supervised(plant)
    stack.payload.take_over(10.0)
    plant.pushed = -10.0 * sum(J[2] for J in kinematics.tcp_jacobians(HOME))
    stack.applied = kinematics.gravity(HOME) - plant.pushed
    assert stack.supervisor is not None
    stack.supervisor.reset(stack.applied)
    assert run(stack, 100) == []
    stack.supervisor.estop()
    assert run(stack, 200) == ["emergency_stop"]
    assert not stack.supervisor._sense.lost.any()
    assert np.abs(plant.__dict__["v"]).max() < 0.05


class Holding:
    """Hands that hold something 25 mm wide."""

    robot = DUAL_PANDA
    grip_max_n = 70.0
    dt = 1e-3

    def __init__(self) -> None:
        self.fingers = np.full(2, 0.0125)
        self.grip = np.full(2, 60.0)


@pytest.mark.parametrize("wrong_m", [0.03, 0.04, 1.0, np.inf, np.nan])
def test_one_wrong_reading_of_the_fingers_opens_no_hand(wrong_m: float) -> None:
    """Before, the target jumped by 20 mm, by 1 m, or to infinity: the pinch was gone for 47 to 414 ms."""
    plant: Any = Holding()
    grippers = Grippers(plant)
    for _ in range(50):
        grippers.step(CLOSED)
    before_m = grippers.targets_m.copy()
    plant.fingers = np.array([wrong_m, 0.0125])
    assert np.abs(grippers.step(CLOSED) - before_m).max() < 1e-4
    plant.fingers = np.full(2, 0.0125)
    for _ in range(20):
        after_m = grippers.step(CLOSED)
    assert np.abs(after_m - before_m).max() < 1e-4


def test_a_pinch_at_50_hz_settles_although_the_grip_is_a_period_old() -> None:
    """Before, it swung between 52 and 68 N for ever."""
    plant: Any = Holding()
    plant.dt = 0.02
    plant.grip = np.full(2, 40.0)
    grippers = Grippers(plant)
    felt = [plant.grip] * 2
    for _ in range(200):
        felt.append(5000.0 * (0.0125 - grippers.step(CLOSED)))
        plant.grip = felt[-2]
    assert np.abs(np.array(felt[-50:]) - 60.0).max() < 0.1


@pytest.mark.parametrize("wrong_m", [0.0, 0.04])
def test_a_stop_believes_no_reading_far_from_what_the_fingers_were_told(
    scene: SceneConfig,
    wrong_m: float,
) -> None:
    """Before, the packet that tripped sent closing fingers to where it said, without a speed limit."""
    plant = Arms(scene)
    stack = supervised(plant)
    stack.request("teleop")
    for k in range(260):
        if stack.source == "teleop" and stack.tick_next:
            stack.propose("teleop", JointCommand(HOME, CLOSED, plant.time, k))
        run(stack, 1)
    told_m = stack.grippers.targets_m.copy()
    assert 0.01 < told_m[0] < 0.03
    plant.lies |= {"q": lambda q: 0.0 * q, "v": lambda v: 0.0 * v}
    plant.fingers = np.full(2, wrong_m)
    assert run(stack, 1) == ["measurement.implausible"]
    assert np.abs(stack.grippers.targets_m - told_m).max() < 0.0051


def test_a_reset_that_an_emergency_stop_refuses_leaves_the_hands(scene: SceneConfig) -> None:
    """Before, closing hands were told to open in the next tick."""
    plant = Arms(scene)
    plant.grip = np.full(2, 4.0)
    plant.fingers = np.full(2, 0.0144)
    plant.limp = True
    stack = supervised(plant)
    run(stack, 10)
    stack.grippers.close(np.full(2, 0.0144))
    emergency.press("a test")
    run(stack, 2)
    with pytest.raises(emergency.EmergencyStop):
        stack.reset()
    emergency.release()
    assert (stack.grippers.openings == 0.0).all()
    assert np.abs(stack.grippers.targets_m - 0.0144).max() < 1e-9


def test_a_torque_that_is_not_measured_at_reset_reaches_no_motor(scene: SceneConfig) -> None:
    """Before, each torque of that joint was NaN from then on."""
    plant = Arms(scene)
    plant.grip = np.full(2, 20.0)
    plant.fingers = np.full(2, 0.012)
    plant.limp = True
    stack = supervised(plant)
    run(stack, 5)
    plant.tau = np.where(np.arange(14) == 3, np.nan, plant.tau)
    stack.reset()
    assert stack.supervisor is not None
    stack.supervisor.estop()
    plant.torques.clear()
    assert run(stack, 20) == ["emergency_stop"]
    assert np.isfinite(plant.torques).all()


def test_fingers_that_are_not_measured_refuse_a_reset() -> None:
    plant: Any = Holding()
    grippers = Grippers(plant)
    plant.fingers = np.array([np.nan, 0.0125])
    with pytest.raises(UsageError, match="not measured"):
        grippers.reset()


def test_arms_that_move_may_not_recover_after_their_clock_began_anew(scene: SceneConfig) -> None:
    """Before, accepted at 1.5 rad/s while velocities read zero."""
    plant = Arms(scene)
    plant.steps = 3_600_000
    stack = supervised(plant)
    run(stack, 100)
    plant.steps = 0
    assert run(stack, 600)[:1] == ["clock"]
    stack.recover()
    hand_over(stack, "moveit")
    assert stack.propose("moveit", trajectory(stack, move(HOME, HOME + APART, 1.0))) is None
    run(stack, 450)
    plant.lies["v"] = lambda v: 0.0 * v
    run(stack, 10)
    assert stack.reflex is not None
    assert np.abs(plant.__dict__["v"]).max() > 0.5
    with pytest.raises(UsageError, match="while they move"):
        stack.recover()


def course(times: list[float], q: list[float], v: list[float], joint: int) -> Trajectory:
    """A coarse trajectory of one joint."""
    row = np.eye(14)[joint]
    rows, speeds = (np.array(x)[:, None] * row for x in (q, v))
    a = np.zeros_like(speeds)
    return Trajectory(np.array(times), HOME + rows, speeds, a, "both_arms")


@pytest.mark.parametrize(
    ("name", "q", "v", "joint"),
    [
        ("too_fast", [0.0, 2.1], [0.0, 0.0], 0),
        ("out_of_limits", [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], 6),
    ],
)
def test_what_lies_between_coarse_samples_is_bounded_too(
    scene: SceneConfig,
    name: str,
    q: list[float],
    v: list[float],
    joint: int,
) -> None:
    """Before, such rows passed: 1.4 times the speed limit, and 45 mrad beyond a position limit."""
    plant = Arms(scene)
    stack = stack_on(plant)
    hand_over(stack, "moveit")
    near = [float(Q_UPPER[joint] - HOME[joint]) - 1e-3] if name == "out_of_limits" else [0.0]
    motion = course([float(k) for k in range(len(q))], [x + near[0] for x in q], v, joint)
    refusal = stack.propose("moveit", trajectory(stack, motion))
    assert refusal is not None
    assert refusal.name == name


@pytest.mark.parametrize("mass_kg", [-2.0, 6.2, 200.0, np.nan])
def test_an_object_that_no_hands_bear_is_refused(scene: SceneConfig, mass_kg: float) -> None:
    """Before, 200 kg (or grams?) threw the arms at 51 rad/s, in the latched stop too."""
    stack = supervised(Arms(scene))
    held = HeldObject(mass_kg, np.eye(3), (np.eye(4), np.eye(4)), np.array([0.0, 1.0, 0.0]))
    with pytest.raises(UsageError, match="two hands cannot hold"):
        stack.impedance.configure(held)


@pytest.mark.parametrize(
    ("name", "value"),
    [("stop_frequency_rad_s", 1.0), ("measurement_age_max_s", 0.1)],
)
def test_settings_with_which_no_stop_rests_are_refused(name: str, value: float) -> None:
    """With 0.1 rad/s an untold load of 0.6 kg fell at 14 rad/s; readings 95 ms late diverged beyond 60 rad/s."""
    with pytest.raises(ValueError, match=name):
        SupervisorConfig(**{name: value})
