"""Timing engines: each keeps its limits on a finer grid than it solved."""

import numpy as np
import pytest

from minidual.config.planning import MotionLimits, PlannerConfig
from minidual.config.root import Config
from minidual.errors import UsageError
from minidual.motion.api import Planner
from minidual.motion.goal import Goal, Move, TipOffset
from minidual.motion.goal_plan import GoalPlanner
from minidual.motion.timing_engines import (
    OWN,
    TIMING_ENGINES,
    TimingEngine,
    duration_ratio,
)
from minidual.proof.limits import limit_use
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Robot
from minidual.stages.config_checks import check_plan
from tests.support.panda import A_MAX, HOME, TAU_MAX, V_MAX
from tests.support.planning_oracles import polyline_from

LIMITS = MotionLimits()
PER_SAMPLE = 10


@pytest.fixture(scope="module")
def kinematics():
    return Kinematics()


@pytest.fixture(scope="module")
def toppra():
    return TIMING_ENGINES["toppra"]


def fine_derivatives(trajectory):
    """Return positions, velocities and accelerations between the samples, ten in each step.

    Accelerations are differences of the cubics' velocities.
    """
    fine_n = PER_SAMPLE * (len(trajectory.times) - 1) + 1
    times = np.linspace(0.0, trajectory.duration_s, fine_n)
    q, v, _ = trajectory.sample_many(times)
    a = np.diff(v, axis=0) / (times[1] - times[0])
    return q, v, a


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("group", ["left_arm", "both_arms"])
def test_toppra_keeps_velocity_acceleration_and_torque_between_its_samples(
    toppra,
    kinematics,
    seed,
    group,
):
    curve = polyline_from(HOME, DUAL_PANDA.groups[group], seed)
    motion = toppra.time_path(curve, group, LIMITS, kinematics).trajectory
    q, v, a = fine_derivatives(motion)
    assert (np.abs(v) / V_MAX).max() <= LIMITS.velocity_scale * (1.0 + 1e-3)
    # Within a step, the cubic overshoots a jump of acceleration by a third of it.
    assert (np.abs(a) / A_MAX).max() <= 1.0
    assert (np.abs(motion.a) / A_MAX).max() <= LIMITS.acceleration_scale * (1.0 + 1e-6)
    torques = kinematics.torques(q[:-1], v[:-1], a)
    assert (np.abs(torques) / TAU_MAX).max() <= 1.0
    assert np.abs(q[[0, -1]] - curve.at(np.array([0.0, curve.length]))).max() < 1e-9
    assert not motion.v[[0, -1]].any()


def test_toppra_drives_at_a_limit_all_the_way(toppra, kinematics):
    """It is time-optimal: at each moment a joint is near its limit of velocity or acceleration."""
    curve = polyline_from(HOME, DUAL_PANDA.groups["both_arms"], seed=1)
    motion = toppra.time_path(curve, "both_arms", LIMITS, kinematics).trajectory
    velocity_use = (np.abs(motion.v) / (LIMITS.velocity_scale * V_MAX)).max(axis=1)
    acceleration_use = (np.abs(motion.a) / (LIMITS.acceleration_scale * A_MAX)).max(axis=1)
    assert np.mean(np.maximum(velocity_use, acceleration_use) > 0.9) > 0.8


def test_toppra_keeps_a_torque_limit_that_is_tighter_than_acceleration(toppra, kinematics):
    curve = polyline_from(HOME, DUAL_PANDA.groups["left_arm"], seed=2)
    resting = np.abs(kinematics.gravity(HOME)) / TAU_MAX
    loose = toppra.time_path(curve, "left_arm", LIMITS, kinematics).trajectory
    tight_scale = 1.1 * max(
        resting.max(),
        (np.abs([kinematics.gravity(q) for q in loose.q[::20]]) / TAU_MAX).max(),
    )
    limits = LIMITS.model_copy(update={"torque_scale": tight_scale})
    tight = toppra.time_path(curve, "left_arm", limits, kinematics).trajectory
    assert limit_use(loose, kinematics).torque_ratio > tight_scale
    assert limit_use(tight, kinematics).torque_ratio <= tight_scale * (1.0 + 1e-3)
    assert tight.duration_s > loose.duration_s


def test_a_plan_timed_by_toppra_is_proven_but_for_what_toppra_does_not_limit():
    goal = HOME + 0.4
    planner = Planner(config=PlannerConfig(timing="toppra"))
    result = planner.plan_to_joints("both_arms", HOME, goal)
    assert result.verification.ok
    assert result.verification.reported_only == ("jerk", "torque_rate")
    assert result.verification.torque_rate_ratio > 1.0
    # The same trajectory fails the check that own plans must pass.
    strict = planner.engines().verify(result.trajectory)
    assert not strict.ok
    assert "torque rate limit" in strict.reason
    own = Planner().plan_to_joints("both_arms", HOME, goal)
    assert own.verification.reported_only == ()
    assert own.verification.torque_rate_ratio <= 1.0
    assert result.trajectory.duration_s < own.trajectory.duration_s


def test_straight_moves_follow_the_engine():
    planner = GoalPlanner(Planner(config=PlannerConfig(timing="toppra")))
    start = planner.states.joints("ready", "both_arms", HOME)
    move = Move(left=TipOffset(offset_m=(0.0, 0.0, 0.05)))
    result = planner.plan("left_arm", start, Goal(move=move, linear=True))
    assert result.verification.ok
    assert result.verification.reported_only == ("jerk", "torque_rate")


def test_nan_is_refused_by_a_limit_that_is_only_reported(kinematics):
    curve = polyline_from(HOME, DUAL_PANDA.groups["left_arm"], seed=0)
    motion = OWN.time_path(curve, "left_arm", LIMITS, kinematics).trajectory
    motion.a[50, 2] = np.nan
    assert limit_use(motion, kinematics, reported=("acceleration", "jerk", "torque")).broken


def test_an_unknown_engine_gets_a_suggestion():
    with pytest.raises(UsageError, match=r"timing engine .topra.") as refusal:
        Planner(config=PlannerConfig(timing="topra"))
    assert "toppra" in str(refusal.value)
    config = Config()
    planner = config.plan.planner.model_copy(update={"timing": "topra"})
    plan = config.plan.model_copy(update={"planner": planner})
    with pytest.raises(UsageError, match="topra"):
        check_plan(config.model_copy(update={"plan": plan}))


def test_the_ratio_of_durations_is_that_of_both_trajectories(toppra, kinematics):
    curve = polyline_from(HOME, DUAL_PANDA.groups["both_arms"], seed=3)
    own = OWN.time_path(curve, "both_arms", LIMITS, kinematics).trajectory
    other = toppra.time_path(curve, "both_arms", LIMITS, kinematics).trajectory
    ratio = duration_ratio(curve, "both_arms", LIMITS, kinematics)
    assert ratio == own.duration_s / other.duration_s
    assert ratio > 1.0


def test_an_engine_from_outside_times_plans(monkeypatch):
    """A row of the table is enough; half as fast it takes twice as long."""

    def half_as_fast(path, group, limits, kinematics, along=None):
        slow = {
            "velocity_scale": 0.5 * limits.velocity_scale,
            "acceleration_scale": 0.25 * limits.acceleration_scale,
        }
        return OWN.time_path(path, group, limits.model_copy(update=slow), kinematics, along)

    monkeypatch.setitem(TIMING_ENGINES._rows, "slow", TimingEngine(half_as_fast))
    goal = HOME + 0.4
    slow = Planner(config=PlannerConfig(timing="slow")).plan_to_joints("both_arms", HOME, goal)
    own = Planner().plan_to_joints("both_arms", HOME, goal)
    ratio = slow.trajectory.duration_s / own.trajectory.duration_s
    assert ratio == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("arm", ["xarm7"])
def test_toppra_times_other_arms(toppra, arm):
    from minidual.robot.pair import ARM_MODELS

    robot = Robot(ARM_MODELS[arm])
    kinematics = Kinematics(robot)
    curve = polyline_from(robot.home, robot.groups["both_arms"], seed=0)
    motion = toppra.time_path(curve, "both_arms", LIMITS, kinematics).trajectory
    assert limit_use(motion, kinematics, toppra.unlimited).broken == ""
