"""The stop after a reflex: soft, within the motors' limits, latched, and at rest before joint limits and after pushes."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.config.scene import SceneConfig
from minidual.control.reflexes import Reflex, ReflexError
from minidual.control.soft_stop import SupervisedStop
from minidual.control.supervisor import OnReflex, Supervisor
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from tests.support.carried_rod import Carried
from tests.support.guarded_arms import (
    GuardedArms,
    accelerate,
    begin_swing,
    hold,
    measurement_at,
    swing,
)
from tests.support.panda import A_MAX, DOF, HOME, Q_UPPER, TAU_MAX, TAU_RATE_MAX, V_MAX
from tests.support.stacks import (
    SPACIOUS,
    Arms,
    fastest_in,
    hand_over,
    move,
    nan_of,
    run,
    stack_on,
    supervised,
    trajectory,
)

TAU_STEP = TAU_RATE_MAX * 1e-3 + 1e-9


def guarded(world: World, on_reflex: OnReflex | None = None) -> GuardedArms:
    return GuardedArms(world, Supervisor(on_reflex=on_reflex))


def stopped_by(arms: GuardedArms) -> Reflex:
    assert arms.error is not None
    return arms.error.reflex


def test_arms_come_to_rest_softly_and_stay_latched(world: World) -> None:
    arms = guarded(world)

    def press(t: float) -> None:
        if t > 0.3995:
            arms.supervisor.estop()

    arms.run(0.5, accelerate(0, 3.0), before=press)
    assert np.abs(world.v).max() > 1.0
    arms.go_on(1.0)  # the controller asks for NaN all the while
    assert np.abs(world.v).max() < 1e-3
    rest = world.q
    arms.go_on(0.5, tau=np.full(DOF, 1e9))
    assert np.abs(world.q - rest).max() < 1e-3
    applied = np.array(arms.applied)
    assert np.isfinite(applied).all()
    assert np.max(np.abs(applied) / TAU_MAX) <= 1.0
    assert np.max(np.abs(np.diff(applied, axis=0))) <= TAU_STEP
    assert arms.supervisor.reflex is not None
    arms.supervisor.reset()
    arms.error = None
    assert arms.run(0.2, hold(rest)) is None


def test_a_fast_shoulder_stops_within_its_acceleration_limit(world: World) -> None:
    """From 2.1 rad/s joint 2 needs 0.36 s and 0.39 rad."""
    start = HOME - 0.9 * np.eye(DOF)[1]
    world.reset(start)
    arms = guarded(world)

    def press(t: float) -> None:
        if t >= 0.35:
            arms.supervisor.estop()

    arms.run(0.4, accelerate(1, 6.0, until_s=0.35, q0=start), before=press)
    assert world.v[1] == pytest.approx(2.1, abs=0.02)
    q = world.q
    began_s = world.time
    commands_n = len(arms.applied)
    while np.abs(world.v).max() > 0.01 and world.time < began_s + 1.0:
        arms.go_on(1e-3)
    assert world.time - began_s < 0.4
    assert world.q[1] - q[1] < 0.41
    torques = np.array(arms.applied[commands_n - 1 :])
    assert np.abs(torques / TAU_MAX).max() < 0.9
    assert np.abs(np.diff(torques, axis=0)).max() <= TAU_STEP


def test_a_joint_near_its_limit_does_not_wait_for_a_faster_one(kinematics: Kinematics) -> None:
    stop = SupervisedStop(kinematics, Supervisor().config, 1e-3)
    q = HOME.copy()
    v = np.zeros(DOF)
    v[1] = 2.1
    v[6] = 1.0
    q[6] = Q_UPPER[6] - 0.1  # the two would stop together after 0.2 rad of joint 7
    stop.begin(q, v)
    tau = kinematics.gravity(q).copy()
    for tick in range(600):
        reference = stop._profile
        tau = stop.torque(measurement_at(1e-3 * tick, reference.q, reference.v), tau)
    rest = stop._profile.q
    assert 0.3 < rest[1] - q[1] < 0.45
    assert rest[6] < Q_UPPER[6]


@pytest.mark.parametrize(
    ("how", "beyond_rad"),
    [("halt", 0.03), ("guarded halt", 0.02), ("stop", 0.003)],
)
@pytest.mark.parametrize("joint", [0, 4])
@pytest.mark.parametrize("share", [0.5, 0.8])
def test_a_stop_that_begins_while_a_plan_brakes_before_a_limit_hardly_passes_it(
    scene: SceneConfig,
    joint: int,
    how: str,
    beyond_rad: float,
    share: float,
) -> None:
    goal = HOME.copy()
    goal[joint] = Q_UPPER[joint] - 0.002
    start = goal - 0.5 * np.eye(DOF)[joint]
    span_s = 1.05 * max(1.875 * 0.5 / V_MAX[joint], np.sqrt(5.7735 * 0.5 / A_MAX[joint]))
    plant = Arms(scene)
    plant.reset(start)
    supervisor = None if how == "halt" else Supervisor(SPACIOUS, dt_s=plant.dt)
    stack = stack_on(plant, supervisor=supervisor)
    hand_over(stack, "moveit")
    assert stack.propose("moveit", trajectory(stack, move(start, goal, span_s))) is None
    run(stack, round(share * span_s / plant.dt))
    if how == "stop":
        stack.supervisor.estop()
    else:
        stack.halt("teleop")
    highest = -np.inf
    for _ in range(600):
        run(stack, 1)
        highest = max(highest, plant.true_q[joint])
    assert highest - Q_UPPER[joint] < beyond_rad
    assert np.abs(plant.v).max() < 0.05


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
    plant = Arms(scene)
    stack = supervised(plant)
    stack.supervisor.estop()
    assert run(stack, 100) == ["emergency_stop"]
    for k in range(1500):
        plant.pushed = push_nm * min(1.0, k / 300.0) * np.eye(DOF)[joint]
        run(stack, 1)
    away = plant.q - HOME
    assert np.abs(away).max() > 0.4
    plant.touch_nothing()
    assert fastest_in(stack, 1500) < peak_rad_s
    assert np.abs(plant.q - HOME - away).max() < 0.12
    assert np.abs(plant.v).max() < 0.01


# Readings that are lost ---------------------------------------------------------------------------------------

LEFT = tuple(range(7))
LOST: dict[str, tuple[tuple[int, ...], bool, bool]] = {
    "a position": ((1,), True, False),
    "a velocity": ((1,), False, True),
    "the left arm": (LEFT, True, True),
    "both arms": (tuple(range(DOF)), True, True),
}
"""Joints, and whether their positions and velocities are NaN."""


@pytest.mark.parametrize("what", LOST)
def test_lost_readings_speed_no_joint_up_and_the_other_arm_stops_as_ever(
    world: World,
    what: str,
) -> None:
    """From 0.9 rad/s, beside a stop with sound readings; test_blind_joints has frozen ones."""
    joints, lose_q, lose_v = LOST[what]
    seeing = guarded(world)
    begin_swing(world)

    def press(t: float) -> None:
        if t > 0.0185:
            seeing.supervisor.estop()

    seeing.run(0.02, swing, before=press)
    sound_speed, sound_way = seeing.go_on(1.0)
    assert sound_speed == pytest.approx([0.9, 0.9], abs=0.01)

    def senses(t: float, q: Array, v: Array) -> tuple[Array, Array]:
        if t < 0.0195:
            return q, v
        nothing = nan_of(*joints)
        return nothing(q) if lose_q else q, nothing(v) if lose_v else v

    begin_swing(world)
    arms = guarded(world)
    arms.run(0.1, swing, senses=senses)
    assert stopped_by(arms).label == "measurement.not_finite"
    speed, way = arms.go_on(1.0, senses=senses)
    assert speed.max() <= 0.93
    assert way.max() <= sound_way.max() + 0.1
    if len(joints) < DOF:
        assert way[1] == pytest.approx(sound_way[1], abs=0.01)
        assert speed[1] <= sound_speed[1] + 0.01
    assert np.abs(world.v).max() < 0.02
    assert np.abs(np.diff(arms.applied, axis=0)).max() <= TAU_STEP


class Gap(World):
    """A world whose joint readings are lost in some ticks."""

    gap = ""
    kept: tuple[Array, Array, float] | None = None

    def _read(self, name: str, value: Any) -> Any:
        if self.gap == "NaN" and name in "qv":
            return np.where(np.arange(DOF) < 7, np.nan, value)
        if self.gap == "no packets":
            kept = self.__dict__.setdefault("packet", {})
            return kept.setdefault(name, value)
        return value

    @property
    def q(self) -> Array:
        return self._read("q", super().q)

    @property
    def v(self) -> Array:
        return self._read("v", super().v)

    @property
    def stamp_s(self) -> float:
        return self._read("stamp_s", super().stamp_s)


@pytest.mark.parametrize(
    ("gap", "ticks", "sinks_m"),
    [("NaN", 1, 0.001), ("NaN", 25, 0.001), ("no packets", 100, 0.015)],
)
def test_a_carried_rod_stays_in_the_hands_when_readings_are_lost(
    world: World,
    gap: str,
    ticks: int,
    sinks_m: float,
) -> None:
    """The simulated brakes of both arms do not know the weight of the rod."""
    carried = Carried(world)
    carried.carry((0.25, 0.0, 0.05), 0.9)
    carried.run(850)
    assert np.abs(world.v).max() > 1.0
    world.__class__ = Gap
    world.gap = gap  # type: ignore[attr-defined]
    carried.run(ticks)
    world.gap = ""  # type: ignore[attr-defined]
    carried.run(600)
    assert len(carried.names) == 1
    assert carried.names[0].startswith("measurement.")
    height_m = carried.height_m
    carried.fastest = 0.0
    carried.run(1000)
    assert carried.fastest < 0.05
    assert abs(carried.height_m - height_m) < sinks_m
    assert carried.height_m > 0.14
    carried.stack.recover()
    carried.run(300)
    assert len(carried.names) == 1


# The callback and the emergency stop ------------------------------------------------------------------------


def test_the_callback_gets_the_reflex_and_its_file_is_named(world: World) -> None:
    reflexes: list[Reflex] = []

    def write(reflex: Reflex) -> Path:
        reflexes.append(reflex)
        return Path("last-second.npz")

    arms = guarded(world, write)
    arms.supervisor.estop()
    error = arms.run(0.1)
    assert reflexes == [stopped_by(arms)]
    assert "minidual replay last-second.npz" in str(error)


def test_a_callback_that_breaks_does_not_take_the_torque_away(world: World) -> None:
    def broken(reflex: Reflex) -> None:
        raise RuntimeError("no room")

    arms = guarded(world, broken)
    arms.supervisor.estop()
    error = arms.run(0.1)
    assert error is not None
    assert error.dump is None
    assert isinstance(error.__cause__, RuntimeError)
    assert "the last second was not written: RuntimeError: no room" in str(error)
    arms.go_on(0.1)
    assert np.isfinite(arms.applied).all()


def test_the_first_torque_of_a_stop_does_not_wait_for_the_callback(scene: SceneConfig) -> None:
    plant = Arms(scene)
    commands_n: list[int] = []
    supervisor = Supervisor(
        dt_s=plant.dt,
        on_reflex=lambda reflex: commands_n.append(len(plant.torques)),  # type: ignore[func-returns-value]
    )
    stack = stack_on(plant, supervisor=supervisor)
    run(stack, 5)
    supervisor.estop()
    with pytest.raises(ReflexError) as caught:
        stack.step()
    assert commands_n == [6]
    np.testing.assert_array_equal(plant.torques[-1], caught.value.tau)


def test_the_error_crosses_processes(world: World) -> None:
    arms = guarded(world)
    arms.supervisor.estop()
    error = arms.run(0.1)
    assert error is not None
    copied = pickle.loads(pickle.dumps(error))
    assert copied.reflex == error.reflex
    assert (copied.message, copied.remedy) == (error.message, error.remedy)
    np.testing.assert_array_equal(copied.tau, error.tau)


def test_an_emergency_stop_under_another_reflex_outlives_the_reset(world: World) -> None:
    arms = guarded(world)
    arms.run(1.0, accelerate(6, 12.0))
    assert stopped_by(arms).label == "speed.joint"
    arms.supervisor.estop("red button")
    arms.go_on(0.5)
    for label in ("emergency_stop", ""):  # once it was reported, a reset clears it
        arms.supervisor.reset()
        arms.error = None
        arms.run(0.1, hold(world.q))
        assert ("" if arms.error is None else stopped_by(arms).label) == label
