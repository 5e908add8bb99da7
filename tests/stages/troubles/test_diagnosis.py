"""One cause is named once, from below, with what follows from it."""

from __future__ import annotations

import pytest

from minidual.stages.registry import STAGES
from minidual.stages.troubles.diagnosis import Fault, as_lines, diagnose, level_of
from minidual.stages.troubles.trouble import Level

UPSTREAM = {name: [other for other in STAGES.until(name) if other != name] for name in STAGES}


def found(title: str, detail: str = "", stage: str = "") -> Fault:
    part, _, name = title.partition(" ")
    return Fault(part, name, detail or title, "mend it", level_of(part, name), stage=stage)


def result(stage: str, state: str = "stale") -> Fault:
    return found(f"results {stage} is {state}", stage=stage)


def causes(*faults: Fault) -> dict[str, list[str]]:
    """Return {cause: what follows from it}, in the order of the diagnosis."""
    diagnosed = diagnose(faults, UPSTREAM)
    return {
        cause.key: [fault.key for fault in diagnosed if fault.follows == cause.title]
        for cause in diagnosed
        if not cause.follows
    }


SWAPPED_WIRES = (
    "env-check joints.mapped",
    "env-check latency.late_steps",
    "env-check joints.reached",
    "env-check tracking.step_error_rad",
    "env-check tracking.sine_rms_rad",
    "env-check control.stopped",
    "env-check joints.rise_max_s",
    "carry success_rate",
    "carry internal_force_min_n",
)


def test_the_many_faults_of_swapped_wires_are_one_cause() -> None:
    found_from_above = [found(name) for name in reversed(SWAPPED_WIRES)]
    ((cause, following),) = causes(*found_from_above).items()
    assert cause == "env-check joints.mapped"
    assert sorted(following) == sorted(SWAPPED_WIRES[1:])
    lines = as_lines(diagnose(found_from_above, UPSTREAM))
    assert lines[1] == "1 cause; 8 more faults follow"
    assert sum("remedy" in line for line in lines) == 1
    assert "  explained by: minidual doctor --explain joint-order" in lines


@pytest.mark.parametrize(
    ("cause", "following"),
    [
        ("env-check libraries.unfit", ("plan error", "carry success_rate", "policy error")),
        ("env-check joints.count", ("plan error", "carry error")),
        ("env-check model.agreement_max", ("env-check joints.mapped", "carry tilt_max_rad")),
        ("env-check contacts.home", ("env-check contacts.sine", "plan left_arm.success_rate")),
        ("env-check joints.reached", ("env-check tracking.sine_rms_rad", "carry success_rate")),
        ("env-check control.step_median_us", ("plan both_arms.replan_median_s",)),
        ("env-check cameras.contrast_min", ("env-check cameras.object_share", "policy error")),
        ("plan engines.agreement", ("plan proof.audit_collisions",)),
        ("plan left_arm.success_rate", ("plan both_arms.success_rate",)),
        ("carry success_rate", ("carry tilt_max_rad", "carry duration_max_s")),
        ("recordings action_equals_qpos", ("policy actions_in_limits",)),
    ],
)
def test_what_follows_is_told_from_its_cause(cause: str, following: tuple[str, ...]) -> None:
    faults = [found(name) for name in (*following, cause)]
    told = causes(*faults)
    assert list(told) == [cause]
    assert sorted(told[cause]) == sorted(following)


def test_faults_that_have_nothing_to_do_with_each_other_are_two_causes() -> None:
    told = causes(
        found("policy targets_n"),
        found("recordings file_corrupt"),
        found("env-check control.step_median_us"),
        found("carry success_rate"),
    )
    assert list(told) == [
        "env-check control.step_median_us",
        "carry success_rate",
        "recordings file_corrupt",
    ]
    assert told["recordings file_corrupt"] == ["policy targets_n"]
    lines = as_lines(diagnose([found("carry error"), found("recordings too_short")], UPSTREAM))
    assert lines[1] == "2 causes, mend the first one first"


def test_the_lowest_level_comes_first() -> None:
    levels = [
        found(name).level
        for name in (
            "env-check libraries.unfit",
            "env-check joints.count",
            "env-check tracking.sine_rms_rad",
            "carry success_rate",
            "recordings file_corrupt",
            "policy targets_n",
        )
    ]
    assert levels == sorted(set(Level) - {Level.TELEOPERATION})
    assert level_of("carry", "error", environment=True) == Level.INSTALLATION


def test_one_error_that_ends_several_parts_is_one_cause() -> None:
    told = causes(*(found(f"{part} error", "no OpenGL") for part in ("env-check", "plan", "carry")))
    assert told == {"env-check error": ["plan error", "carry error"]}
    assert len(causes(found("plan error", "no OpenGL"), found("carry error", "no disk"))) == 2


def test_results_follow_from_the_stages_below_them() -> None:
    told = causes(result("env-check"), result("plan"), result("carry"), result("report"))
    assert list(told) == ["results env-check is stale"]
    assert list(causes(result("plan"), found("env-check tracking.sine_rms_rad"))) == [
        "env-check tracking.sine_rms_rad",
    ]
    assert list(causes(result("teleop-record", "fail"), found("recordings out_of_sync"))) == [
        "recordings out_of_sync",
    ]
    assert list(causes(result("train-act", "fail"), found("policy targets_n"))) == [
        "policy targets_n",
    ]
    assert len(causes(result("plan"), found("carry success_rate"))) == 2
    assert len(causes(result("plan"), result("carry", "error"))) == 2, "no result makes that error"


def test_a_fault_of_many_episodes_is_named_once() -> None:
    faults = [found("recordings out_of_sync", f"episode_{k}.hdf5: 30 ms") for k in range(6)]
    (fault,) = diagnose(faults, UPSTREAM)
    assert fault.count == 6
    assert fault.detail == (
        "episode_0.hdf5: 30 ms; the same in episode_1.hdf5, episode_2.hdf5, episode_3.hdf5, "
        "and 2 more"
    )
    assert fault.trouble == "out-of-sync"


@pytest.mark.parametrize(
    ("title", "trouble"),
    [
        ("env-check joints.count", "no-actuators"),
        ("env-check libraries.unfit", ""),
        ("plan left_arm.success_rate", ""),
        ("plan both_arms.replan_max_s", "both-arms-timeout"),
        ("carry internal_force_min_n", "penetration"),
        ("recordings not_finite", "explosion"),
        ("policy actions_in_limits", "beyond-limits"),
        ("carry error", ""),
    ],
)
def test_a_fault_leads_to_the_row_that_it_means(title: str, trouble: str) -> None:
    assert found(title).trouble == trouble


def test_without_faults_it_says_so() -> None:
    assert as_lines([]) == ["", "no known fault found"]
