"""Estimates of an object at rest and in both hands, from noisy and late samples."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import pose, rot_x
from minidual.skills.object_estimate import HeldEstimate, RestingEstimate
from tests.support.panda import HOME
from tests.support.sensed_bench import SensedBench, sensors


def test_the_mean_of_a_resting_object_falls_with_the_root_of_the_samples() -> None:
    bench = SensedBench()
    errors = []
    turns = []
    for trial in range(40):
        senses = sensors(bench, trial, pose_rate_hz=1000.0, delay_s=0.0)
        first = senses.sense().pose
        assert first is not None
        estimate = RestingEstimate(first.T_world_object)
        for _ in range(99):
            sample = senses.sense().pose
            assert sample is not None
            estimate.add(sample.T_world_object)
        errors.append(estimate.T_world_object[:3, 3] - bench.T[:3, 3])
        turns.append(pin.log3(estimate.T_world_object[:3, :3] @ bench.T[:3, :3].T))
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(0.0005 / 10, rel=0.25)
    assert np.sqrt(np.mean(np.square(turns))) == pytest.approx(np.radians(0.3) / 10, rel=0.25)


def test_a_mean_that_forgets_follows_an_object_that_closing_hands_shift() -> None:
    before = pose(np.eye(3), (0.5, 0.0, 0.1))
    after = pose(rot_x(0.1), (0.5, 0.003, 0.1))
    steady = RestingEstimate(before)
    forgets = RestingEstimate(before)
    for T, n in ((before, 100), (after, 20)):
        for _ in range(n):
            steady.add(T)
            forgets.add(T, 0.2)
    assert np.linalg.norm(steady.T_world_object[:3, 3] - after[:3, 3]) > 0.002
    assert np.linalg.norm(forgets.T_world_object[:3, 3] - after[:3, 3]) < 0.0001
    assert np.linalg.norm(pin.log3(forgets.T_world_object[:3, :3].T @ after[:3, :3])) < 0.002


def _held_pose(kinematics: Kinematics, q: np.ndarray) -> np.ndarray:
    """An object carried by both hands: midway between them, along the line that joins them."""
    left, right = kinematics.tcp_poses(q)
    y = left[:3, 3] - right[:3, 3]
    y /= np.linalg.norm(y)
    x = left[:3, 1] + right[:3, 1]
    x -= (x @ y) * y
    x /= np.linalg.norm(x)
    frame = pose(np.column_stack([x, y, np.cross(x, y)]), 0.5 * (left[:3, 3] + right[:3, 3]))
    return frame @ pose(rot_x(0.4), (0.002, 0.01, -0.004))


def test_the_twist_of_the_estimate_is_that_of_an_object_held_by_both_hands(
    kinematics: Kinematics,
) -> None:
    rng = np.random.default_rng(2)
    q = HOME + 0.1 * rng.standard_normal(14)
    T = _held_pose(kinematics, q)
    twist = 0.3 * rng.standard_normal(6)
    hands = [
        np.r_[twist[:3] + np.cross(twist[3:], hand[:3, 3] - T[:3, 3]), twist[3:]]
        for hand in kinematics.tcp_poses(q)
    ]
    v = np.linalg.pinv(np.vstack(kinematics.tcp_jacobians(q))) @ np.concatenate(hands)
    estimate = HeldEstimate(kinematics, q, T, delay_ticks=0, least_gain=0.1)
    assert np.allclose(estimate.update(q, v, None).twist, twist, atol=1e-9)
    h = 1e-6
    after = estimate.update(q + h * v, v, None).T_world_object.copy()
    before = estimate.update(q - h * v, v, None).T_world_object.copy()
    assert np.allclose((after[:3, 3] - before[:3, 3]) / (2 * h), twist[:3], atol=1e-6)
    assert np.allclose(pin.log3(after[:3, :3] @ before[:3, :3].T) / (2 * h), twist[3:], atol=1e-6)


def test_the_estimate_follows_the_hands_at_once_and_an_old_sample_does_not_pull_it_back(
    kinematics: Kinematics,
) -> None:
    delay = 10
    direction = np.r_[0.3 * np.ones(7), -0.2 * np.ones(7)]
    T_start = _held_pose(kinematics, HOME)
    estimate = HeldEstimate(kinematics, HOME, T_start, delay_ticks=delay, least_gain=0.2)
    truth: list[np.ndarray] = []
    for k in range(200):
        q = HOME + 0.001 * k * direction
        truth.append(_held_pose(kinematics, q))
        sample = truth[k - delay] if k >= delay and k % 10 == 0 else None
        state = estimate.update(q, direction, sample, delay)
        assert np.allclose(state.T_world_object, truth[k], atol=1e-9)
    assert (
        np.linalg.norm(truth[-1][:3, 3] - truth[-1 - delay][:3, 3]) > 0.0005
    )  # the raw sample was that far behind


def test_a_slip_in_the_hands_shows_in_the_innovation_and_is_learnt(kinematics: Kinematics) -> None:
    T = _held_pose(kinematics, HOME)
    estimate = HeldEstimate(kinematics, HOME, T, delay_ticks=0, least_gain=0.1)
    slipped = T.copy()
    slipped[2, 3] -= 0.01
    for _ in range(60):
        estimate.update(HOME, np.zeros(14), T)
    estimate.update(HOME, np.zeros(14), slipped)
    assert estimate.innovation[0] == pytest.approx(0.01)
    for _ in range(80):
        estimate.update(HOME, np.zeros(14), slipped)
    assert np.allclose(estimate.state.T_world_object, slipped, atol=1e-5)


@pytest.mark.parametrize("turned", [False, True])
def test_one_frame_that_is_far_off_moves_no_estimate_and_two_do(
    kinematics: Kinematics,
    turned: bool,
) -> None:
    """A marker that is taken for another one does not move the estimate, nor look like slip."""
    T = _held_pose(kinematics, HOME)
    estimate = HeldEstimate(kinematics, HOME, T, delay_ticks=0, least_gain=0.1)
    odd = T @ (pose(rot_x(np.pi), (0.0, 0.0, 0.0)) if turned else pose(np.eye(3), (0.3, 0.0, 0.0)))
    for _ in range(3):
        estimate.update(HOME, np.zeros(14), odd)
        assert max(estimate.innovation) > 0.2, "the faults see it all the same"
        assert np.allclose(estimate.state.T_world_object, T, atol=1e-9)
        estimate.update(HOME, np.zeros(14), T)
        assert max(estimate.innovation) < 1e-6
    estimate.update(HOME, np.zeros(14), odd)
    estimate.update(HOME, np.zeros(14), odd)
    assert not np.allclose(estimate.state.T_world_object, T, atol=1e-3)
