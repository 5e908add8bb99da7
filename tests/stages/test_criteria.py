"""Each stage declares why it checks something, and what to do where a limit does not hold."""

from types import ModuleType

from minidual.gate.criterion import Criterion
from minidual.stages import (
    benchmark,
    carry,
    deploy_checks,
    plan_criteria,
    teleop_record,
    train_act,
)
from minidual.stages.env_check import criteria as env_check_criteria

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
        "timing.own_to_toppra",
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
