"""Velocity fed forward: the reference follows a leader within little more than a period."""

from __future__ import annotations

import numpy as np

from minidual.control.target_lead import AnticipatingFilter
from minidual.robot.pair import DUAL_PANDA, Array
from tests.support.panda import A_MAX, DOF, HOME, Q_UPPER, V_MAX

DT = 0.001


def follow(targets: Array, every: int, *, feeds: bool = True) -> Array:
    """Return the reference (T, n) behind targets (T, n) that are read every so many steps."""
    reference = AnticipatingFilter(DT, every * DT, DUAL_PANDA)
    reference.reset(targets[0])
    reference.feeds = feeds
    q: list[Array] = []
    target = targets[0]
    for k, newest in enumerate(targets):
        if k % every == 0:
            target = newest
        q.append(reference.step(target)[0])
    return np.array(q)


def swaying(steps_n: int = 3000) -> Array:
    """Return targets (T, n) of a smooth motion from rest."""
    times_s = DT * np.arange(steps_n)
    sway = 0.1 * (1.0 - np.cos(2.0 * np.pi * 0.5 * times_s))
    return HOME + sway[:, None] * np.ones(DOF)


def lag_s(q: Array, targets: Array) -> float:
    """Return by how much a motion lags, where it is fastest."""
    k = 500
    later = np.argmin(np.abs(q[k : k + 200, 0] - targets[k, 0]))
    return float(DT * later)


def test_the_reference_lags_a_100_hz_leader_by_its_period() -> None:
    targets = swaying()
    assert lag_s(follow(targets, 10), targets) < 0.02
    assert lag_s(follow(targets, 10, feeds=False), targets) > 0.03


def test_a_stopped_leader_is_reached_and_hardly_passed() -> None:
    ramp = np.minimum(np.arange(3000) * DT, 0.8) * 0.3
    targets = HOME + ramp[:, None] * np.ones(DOF)
    q = follow(targets, 10)
    assert np.abs(q[-1] - targets[-1]).max() < 1e-5
    at_most_rad = 1.1 * 0.3**2 / (2.0 * 0.8 * A_MAX)
    assert ((q - targets[-1]).max(axis=0) < np.maximum(at_most_rad, 0.006)).all()


def test_a_jump_is_no_faster_than_the_joints_may_be() -> None:
    targets = np.tile(HOME, (2000, 1))
    targets[500:, 0] += 0.5
    q = follow(targets, 10)
    assert np.abs(np.diff(q, axis=0)).max() <= V_MAX.max() * DT + 1e-12
    assert abs(q[-1, 0] - targets[-1, 0]) < 1e-3


def test_a_fast_motion_lags_no_more_than_a_slow_one() -> None:
    """The curve along which a reference brakes for a target that rests must not hold it back."""
    targets = HOME + 7.0 * (swaying() - HOME)
    q = follow(targets, 10)
    assert np.abs(np.diff(targets, axis=0)).max() / DT > 1.5
    assert lag_s(q, targets) < 0.02


def test_a_limit_is_not_passed_for_a_leader_that_stops_at_it() -> None:
    start = Q_UPPER - 0.3
    ramp = np.minimum(np.arange(1500) * DT, 0.3)
    targets = start + ramp[:, None] * np.ones(DOF)
    q = follow(targets, 10)
    assert (q - Q_UPPER).max() < 1e-3


def test_one_arm_begins_anew_without_the_other() -> None:
    reference = AnticipatingFilter(DT, 0.01, DUAL_PANDA)
    reference.reset(HOME)
    reference.feeds = True
    for _ in range(5):
        reference.step(HOME + 0.01)
    reference.reset(HOME, joints=slice(0, 7))
    q, v, _ = reference.step(np.where(np.arange(DOF) < 7, HOME, HOME + 0.01))
    assert np.array_equal(q[:7], HOME[:7])
    assert (v[7:] > 0.0).all()
