"""docs/libfranka-errors.md names each flag; the lines of docs/supervisor.md count false stops."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from minidual.durable import write_csv
from tests.support.howto import blocks

PAGE = Path(__file__).resolve().parents[2] / "docs" / "libfranka-errors.md"
_FLAGS = """
joint_position_limits_violation cartesian_position_limits_violation self_collision_avoidance_violation
joint_velocity_violation cartesian_velocity_violation force_control_safety_violation joint_reflex cartesian_reflex
max_goal_pose_deviation_violation max_path_pose_deviation_violation cartesian_velocity_profile_safety_violation
joint_position_motion_generator_start_pose_invalid joint_motion_generator_position_limits_violation
joint_motion_generator_velocity_limits_violation joint_motion_generator_velocity_discontinuity
joint_motion_generator_acceleration_discontinuity cartesian_position_motion_generator_start_pose_invalid
cartesian_motion_generator_elbow_limit_violation cartesian_motion_generator_velocity_limits_violation
cartesian_motion_generator_velocity_discontinuity cartesian_motion_generator_acceleration_discontinuity
cartesian_motion_generator_elbow_sign_inconsistent cartesian_motion_generator_start_elbow_invalid
cartesian_motion_generator_joint_position_limits_violation cartesian_motion_generator_joint_velocity_limits_violation
cartesian_motion_generator_joint_velocity_discontinuity cartesian_motion_generator_joint_acceleration_discontinuity
cartesian_position_motion_generator_invalid_frame force_controller_desired_force_tolerance_violation
controller_torque_discontinuity start_elbow_sign_inconsistent communication_constraints_violation power_limit_violation
joint_p2p_insufficient_torque_for_planning tau_j_range_violation instability_detected joint_move_in_wrong_direction
cartesian_spline_motion_generator_violation joint_via_motion_generator_planning_joint_limit_violation
base_acceleration_initialization_timeout base_acceleration_invalid_reading
"""
FLAGS = _FLAGS.split()
"""The flags of `franka::Errors` (libfranka, include/franka/errors.h)."""


def listed(page: str) -> list[str]:
    """Return the flags in the first column of the table, in order."""
    table = page.partition("\n| flag of libfranka")[2].partition("\n\n")[0]
    cells = re.findall(r"^\| ([a-z_0-9, ]+) \| [^|]+ \|[^|]*\|$", table, re.MULTILINE)
    return [flag for cell in cells for flag in cell.split(", ")]


def test_the_page_names_each_flag_of_libfranka_once_and_nothing_else() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert len(FLAGS) == len(set(FLAGS)) == 41
    assert "`franka::Errors` has 41 flags" in page
    assert sorted(set(listed(page))) == sorted(FLAGS)
    assert len([flag for flag in listed(page) if flag in FLAGS]) == 41


def test_a_flag_that_is_missing_or_named_twice_is_seen() -> None:
    head = "## Against libfranka's errors\n\n| flag of libfranka | here | why |\n|---|---|---|\n"
    row = "| joint_reflex, cartesian_reflex | no | |\n"
    table = listed(head + row + row + "\n## next\n| joint_reflex | no | |\n")
    assert table == ["joint_reflex", "cartesian_reflex"] * 2


STOPPED = (
    "reflex at 3.10 s: reflex joint_contact at 3.100 s: an arm touches something: left_panda_joint2"
)


def test_the_lines_of_the_page_count_the_stops_of_a_run(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    carry = {"method": "impedance", "condition": "clean"}
    for table, rows in {
        "carry/trials.csv": [{**carry, "aborted": ""}, {**carry, "aborted": STOPPED}],
        "teleop-record/quality.csv": [
            *(
                {"trial": 0, "reason": ""},
                {"trial": 1, "reason": "reflex torque_rate at 2.000 s: a controller"},
            ),
            {"trial": 2, "reason": "RMS jerk 900 rad/s^3, limit 800"},
        ],
        "deploy/trials.csv": [
            {
                "method": "act",
                "condition": "held_out",
                "aborted": "oscillation: the target of joint 1",
            },
            {"method": "act", "condition": "training", "aborted": ""},
            {"method": "act", "condition": "object hidden", "aborted": "frozen_picture: camera"},
        ],
        "benchmark/benchmark.csv": [
            {"task": "handover", **carry, "aborted": "slip at 2.00 s: 3 mm"},
            {"task": "handover", **carry, "condition": "heavy", "aborted": "slip at 2.00 s: 3 mm"},
        ],
    }.items():
        path = tmp_path / "runs" / "standard" / table
        path.parent.mkdir(parents=True)
        write_csv(path, rows)
    (lines,) = [block for block in blocks("supervisor.md") if "def stops" in block]
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(compile(lines, "supervisor.md", "exec"), names)
    said = capsys.readouterr().out
    assert names["stops"](Path("runs/standard")) == {
        "carry/trials.csv impedance clean": (1, 2),
        "teleop-record/quality.csv": (1, 3),
        "deploy/trials.csv act held_out": (1, 1),
        "deploy/trials.csv act training": (0, 1),
        "benchmark/benchmark.csv handover impedance clean": (1, 1),
    }
    for why in (
        "'reflex joint_contact': 1",
        "'reflex torque_rate': 1",
        "'oscillation': 1",
        "'slip': 1",
    ):
        assert why in said
