"""Bounds of the supervisor: what legal motion may do, what the bounds depend on, and how often they are checked."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from minidual.config.control import SupervisorConfig
from minidual.control.bounds import Reach
from minidual.control.joint_control import JointLoop
from minidual.control.observer import Expected
from minidual.control.reflexes import ReflexError
from minidual.control.supervisor import Supervisor
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Array
from minidual.skills.supervised import arm_distance
from minidual.stages.env_check.tracking import sine_reference
from tests.support.guarded_arms import (
    GuardedArms,
    accelerate,
    guard_commands,
    measurement_at,
)
from tests.support.panda import A_MAX, DOF, HOME, Q_LOWER, Q_UPPER, TAU_RATE_MAX, V_MAX

REACH = Reach(Kinematics())
REST = np.zeros(DOF)


def guarded(world: World, **changes: object) -> GuardedArms:
    return GuardedArms(world, Supervisor(SupervisorConfig.model_validate(changes)))


# Legal motion -----------------------------------------------------------------------------------------------


def test_a_swing_of_all_joints_is_passed_on_unchanged(world: World) -> None:
    arms = GuardedArms(world, Supervisor(self_distance=arm_distance(DUAL_PANDA)))
    requested: list[Array] = []

    def swing(t: float) -> tuple[Array, Array, Array]:
        arms.supervisor.heard(t)
        return sine_reference(DUAL_PANDA, 0.3, 0.5, t)

    def note(_t: float, tau: Array) -> Array:
        requested.append(tau)
        return tau

    world.reset(sine_reference(DUAL_PANDA, 0.3, 0.5, 0.0)[0])
    assert arms.run(2.0, swing, torque=note, tell_reference=True) is None
    same = np.array(requested) == np.array(arms.applied)
    assert same[20:].all()  # at the start the torque comes from rest, at the rate of the motors


@pytest.mark.parametrize(("joint", "way"), [(0, 1.0), (3, 1.0), (5, -1.0), (6, 1.5)])
def test_a_far_target_through_the_filter_arrives(
    world: World,
    kinematics: Kinematics,
    joint: int,
    way: float,
) -> None:
    loop = JointLoop(world, kinematics)
    guard_commands(world, Supervisor(), lambda: loop.reference.a)
    target = HOME + way * np.eye(DOF)[joint]
    for _ in range(1500):
        loop.step(target, np.ones(2))
    assert np.abs(world.q - target).max() < 1e-4


@pytest.mark.parametrize(
    ("every", "by", "ramp_s", "least_nm", "most_nm"),
    [(20, 0.02, 0.02, 0.3, 1.0), (20, 0.02, 0.001, 5.0, 10.0), (100, 0.08, 0.02, 2.0, 4.0)],
    ids=["streamed", "without the ramp", "jumps"],
)
def test_targets_that_step_do_not_stop_the_arms(
    world: World,
    kinematics: Kinematics,
    monkeypatch: pytest.MonkeyPatch,
    every: int,
    by: float,
    ramp_s: float,
    least_nm: float,
    most_nm: float,
) -> None:
    monkeypatch.setattr("minidual.control.joint_control.RAMP_S", ramp_s)
    loop = JointLoop(world, kinematics)
    requested, applied = guard_commands(world, Supervisor(), lambda: loop.reference.a)
    target = HOME.copy()
    for k in range(1500):
        if k % every == 0 and k < 1000:
            target = target + by * np.eye(DOF)[0]
        loop.step(target, np.ones(2))
    step = np.abs(np.diff(requested, axis=0)).max()
    assert least_nm < step < most_nm
    assert np.abs(np.diff(applied, axis=0)).max() <= 1.0 + 1e-9
    followed = np.array_equal(requested, applied)
    assert followed == (step <= 1.0), "what the motors can follow is not changed"
    assert np.abs(world.q - target).max() < 1e-4


def test_a_joint_may_go_to_its_very_limit(world: World, kinematics: Kinematics) -> None:
    loop = JointLoop(world, kinematics)
    guard_commands(world, Supervisor())
    target = HOME.copy()
    target[6] = Q_UPPER[6]
    target[13] = Q_LOWER[13]
    for _ in range(2500):
        loop.step(target, np.ones(2))
    assert np.abs(world.q - target).max() < 1e-3


# Bounds -----------------------------------------------------------------------------------------------------


def test_the_position_margin_is_kept_off(world: World) -> None:
    error = guarded(world, position_margin_rad=0.2).run(4.0, accelerate(5, -0.5))
    assert error is not None
    assert error.reflex.label == "joint_position"
    assert error.reflex.bound == pytest.approx(Q_LOWER[5] + 0.2)


def test_a_jerk_of_the_reference_is_no_reflex_by_default(world: World) -> None:
    profile = accelerate(0, 10.0, until_s=0.05)
    assert guarded(world).run(0.2, profile, tell_reference=True) is None


def test_requested_torques_that_are_not_finite_stop_the_arms_in_the_first_tick_too(
    world: World,
    kinematics: Kinematics,
) -> None:
    arms = guarded(world)
    error = arms.run(0.01, torque=lambda t, tau: tau * np.nan)
    assert error is not None
    assert error.reflex.label == "controller_failed"
    assert "torque" in error.reflex.where
    assert error.tau == pytest.approx(kinematics.gravity(HOME), abs=1.01)


def test_a_failing_controller_is_one_reflex_and_then_the_soft_stop(world: World) -> None:
    arms = guarded(world)
    arms.run(0.05)
    arms.fail("the law is singular")
    first = arms.error
    arms.fail("again")
    assert arms.error is first
    assert np.abs(np.diff(arms.applied[-2:], axis=0)).max() <= TAU_RATE_MAX * 1e-3 + 1e-9


@pytest.mark.parametrize(
    ("body", "force_n"),
    [("left_panda_link5", (0.0, 10.0, 0.0)), ("right_panda_hand", (0.0, 0.0, 15.0))],
)
def test_a_light_touch_is_no_contact(
    world: World,
    body: str,
    force_n: tuple[float, float, float],
) -> None:
    row = world.model.body(body).id

    def push(t: float) -> None:
        world.data.xfrc_applied[row, :3] = np.array(force_n) * (t > 0.0995)

    assert guarded(world).run(0.3, before=push) is None


@pytest.mark.parametrize("mode", ["free motion", "closed hands", "held object"])
def test_contact_expects_more_of_hands_that_hold(world: World, mode: str) -> None:
    """25 N on a hand, of which the law of a held object expects 60 %."""
    torque = Kinematics().tcp_jacobians(HOME)[0][1] * 25.0
    expected = Expected(mode, 0.6 * torque if mode == "held object" else None)
    arms = guarded(world)
    arms.supervisor.expected = lambda: expected
    world.data.qfrc_applied[world.joints.qvel] = torque
    error = arms.run(0.2)
    world.data.qfrc_applied[:] = 0.0
    assert (error is not None) == (mode == "free motion"), error


@pytest.mark.parametrize(("period", "phase"), [(1, 0), (2, 1), (4, 3), (20, 2)])
def test_contact_is_felt_whatever_the_phase_of_the_measurements(period: int, phase: int) -> None:
    supervisor = Supervisor()
    rng = np.random.default_rng(0)
    gravity = np.array(Kinematics().gravity(HOME))
    measurement = measurement_at(0.0, HOME, REST)
    applied = gravity
    label = ""
    for tick in range(1, 400):
        time_s = 1e-3 * tick
        if tick % period == phase:
            q = HOME + 1e-6 * rng.standard_normal(DOF)
            measurement = measurement_at(time_s, q, 1e-6 * rng.standard_normal(DOF))
        else:
            measurement = measurement._replace(time_s=time_s, fresh_s=0.0)
        tau = gravity + min(40.0, 0.5 * tick) * np.eye(DOF)[1]
        try:
            applied = supervisor.guard(measurement, tau, applied)
        except ReflexError as error:
            label = error.reflex.label
            break
    assert label.startswith("contact.")


def test_without_the_look_at_distances_the_arms_touch(world: World) -> None:
    """Negative control of `clearance.arms`, which test_supervisor_latency triggers."""
    inwards = -0.5 * np.eye(DOF)[0] + 0.5 * np.eye(DOF)[7]
    guarded(world).run(2.2, lambda t: (HOME + 0.5 * t**2 * inwards, t * inwards, inwards))
    assert any("left" in a and "right" in b for a, b, _ in world.contact_pairs())


# Distances --------------------------------------------------------------------------------------------------


def corners_of_left_arm(world: World, q: Array) -> Array:
    """Return all corners (k, 3) [m] of the boxes round the geometries of the left arm."""
    model = world.model
    data = world.data
    data.qpos[world.joints.qpos] = q
    mujoco.mj_kinematics(model, data)
    signs = np.stack(np.meshgrid(*[[-1, 1]] * 3), -1).reshape(-1, 3)
    corners = []
    for geom in range(model.ngeom):
        if not model.body(model.geom_bodyid[geom]).name.startswith("left_"):
            continue
        centre, half = model.geom_aabb[geom].reshape(2, 3)
        rotation = data.geom_xmat[geom].reshape(3, 3)
        corners.append(data.geom_xpos[geom] + (centre + half * signs) @ rotation.T)
    return np.concatenate(corners)


def test_no_point_of_an_arm_moves_faster_than_its_reach_allows(world: World) -> None:
    rng = np.random.default_rng(0)
    for _ in range(30):
        q = rng.uniform(Q_LOWER, Q_UPPER)
        joint = int(rng.integers(7))
        before = corners_of_left_arm(world, q)
        after = corners_of_left_arm(world, q + 1e-5 * np.eye(DOF)[joint])
        fastest = np.linalg.norm(after - before, axis=1).max() / 1e-5
        assert fastest <= REACH.m[joint]
        assert fastest > 0.1 * REACH.m[joint]


def test_no_gap_closes_before_its_safe_time() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        v = rng.uniform(-V_MAX, V_MAX)
        gap_m = float(rng.uniform(0.0, 0.2))
        safe_s = REACH.safe_time_s(v, gap_m)
        assert safe_s * (REACH.m @ (np.abs(v) + A_MAX * safe_s)) == pytest.approx(gap_m, abs=1e-12)
    assert REACH.safe_time_s(V_MAX, -0.01) == 0.0


@pytest.mark.parametrize(
    ("distance_m", "every"),
    [(0.0101, 1), (0.02, 8), (0.15, 30), (9.0, 30)],
)
def test_the_nearer_the_arms_the_oftener_they_are_looked_at(distance_m: float, every: int) -> None:
    looks: list[int] = []
    tick = 0

    def distance(q: Array) -> tuple[str, float]:
        looks.append(tick)
        return "a with b", distance_m

    supervisor = Supervisor(self_distance=distance)
    tau = Kinematics().gravity(HOME).copy()
    for tick in range(200):
        supervisor.guard(measurement_at(0.001 * tick, HOME, REST), tau, tau)
    assert set(np.diff(looks)) == {every}


# Settings ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [
        "velocity_scale",
        "torque_scale",
        "torque_rate_scale",
        "acceleration_scale",
        "contact_scale",
        "deviation_scale",
    ],
)
def test_limits_can_be_tightened_and_not_loosened(name: str) -> None:
    assert SupervisorConfig.model_validate({name: 0.5})
    with pytest.raises(ValueError, match=name):
        SupervisorConfig.model_validate({name: 1.01})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("workspace_m", ((0.0, 1.0), (1.0, 0.0), (0.0, 1.0))),
        ("stop_frequency_rad_s", 1.0),
        ("stop_deceleration_scale", 0.1),
        ("measurement_age_max_s", 0.1),
    ],
)
def test_settings_with_which_no_stop_rests_are_refused(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=name):
        SupervisorConfig.model_validate({name: value})
