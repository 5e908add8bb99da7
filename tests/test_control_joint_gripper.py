"""Grippers ramp, remember, and press as hard as asked."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.control.gripper import CLOSE_BELOW, OPEN_ABOVE, Grippers
from minidual.robot.arms import DUAL_PANDA
from minidual.robot.constants import FINGER_TRAVEL_M

DT = 0.001


@pytest.fixture
def grippers(scene):
    return Grippers(scene, DUAL_PANDA, DT, pinch_force_n=50.0, speed_m_per_s=0.08)


def settle(grippers, command, steps=1000):
    return [grippers.step(np.array(command)).copy() for _ in range(steps)]


def test_targets_ramp_and_never_jump(grippers):
    targets = np.array(settle(grippers, [0.0, 1.0]) + settle(grippers, [1.0, 0.0]))
    assert np.abs(np.diff(targets, axis=0)).max() <= 0.08 * DT + 1e-12


def test_the_closed_target_lies_inside_the_rod_by_the_pinch(grippers, scene):
    closed = settle(grippers, [0.0, 0.0])[-1]
    stiffness = scene.physics.finger_kp_n_per_m
    assert stiffness * (scene.rod.radius_m - closed) == pytest.approx([50.0, 50.0])


def test_the_pinch_is_limited_to_what_the_fingers_can(scene):
    closed = settle(Grippers(scene, DUAL_PANDA, DT, pinch_force_n=500.0), [0.0, 0.0])[-1]
    pressed = scene.physics.finger_kp_n_per_m * (scene.rod.radius_m - closed)
    assert pressed == pytest.approx(scene.physics.finger_force_max_n)


def test_hands_are_independent(grippers, scene):
    left, right = settle(grippers, [0.0, 1.0])[-1]
    assert left < scene.rod.radius_m
    assert right == FINGER_TRAVEL_M


def test_a_wavering_command_does_not_flutter(grippers):
    settle(grippers, [0.0, 0.0])
    middle = 0.5 * (CLOSE_BELOW + OPEN_ABOVE)
    for value in (middle, CLOSE_BELOW + 0.01, OPEN_ABOVE - 0.01, CLOSE_BELOW, OPEN_ABOVE):
        grippers.step(np.array([value, value]))
        assert grippers.is_open.tolist() == [0.0, 0.0]
    grippers.step(np.array([OPEN_ABOVE + 0.01, middle]))
    assert grippers.is_open.tolist() == [1.0, 0.0]
    grippers.step(np.array([middle, middle]))
    assert grippers.is_open.tolist() == [1.0, 0.0]


def test_a_reset_opens_at_once(grippers):
    settle(grippers, [0.0, 0.0])
    grippers.reset()
    assert grippers.targets_m.tolist() == [FINGER_TRAVEL_M] * 2
    assert grippers.is_open.tolist() == [1.0, 1.0]
