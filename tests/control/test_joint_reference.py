"""The reference filter: bounded, converging, without overshoot, and linear near its target."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from minidual.control.joint_control import ReferenceFilter
from minidual.robot.pair import DUAL_PANDA
from tests.support.panda import A_MAX, DOF, HOME, Q_LOWER, Q_UPPER, V_MAX

DT = 0.001


def play(targets, start=HOME, **options):
    """Return q, v, a, each (T, 14), for targets (T, 14)."""
    reference = ReferenceFilter(DT, DUAL_PANDA, **options)
    reference.reset(start)
    return tuple(
        np.array(x) for x in zip(*(reference.step(target) for target in targets), strict=True)
    )


@given(seed=st.integers(0, 10_000), hold=st.sampled_from([1, 5, 20, 100]))
@settings(max_examples=15)
def test_whatever_is_asked_position_velocity_and_acceleration_stay_bounded(seed, hold):
    rng = np.random.default_rng(seed)
    targets = np.repeat(rng.uniform(2 * Q_LOWER, 2 * Q_UPPER, (400 // hold, DOF)), hold, axis=0)
    q, v, a = play(targets)
    assert (np.abs(v) <= V_MAX).all()
    assert (np.abs(a) <= 0.8 * A_MAX + 1e-9).all()
    assert np.abs(np.diff(q, axis=0)).max() <= V_MAX.max() * DT + 1e-12


@pytest.mark.parametrize("step", [0.02, 0.1, 0.3, 1.0, -0.5])
def test_a_jump_is_reached_without_overshoot(step):
    start = 0.5 * (Q_LOWER + Q_UPPER)
    q, _, _ = play(np.tile(start + step, (2500, 1)), start=start)
    assert np.abs(q[-1] - start - step).max() < 1e-6
    assert (np.sign(step) * (q - start - step)).max() < 1e-9


def test_a_jump_to_the_limits_does_not_cross_them():
    for limit in (Q_LOWER, Q_UPPER):
        q, _, _ = play(np.tile(3.0 * limit, (4000, 1)))
        assert (q <= Q_UPPER + 1e-9).all()
        assert (q >= Q_LOWER - 1e-9).all()
        assert q[-1] == pytest.approx(np.clip(3.0 * limit, Q_LOWER, Q_UPPER), abs=1e-4)


def test_near_the_target_it_is_the_critically_damped_filter_after_a_ramp():
    step = 0.005
    q, _, _ = play(np.tile(HOME + step, (400, 1)), bandwidth_rad_s=30.0)
    t = DT * np.arange(1, 401)[:, None] - DT * np.arange(20)
    parts = np.where(t > 0, 1 - (1 + 30.0 * t) * np.exp(-30.0 * t), 0.0)
    assert np.abs(q - HOME - step * parts.mean(axis=1)[:, None]).max() < 0.02 * step


def test_a_target_at_50_hz_does_not_step():
    ramp = 0.5 * DT * np.arange(20, 2001, 20)
    _, _, a = play(np.repeat(HOME + ramp[:, None] * np.ones(DOF), 20, axis=0))
    assert (
        np.abs(np.diff(a[500:], axis=0)).max() < 1e-3
    )  # [rad/s^2] in a millisecond; without the ramp 9


def test_a_moving_target_is_followed_with_a_lag_of_two_over_w_and_the_ramp():
    ramp = 0.1 * DT * np.arange(20, 3001, 20)
    q, _, _ = play(np.repeat(HOME + ramp[:, None] * np.ones(DOF), 20, axis=0), bandwidth_rad_s=30.0)
    assert HOME + ramp[-1] - q[-1] == pytest.approx(
        np.full(DOF, 0.1 * 2 / 30.0),
        rel=0.03,
    )  # at the ramp's end


def test_q_v_and_a_are_derivatives_of_each_other():
    rng = np.random.default_rng(2)
    q, v, a = play(np.repeat(HOME + 0.3 * rng.normal(size=(10, DOF)), 50, axis=0))
    assert np.diff(q, axis=0) / DT == pytest.approx(v[1:], abs=1e-9)
    assert np.diff(v, axis=0) / DT == pytest.approx(a[1:], abs=1e-7)


def test_a_reset_keeps_a_given_velocity():
    reference = ReferenceFilter(DT, DUAL_PANDA)
    reference.reset(HOME, np.full(DOF, 0.3))
    q, v, _ = reference.step(HOME)
    assert (q > HOME).all()
    assert v == pytest.approx(np.full(DOF, 0.3), abs=0.025)
