"""The scripted operator is smooth, inside the limits, and alike in every trial."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.config.learning import OperatorConfig
from minidual.config.scene import SceneConfig
from minidual.control.kernels import minimum_jerk
from minidual.errors import UsageError
from minidual.motion.ik import posture_at
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA
from minidual.skills.operator import ScriptedOperator
from minidual.tasks.task import grasp_offsets, level_pose
from tests.support.carry_trials import rod_trial, sample_trial
from tests.support.panda import A_MAX, HOME, Q_LOWER, Q_UPPER, V_MAX

SEED = 5


@pytest.fixture(scope="module")
def operator() -> ScriptedOperator:
    return ScriptedOperator(SceneConfig())


def _tick(operator: ScriptedOperator, phase: str, rate_hz: float = 50.0) -> int:
    return round(operator.phases()[phase][1] * rate_hz)


def test_the_minimum_jerk_profile_starts_and_ends_at_rest() -> None:
    s = np.linspace(0.0, 1.0, 2001)
    x = np.array([minimum_jerk(value)[0] for value in s])
    velocity = np.gradient(x, s)
    assert (x[0], x[-1]) == (0.0, 1.0)
    assert np.abs(velocity[[0, -1]]).max() < 1e-5
    assert np.all(np.diff(x) >= 0.0)
    assert velocity.max() == pytest.approx(1.875, abs=1e-3)  # 30/16, Flash and Hogan


@pytest.mark.parametrize("index", range(4))
def test_targets_start_at_home_and_respect_the_joints(
    operator: ScriptedOperator,
    index: int,
) -> None:
    trial = sample_trial(operator.scene, SEED, "demonstrations", index, widen=1.3)
    demo = operator.plan(trial, seed=SEED)
    np.testing.assert_allclose(demo.q[0], HOME, atol=1e-6)
    assert 7.0 <= demo.duration_s <= 9.0
    assert np.all((demo.q > Q_LOWER + 0.1) & (demo.q < Q_UPPER - 0.1))
    velocity = np.diff(demo.q, axis=0) * demo.rate_hz
    assert np.all(np.abs(velocity) < 0.95 * V_MAX)
    acceleration = np.diff(velocity, axis=0) * demo.rate_hz
    assert np.all(np.abs(acceleration) < A_MAX)


def test_the_hands_hold_the_rod_from_grasp_to_release(operator: ScriptedOperator) -> None:
    scene = operator.scene
    kinematics = Kinematics()
    trial = rod_trial("t", 0, (0.52, 0.23, 0.2), (0.5, -0.25, 0.0))
    demo = operator.plan(trial, seed=SEED)
    left_grasp, right_grasp = grasp_offsets(scene)
    radius_m = scene.object.radius_m
    for tick, (x, y, yaw), height_m in (
        (_tick(operator, "descend"), trial.start["rod"], radius_m),
        (_tick(operator, "open") - 1, trial.goal["rod"], radius_m - operator.config.set_down_m),
    ):
        T_world_rod = level_pose(x, y, height_m, yaw)
        left, right = kinematics.tcp_poses(demo.q[tick])
        np.testing.assert_allclose(left, T_world_rod @ left_grasp, atol=1e-5)
        np.testing.assert_allclose(right, T_world_rod @ right_grasp, atol=1e-5)
    # Between the two the hands must not pull at the rod: their distance is the rod's all the way.
    for tick in range(_tick(operator, "descend"), _tick(operator, "open"), 10):
        left, right = kinematics.tcp_poses(demo.q[tick])
        assert np.linalg.norm(left[:3, 3] - right[:3, 3]) == pytest.approx(
            2 * scene.object.grasp_offset_m,
            abs=1e-6,
        )


def test_a_box_is_grasped_at_the_height_at_which_it_rests() -> None:
    scene = SceneConfig.model_validate(
        {"object": {"shape": "box", "length_m": 0.3, "width_m": 0.06, "height_m": 0.06}},
    )
    operator = ScriptedOperator(scene)
    place = (0.5, 0.25, 0.0)
    demo = operator.plan(rod_trial("t", 0, place, (0.5, -0.25, 0.0)), seed=SEED)
    left, _ = Kinematics().tcp_poses(demo.q[_tick(operator, "descend")])
    np.testing.assert_allclose(
        left,
        level_pose(*place[:2], 0.03, 0.0) @ grasp_offsets(scene)[0],
        atol=1e-5,
    )


def test_grippers_close_once_and_open_once(operator: ScriptedOperator) -> None:
    demo = operator.plan(sample_trial(operator.scene, SEED, "demonstrations", 0), seed=SEED)
    closed = np.flatnonzero(demo.gripper[:, 0] == 0.0)
    np.testing.assert_array_equal(demo.gripper[:, 0], demo.gripper[:, 1])
    assert closed[0] == _tick(operator, "descend")
    assert closed[-1] + 1 == _tick(operator, "land")
    assert len(closed) == closed[-1] - closed[0] + 1


def test_the_last_of_the_way_down_is_slow(operator: ScriptedOperator) -> None:
    """Wherever within four millimetres a policy that copies it meets the table."""
    demo = operator.plan(sample_trial(operator.scene, SEED, "demonstrations", 0), seed=SEED)
    down = slice(_tick(operator, "carry"), _tick(operator, "land"))
    kinematics = Kinematics()
    heights_m = np.array([kinematics.tcp_poses(q)[0][2, 3] for q in demo.q[down]])
    near = heights_m[1:] < heights_m[-1] + operator.config.set_down_m + 0.004
    speeds_m_per_s = -np.diff(heights_m) * demo.rate_hz
    assert near.sum() > 10
    assert speeds_m_per_s[near].max() < 0.06
    assert speeds_m_per_s.max() > 0.2


def test_the_approach_errs_across_before_and_along_while_the_hands_go_down(
    operator: ScriptedOperator,
) -> None:
    """Above the object, the hands must not tell where along it the grasp is."""
    plain = {"approach_noise_m": 0.0, "along_noise_m": 0.0, "approach_noise_rad": 0.0}
    exact = ScriptedOperator(operator.scene, OperatorConfig(**plain))
    trial = rod_trial("t", 3, (0.52, 0.23, 0.2), (0.5, -0.25, 0.0))
    erring = operator.plan(trial, seed=SEED)
    clean = exact.plan(trial, seed=SEED)
    across, along, _ = operator.approach_error(SEED, trial)
    assert min(abs(across), abs(along)) > 1e-3
    arrived, corrected, down = (
        _tick(operator, phase) for phase in ("approach", "correct", "descend")
    )
    arrived -= round(operator.config.overlap_s * 50.0)  # the correction begins here
    kinematics = Kinematics()
    middles = []
    for demo in (erring, clean):
        middles.append([sum(T[:3, 3] for T in kinematics.tcp_poses(q)) / 2 for q in demo.q])
    wrong = (np.array(middles[0]) - np.array(middles[1])) @ level_pose(0.0, 0.0, 0.0, 0.2)[
        :3,
        :2,
    ]  # across, along
    assert np.all(
        wrong[arrived] / (across, along) > 0.8,
    )  # nearly there, and nearly all of it wrong
    assert abs(wrong[corrected, 0]) < 1e-3
    assert wrong[corrected, 1] / along > 0.7  # a third of the way down in time
    np.testing.assert_allclose(erring.q[down:], clean.q[down:], atol=1e-4)


@pytest.mark.parametrize("index", range(8))
def test_the_hands_never_stand_still_before_the_grasp(
    operator: ScriptedOperator,
    index: int,
) -> None:
    demo = operator.plan(sample_trial(operator.scene, SEED, "demonstrations", index), seed=SEED)
    speed = np.abs(np.diff(demo.q, axis=0)).max(axis=1) * 50.0
    moving = speed[5 : _tick(operator, "descend") - 5]
    assert moving.min() > 0.03


def test_operators_differ_in_pace_pauses_and_grasp() -> None:
    """Each in its bounds, drawn for each trial; a plain operator's episodes all last as long."""
    config = OperatorConfig(
        speed_spread=0.2,
        pause_s=0.5,
        grasp_spread_m=0.02,
        approach_noise_m=0.0,
        along_noise_m=0.0,
    )
    plain = ScriptedOperator(SceneConfig())
    varied = ScriptedOperator(SceneConfig(), config)
    trials = [sample_trial(plain.scene, SEED, "demonstrations", i) for i in range(20)]
    assert len({plain.phases(plain.style(SEED, trial))["rest"][1] for trial in trials}) == 1
    lengths = [varied.phases(varied.style(SEED, trial))["rest"][1] for trial in trials]
    assert np.ptp(lengths) > 0.3
    styles = [varied.style(SEED, trial) for trial in trials]
    assert all(0.8 <= factor <= 1.2 for style in styles for factor in style.pace.values())
    assert max(pause for style in styles for pause in style.pauses_s.values()) > 0.3
    assert max(abs(shift) for style in styles for shift in style.shifts_m) > 0.01
    demo = varied.plan(trials[0], seed=SEED)
    phases = varied.phases(styles[0])
    q = demo.q[round(phases["lift"][0] * 50.0) - 1]
    left, right = Kinematics().tcp_poses(q)
    apart = 2 * plain.scene.object.grasp_offset_m + styles[0].shifts_m[0] - styles[0].shifts_m[1]
    assert np.linalg.norm(left[:3, 3] - right[:3, 3]) == pytest.approx(apart, abs=1e-5)
    paused = demo.q[round(phases["close"][1] * 50.0) : round(phases["lift"][0] * 50.0)]
    assert len(paused) >= round(50.0 * styles[0].pauses_s["lift"]) - 1
    assert np.ptp(paused, axis=0).max() < 1e-5


def test_a_trial_is_demonstrated_alike_whatever_came_before(operator: ScriptedOperator) -> None:
    trials = [sample_trial(operator.scene, SEED, "demonstrations", i) for i in range(2)]
    first = operator.plan(trials[1], seed=SEED)
    operator.plan(trials[0], seed=SEED)
    np.testing.assert_array_equal(operator.plan(trials[1], seed=SEED).q, first.q)
    other_seed = operator.plan(trials[1], seed=SEED + 1)
    assert np.abs(other_seed.q - first.q).max() > 1e-4, (
        "the error of the approach belongs to the seed"
    )


def test_the_posture_depends_on_the_hands_alone() -> None:
    kinematics = Kinematics()
    left, right = (T.copy() for T in kinematics.tcp_poses(HOME))
    for T in (left, right):
        T[:3, 3] += (0.12, 0.05, -0.25)
    rng = np.random.default_rng(1)
    reference = posture_at(DUAL_PANDA, (left, right), HOME, HOME)
    for _ in range(5):
        start = HOME + rng.uniform(-0.3, 0.3, 14)
        np.testing.assert_allclose(
            posture_at(DUAL_PANDA, (left, right), start, HOME),
            reference,
            atol=1e-4,
        )
    reached = kinematics.tcp_poses(reference)
    np.testing.assert_allclose(reached[0], left, atol=1e-6)
    np.testing.assert_allclose(reached[1], right, atol=1e-6)


def test_no_posture_that_reaches_the_hands_is_closer_to_the_reference() -> None:
    """Optimality: along the null space of each arm, the distance to the posture is stationary."""
    kinematics = Kinematics()
    left, right = (T.copy() for T in kinematics.tcp_poses(HOME))
    left[:3, 3] += (0.15, 0.1, -0.3)
    weights = np.tile([1.0, 2.0, 1.0, 1.0, 3.0, 1.0, 0.5], 2)
    q = posture_at(DUAL_PANDA, (left, right), HOME, HOME, weights)
    for arm, J in enumerate(kinematics.tcp_jacobians(q)):
        part = slice(7 * arm, 7 * arm + 7)
        null = np.linalg.svd(J[:, part])[2][-1]
        assert abs(null @ (weights * (HOME - q))[part]) < 1e-4


def test_a_pose_out_of_reach_is_refused_with_the_hand_and_the_place() -> None:
    kinematics = Kinematics()
    left, right = (T.copy() for T in kinematics.tcp_poses(HOME))
    right[0, 3] += 1.0
    with pytest.raises(UsageError, match=r"the right hand cannot reach position \[1\.3"):
        posture_at(DUAL_PANDA, (left, right), HOME, HOME)
