"""Joints that turn more than once take the short way to a pose."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.motion.ik import ArmIK
from minidual.robot.models import ARM_MODELS
from minidual.robot.pair import Robot

TURN_RAD = 2.0 * np.pi


@pytest.mark.parametrize("name", ["ur5", "xarm7"])
def test_no_solution_lies_nearer_to_the_start_by_whole_turns(name: str) -> None:
    ik = ArmIK("left", Robot(ARM_MODELS[name]))
    rng = np.random.default_rng(3)
    near = np.array(ARM_MODELS[name].home)
    turned_n = 0
    for _ in range(12):
        T_world_tcp = ik.tcp_pose(rng.uniform(ik.lower, ik.upper))
        for q in ik.solutions(T_world_tcp, near, rng, 6):
            assert np.abs(ik.tcp_pose(q) - T_world_tcp).max() < 1e-5
            for turn in (-TURN_RAD, TURN_RAD):
                other = q + turn
                inside = (other >= ik.lower) & (other <= ik.upper)
                nearer = np.abs(other - near) < np.abs(q - near) - 1e-9
                assert not (inside & nearer).any()
            turned_n += 1
    assert turned_n >= 12


def test_a_joint_turns_back_by_as_many_turns_as_its_limits_allow() -> None:
    ik = ArmIK("left", Robot(ARM_MODELS["ur5"]))
    near = np.zeros(6)
    q = np.array([6.0, -6.0, 3.0, 0.5, 3.5, -3.5])
    expected = [6.0 - TURN_RAD, TURN_RAD - 6.0, 3.0, 0.5, 3.5 - TURN_RAD, TURN_RAD - 3.5]
    assert ik.unwound(q, near) == pytest.approx(expected)
    assert ik.unwound(q, q) == pytest.approx(q)
    far = np.full(6, 20.0)
    assert (ik.unwound(q, far) <= ik.upper + 1e-9).all()


def test_joints_of_less_than_a_turn_stay_to_the_bit() -> None:
    ik = ArmIK("left", Robot(ARM_MODELS["panda"]))
    rng = np.random.default_rng(1)
    for _ in range(20):
        q, near = rng.uniform(ik.lower, ik.upper, (2, 7))
        assert np.array_equal(ik.unwound(q, near), q)
