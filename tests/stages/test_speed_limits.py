"""The limits that depend on how fast or busy the machine is: baselines that a slow machine meets.

Every other wall time and rate is reported without a limit: `replan_p99_s`, `train_s`,
`latency.wall_median_us` and others.
"""

import pytest

from minidual.config.loader import load_config
from minidual.stages.env_check.checks import REAL_TIME_US


@pytest.mark.parametrize("profile", ["smoke", "standard", "gpu"])
def test_limits_on_wall_time_are_the_baselines_in_every_profile(profile: str) -> None:
    config = load_config(profile).config
    plan = config.plan
    assert plan.time_max_s == 10.0
    assert plan.time_median_max_s.model_dump() == {
        "left_arm": 0.2,
        "right_arm": 0.2,
        "both_arms": 2.0,
    }
    assert plan.held.cpu_time_median_max_s == 2.0
    assert config.teleop.latency_max_s == 0.1
    assert config.teleop.episodes_per_min == (None if profile == "smoke" else 3.0)
    assert config.train.time_limit_s == 24 * 3600.0
    assert config.deploy.inference_hz_min == 30.0


def test_a_control_step_has_the_time_that_1_khz_leaves() -> None:
    assert REAL_TIME_US == 1000.0
