"""Cross-checks of joint readings, and what one wrong packet does to the arms."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.config.control import SupervisorConfig
from minidual.config.scene import SceneConfig
from minidual.control.joint_check import BLIND_S, JointCheck, slower
from minidual.control.stack import ControlStack
from minidual.plant.world import World
from minidual.robot.pair import DUAL_PANDA, Array
from tests.support.carried_rod import Carried
from tests.support.panda import DOF, HOME, JOINT_NAMES
from tests.support.stacks import (
    APART,
    Arms,
    FailingPlant,
    SlowArms,
    fastest_in,
    hand_over,
    in_motion,
    move,
    nan_of,
    off_by,
    run,
    supervised,
    trajectory,
)

DT = 1e-3
NOTHING = np.zeros(DOF)
JOINT_2 = np.eye(DOF)[1]


class Checked:
    """Readings of arms that move at a constant velocity, and their check."""

    def __init__(self, v: Array) -> None:
        self.check = JointCheck(DUAL_PANDA, SupervisorConfig(), DT)
        self.q = HOME.copy()
        self.v = v
        self.check.begin(self.q, v)

    def tick(self, dq: Array = NOTHING, dv: Array = NOTHING, applied: Array = NOTHING) -> None:
        """Take the next reading, wrong by dq and dv."""
        self.q = self.q + DT * self.v
        self.check.update(self.q + dq, self.v + dv, DT, applied, NOTHING)
        self.check.coast(DT)


def test_readings_that_agree_are_used_as_they_are() -> None:
    arms = Checked(0.5 * JOINT_2)
    for _ in range(200):
        arms.tick()
    assert not arms.check.blind.any()
    assert arms.check.why == ""
    np.testing.assert_array_equal(arms.check.q, arms.q)
    np.testing.assert_array_equal(arms.check.v, arms.v)


@pytest.mark.parametrize(
    ("dq", "dv", "detail", "text"),
    [
        (0.05, 0.0, "implausible", "position and velocity differ by 0.0500 rad"),
        (np.nan, 0.0, "not_finite", "position or velocity of"),
        (0.0, np.inf, "not_finite", "position or velocity of"),
    ],
)
def test_a_joint_that_fails_is_named_and_estimated_from_earlier_readings(
    dq: float,
    dv: float,
    detail: str,
    text: str,
) -> None:
    arms = Checked(0.5 * JOINT_2)
    for _ in range(50):
        arms.tick()
    arms.tick(
        dq * JOINT_2 if np.isfinite(dq) else np.where(JOINT_2, dq, 0.0), np.where(JOINT_2, dv, 0.0)
    )
    check = arms.check
    assert np.flatnonzero(check.blind).tolist() == [1]
    assert check.detail == detail
    assert text in check.why
    assert JOINT_NAMES[1] in check.why
    assert check.v[1] == pytest.approx(0.5)
    assert check.q[1] == pytest.approx(arms.q[1], abs=2e-3)
    arms.tick()
    assert check.blind[1], "sound readings do not bring it back"
    check.reset()
    assert not check.blind.any()


def test_a_blind_joint_coasts_and_then_counts_as_at_rest() -> None:
    arms = Checked(0.5 * JOINT_2)
    for _ in range(50):
        arms.tick()
    arms.check.lose_all()
    assert arms.check.blind.all()
    assert not arms.check.braking_due
    for _ in range(round(BLIND_S / DT) - 1):
        arms.tick()
    assert arms.check.v[1] == pytest.approx(0.5)
    for _ in range(2):
        arms.tick()
    assert arms.check.braking_due
    assert arms.check.v[1] == 0.0


def test_readings_that_freeze_in_motion_are_noticed_within_10_ms() -> None:
    arms = Checked(0.5 * JOINT_2)
    for _ in range(50):
        arms.tick()
    q = arms.q.copy()
    ticks = 0
    while not arms.check.blind.any() and ticks < 20:
        arms.check.update(q, arms.v, DT, NOTHING, NOTHING)
        ticks += 1
    assert 2 <= ticks <= 10
    assert "unchanged" in arms.check.why


@pytest.mark.parametrize(("torque_nm", "noticed"), [(1.0, False), (4.0, True)])
def test_a_joint_at_rest_is_frozen_once_a_torque_should_move_it(
    torque_nm: float,
    noticed: bool,
) -> None:
    arms = Checked(NOTHING)
    for _ in range(100):
        arms.tick()
    assert not arms.check.blind.any()
    for _ in range(30):
        arms.tick(applied=torque_nm * JOINT_2)
    assert arms.check.blind[1] == noticed


def test_readings_after_a_long_silence_are_compared_with_nothing_before_it() -> None:
    arms = Checked(0.5 * JOINT_2)
    for _ in range(50):
        arms.tick()
    arms.check.update(arms.q + 0.3 * JOINT_2, arms.v, 0.2, NOTHING, NOTHING)
    assert not arms.check.blind.any()


def test_the_slower_of_two_velocities() -> None:
    v = slower(np.array([2.0, -0.1, 0.0]), np.array([-0.5, 3.0, np.nan]))
    np.testing.assert_array_equal(v, [-0.5, -0.1, 0.0])


# On arms ----------------------------------------------------------------------------------------------------


def after_one_packet(
    plant: FailingPlant,
    stack: ControlStack,
    dq: Array,
    dv: Array,
) -> tuple[list[str], float]:
    """Return the reflexes of one wrong packet and the second after it, and the largest speed."""
    plant.lies.update(q=lambda q: q + dq, v=lambda v: v + dv)
    names = run(stack, 1)
    plant.lies.clear()
    fastest = 0.0
    for _ in range(round(1.0 / plant.dt)):
        names += run(stack, 1)
        fastest = max(fastest, float(np.abs(plant.true_v).max()))
    return names, fastest


@pytest.mark.parametrize("joint", [1, 5])
@pytest.mark.parametrize(
    ("dq", "dv"),
    [(0.05, 0.5), (1.0, 2.4), (-3.0, 3.0), (0.3, 1e3), (0.0, 8.0), (0.0, 20.0)],
)
def test_one_wrong_packet_moves_no_resting_arm(
    scene: SceneConfig,
    joint: int,
    dq: float,
    dv: float,
) -> None:
    plant = Arms(scene)
    stack = supervised(plant)
    assert run(stack, 100) == []
    row = np.eye(DOF)[joint]
    names, fastest = after_one_packet(plant, stack, dq * row, dv * row)
    assert names == ["speed.joint" if (dq, dv) == (0.0, 8.0) else "measurement.implausible"]
    assert fastest < 0.03
    assert np.abs(plant.q - HOME).max() < 0.005


@pytest.mark.parametrize(("rate_hz", "dq"), [(100, 0.006), (100, 0.03), (50, 0.03), (50, 0.08)])
def test_one_wrong_position_moves_no_resting_arm_of_a_slow_plant(
    scene: SceneConfig,
    rate_hz: int,
    dq: float,
) -> None:
    plant = SlowArms(scene, rate_hz)
    stack = supervised(plant)
    assert run(stack, 30) == []
    names, fastest = after_one_packet(plant, stack, dq * JOINT_2, NOTHING)
    assert names == ["measurement.implausible"]
    assert fastest < 0.02
    assert np.abs(plant.q - HOME).max() < 0.005


def test_two_joints_that_are_wrong_in_one_packet_move_no_resting_arm(scene: SceneConfig) -> None:
    plant = Arms(scene)
    stack = supervised(plant)
    assert run(stack, 100) == []
    other = np.eye(DOF)[8]
    names, fastest = after_one_packet(plant, stack, 0.5 * other, 1000.0 * other + 8.0 * JOINT_2)
    assert len(names) == 1
    assert fastest < 0.12
    assert np.abs(plant.q - HOME).max() < 0.01


@pytest.mark.parametrize("how", ["speed.joint", "emergency_stop", "halt"])
def test_one_wrong_velocity_moves_no_resting_arm_in_a_stop(scene: SceneConfig, how: str) -> None:
    plant = Arms(scene)
    stack = supervised(plant)
    hand_over(stack, "moveit")
    assert run(stack, 100) == []
    if how == "emergency_stop":
        stack.supervisor.estop()
    if how == "halt":
        stack.halt("moveit")
    speed = 3.0 if how == "speed.joint" else 2.0
    names, _ = after_one_packet(plant, stack, NOTHING, speed * JOINT_2)
    assert names == ([] if how == "halt" else [how])
    assert np.abs(plant.q - HOME).max() < 0.005


@pytest.mark.parametrize(("first", "second"), [("q", "v"), ("v", "q")])
def test_a_joint_that_has_lost_one_value_follows_no_glitch_of_the_other(
    scene: SceneConfig,
    first: str,
    second: str,
) -> None:
    plant = Arms(scene)
    stack = supervised(plant)
    run(stack, 50)
    plant.lies[first] = nan_of(1)
    assert run(stack, 300) == ["measurement.not_finite"]
    rest = plant.true_q.copy()
    plant.lies[second] = off_by(1, 3.0)
    run(stack, 1)
    del plant.lies[second]
    assert fastest_in(stack, 500) < 0.1
    assert np.abs(plant.true_q - rest).max() < 0.01


def test_the_first_packet_after_an_outage_is_not_believed_alone(scene: SceneConfig) -> None:
    plant = Arms(scene)
    stack = supervised(plant)
    run(stack, 50)
    stack.supervisor.estop()
    run(stack, 200)
    everything = range(DOF)
    plant.lies.update(q=nan_of(*everything), v=nan_of(*everything))
    run(stack, 30)
    plant.lies.update(q=off_by(1, 0.3), v=off_by(1, 2.0))
    run(stack, 1)
    plant.lies.clear()
    assert fastest_in(stack, 1000) < 0.1
    assert np.abs(plant.q - HOME).max() < 0.01


@pytest.mark.parametrize("bias", [0.3, 1.0])
def test_a_velocity_with_a_bias_is_named_and_moves_the_arm_little(
    scene: SceneConfig,
    bias: float,
) -> None:
    plant = Arms(scene)
    stack = supervised(plant)
    run(stack, 100)
    plant.lies["v"] = off_by(1, bias)
    assert len(run(stack, 30)) == 1, "a contact, a blocked joint or readings that disagree"
    assert fastest_in(stack, 1000) < 0.6
    assert np.abs(plant.true_q - HOME).max() < 0.12


@pytest.mark.parametrize("joint", [0, 3, 5])
def test_one_joint_that_freezes_at_rest_is_named_when_the_arms_set_out(
    scene: SceneConfig,
    joint: int,
) -> None:
    plant = Arms(scene)
    stack = supervised(plant)
    hand_over(stack, "moveit")
    run(stack, 100)
    frozen = np.arange(DOF) == joint
    q = plant.true_q.copy()
    v = plant.true_v.copy()
    plant.lies["q"] = lambda x: np.where(frozen, q, x)
    plant.lies["v"] = lambda x: np.where(frozen, v, x)
    assert stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.8 * APART, 0.8))) is None
    assert run(stack, 90) == ["measurement.implausible"]
    assert np.abs(plant.true_v[joint]) < 0.2


@pytest.mark.parametrize("rate_hz", [1000, 100])
def test_arms_that_stand_under_a_load_are_not_frozen(scene: SceneConfig, rate_hz: int) -> None:
    """Readings that are constant to the bit, at the start and in a stop."""
    plant = SlowArms(scene, rate_hz)
    plant.lies |= {"q": lambda q: np.round(q, 3), "v": lambda v: np.round(v, 2)}
    stack = supervised(plant)
    for arm in (0, 1):
        stack.payload.bear(arm, 1.0, at_once=True)
    jacobians = stack.kinematics.tcp_jacobians(HOME)
    plant.pushed = -9.81 * sum(J[2] for J in jacobians)
    stack._loop.writer.applied = stack.applied - plant.pushed
    assert run(stack, 100) == []
    stack.supervisor.estop()
    assert run(stack, 200) == ["emergency_stop"]
    assert not stack.measurement.blind.any()
    assert np.abs(plant.true_v).max() < 0.05


@pytest.mark.parametrize("period", [2, 5, 20])
def test_an_emergency_stop_brakes_while_a_joint_is_measured_now_and_then(
    scene: SceneConfig,
    period: int,
) -> None:
    plant = Arms(scene)
    stack = in_motion(plant)
    stack.supervisor.estop()
    began = plant.true_q.copy()
    for tick in range(1000):
        plant.lies.clear()
        if tick % period == 0:
            plant.lies.update(q=nan_of(4), v=nan_of(4))
        run(stack, 1)
    assert np.abs(plant.true_q - began).max() < 0.12
    assert np.abs(plant.true_v).max() < 0.05


def test_one_wrong_packet_moves_no_rod_in_the_hands(world: World) -> None:
    carried = Carried(world)
    position = type(world).q.fget  # type: ignore[attr-defined]
    wrong = [1]

    class Wrong(World):
        @property
        def q(self) -> Array:
            return position(self) + wrong[0] * 3.0 * JOINT_2

    world.__class__ = Wrong
    carried.run(1)
    wrong[0] = 0
    carried.run(1000)
    assert carried.names == ["measurement.implausible"]
    assert carried.height_m > 0.145
    assert world.grip.min() > 55.0
