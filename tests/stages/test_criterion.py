"""Criteria: what a check says, and that each stage declares why and what to do."""

from types import ModuleType

import pytest

from minidual.stages import (
    benchmark,
    carry,
    deploy_checks,
    plan_criteria,
    teleop_record,
    train_act,
)
from minidual.stages.criterion import Criterion
from minidual.stages.env_check import criteria as env_check_criteria

SPEED = Criterion(
    "speed_max",
    "<",
    unit="m/s",
    why="{who} would fall",
    remedy="slow {who} down",
)


def test_a_check_fills_in_the_words_and_compares() -> None:
    check = SPEED.check(2.0, 1.5, prefix="left.", who="the rod")
    assert check.sentence() == "left.speed_max is 2 m/s, limit < 1.5 m/s"
    assert (check.why, check.remedy) == ("the rod would fall", "slow the rod down")
    assert check.passed is False
    assert SPEED.check(1.0, 1.5, who="the rod").passed is True


def test_a_value_without_a_limit_is_only_reported() -> None:
    for check in (SPEED.report(2.0, who="the rod"), SPEED.check(2.0, None, who="the rod")):
        assert (check.op, check.limit, check.passed) == (None, None, None)


def test_a_word_that_is_not_given_and_a_limit_without_a_comparison_are_errors() -> None:
    with pytest.raises(KeyError, match="who"):
        SPEED.check(2.0, 1.5)
    with pytest.raises(ValueError, match="without an operator"):
        Criterion("speed", why="reported").check(2.0, 1.5)


MODULES = {
    "env-check": env_check_criteria,
    "plan": plan_criteria,
    "carry": carry,
    "teleop-record": teleop_record,
    "train-act": train_act,
    "deploy": deploy_checks,
    "benchmark": benchmark,
}


def criteria_of(module: ModuleType) -> list[Criterion]:
    """Return the criteria that a module declares, alone or in a tuple."""
    values = list(vars(module).values())
    values += [item for value in values if isinstance(value, tuple) for item in value]
    return [value for value in values if isinstance(value, Criterion)]


REPORTED = {
    "env-check": ["latency.wall_median_us"],
    "plan": [
        "first_plan_median_s",
        "replan_p99_s",
        "core_share",
        "line_blocked_rate",
        "closed_chain.time_median_s",
    ],
    "carry": [
        "success_low",
        "goal_error_max_m",
        "pinch_force_min_n",
        "duration_median_s",
        "jerk_rms_median",
    ],
    "teleop-record": ["success_rate", "attempts", "latency_p50_s", "recorded_per_min"],
    "train-act": [
        "train_s",
        "samples_per_s",
        "parameters",
        "overshoot_max_rad",
        "inference_hz",
        "validation_l1",
    ],
    "deploy": [
        "success_low",
        "success_high",
        "goal_error_median_m",
        "looks_at_object",
        "worst_seed",
        "median_seed",
    ],
    "benchmark": [
        "duration_median_s",
        "torque_ratio_max",
        "jerk_rms_median",
        "tilt_max_rad",
        "path_length_m",
    ],
}
REPORTED["plan"].append("closed_chain.draws_left_out_n")
REPORTED["train-act"].append("validation_keyframe_rad")


def test_every_check_says_why_and_each_that_has_a_limit_what_to_do() -> None:
    """`REPORTED` names those that have no limit."""
    reported: dict[str, list[str]] = {}
    for stage, module in MODULES.items():
        criteria = criteria_of(module)
        assert criteria
        assert all(criterion.why for criterion in criteria)
        assert all(bool(criterion.remedy) == bool(criterion.op) for criterion in criteria)
        reported[stage] = sorted(c.name for c in criteria if not c.op)
    assert reported == {stage: sorted(names) for stage, names in REPORTED.items()}
