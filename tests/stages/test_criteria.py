"""Each stage declares why it checks something, and what to do where a limit does not hold."""

from tests.support.stage_criteria import MODULES, criteria_of

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
    "teleop-record": [
        "success_rate",
        "attempts",
        "lag_p99_s",
        "latency_p50_s",
        "recorded_per_min",
    ],
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
        "inference_wall_hz",
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
CLOCKED = {
    "env-check": ["control.step_median_us", "latency.wall_median_us"],
    "plan": [
        "first_plan_median_s",
        "replan_median_s",
        "replan_p99_s",
        "replan_max_s",
        "core_share",
        "closed_chain.cpu_time_median_s",
        "closed_chain.time_median_s",
    ],
    "carry": [],
    "teleop-record": ["latency_p50_s", "latency_p99_s", "episodes_per_min", "recorded_per_min"],
    "train-act": ["train_s", "samples_per_s", "inference_hz"],
    "deploy": ["inference_hz", "inference_wall_hz"],
    "benchmark": [],
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


def test_only_values_of_a_clock_may_differ_when_a_stage_finds_the_same_again() -> None:
    """Seconds of the simulation are no times of a clock: a longer carry is another result."""
    clocked = {
        stage: sorted(c.name for c in criteria_of(module) if c.clocked)
        for stage, module in MODULES.items()
    }
    assert clocked == {stage: sorted(names) for stage, names in CLOCKED.items()}


def test_a_criterion_hands_on_that_a_clock_measures_it() -> None:
    timed, counted = (
        next(c for c in criteria_of(MODULES["train-act"]) if c.name == name)
        for name in ("train_s", "parameters")
    )
    assert timed.report(1.0).clocked
    assert not counted.report(1).clocked
