"""What the table of checks says about each check."""

from __future__ import annotations

from minidual.registry import rows_beside
from minidual.stages import words

REPORTED = {
    "plan": ["first_plan_median_s", "core_share", "line_blocked_rate", "closed_chain.time_median_s"],
    "carry": ["success_low", "goal_error_max_m", "pinch_force_min_n", "duration_median_s", "jerk_rms_median"],
    "teleop-record": ["success_rate", "attempts", "latency_p50_s", "recorded_per_min"],
    "train-act": ["samples_per_s", "parameters", "overshoot_max_rad", "inference_hz", "validation_l1"],
    "deploy": ["success_low", "success_high", "goal_error_median_m", "looks_at_object"],
    "deploy-set": ["worst_seed", "median_seed"],
    "benchmark": ["duration_median_s", "torque_ratio_max", "jerk_rms_median", "tilt_max_rad", "path_length_m"],
}
REPORTED["plan"].append("closed_chain.draws_left_out_n")
REPORTED["train-act"].append("validation_keyframe_rad")


def test_every_check_says_why_and_each_that_has_a_limit_what_to_do() -> None:
    """Those named here have none: they are reported."""
    rows = rows_beside(words.__file__, "checks.yaml")
    silent = {stage: [name for name, row in checks.items() if "remedy" not in row] for stage, checks in rows.items()}
    assert all(row["why"] for checks in rows.values() for row in checks.values())
    assert {k: sorted(v) for k, v in silent.items() if v} == {k: sorted(v) for k, v in REPORTED.items()}
