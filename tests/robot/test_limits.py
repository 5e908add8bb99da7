"""Joint limits where a posture enters: float32 rounding is inside, more is not."""

import numpy as np
import pytest

from minidual.robot.limits import ROUNDING_RAD, clipped, joint_text, outside_limits
from minidual.robot.models import ARM_MODELS
from minidual.robot.pair import Robot


@pytest.fixture(params=list(ARM_MODELS))
def robot(request):
    return Robot(ARM_MODELS[request.param])


@pytest.mark.parametrize("side", ["q_lower", "q_upper"])
def test_limits_read_back_as_float32_are_inside(robot, side):
    limits = getattr(robot, side)
    rounded = limits.astype(np.float32).astype(float)
    assert np.abs(rounded - limits).max() > 0.0
    assert not outside_limits(rounded, robot).any()
    assert clipped(rounded, robot) == pytest.approx(limits, abs=ROUNDING_RAD)
    assert (clipped(rounded, robot) <= robot.q_upper).all()
    assert (clipped(rounded, robot) >= robot.q_lower).all()


@pytest.mark.parametrize("beyond_rad", [2e-6, 0.1, np.inf, np.nan])
@pytest.mark.parametrize("joint", [0, -1])
def test_more_than_rounding_is_outside(robot, joint, beyond_rad):
    above = robot.home.copy()
    above[joint] = robot.q_upper[joint] + beyond_rad
    below = robot.home.copy()
    below[joint] = robot.q_lower[joint] - beyond_rad
    for q in (above, below):
        assert np.flatnonzero(outside_limits(q, robot)).tolist() == [joint % robot.dof]


def test_a_refused_value_reads_differently_from_its_limit(robot):
    for limit in (*robot.q_lower, *robot.q_upper):
        assert joint_text(limit + ROUNDING_RAD) != joint_text(limit)
