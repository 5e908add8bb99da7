"""scripts/false_stops.py counts the stops of clean trials in the tables of a run."""

from __future__ import annotations

from pathlib import Path

import pytest

from minidual.durable import write_csv
from scripts.false_stops import stops

STOPPED = (
    "reflex at 3.10 s: reflex contact.joint at 3.100 s: an arm touches something: left_panda_joint2"
)
CARRY = {"method": "impedance", "condition": "clean"}
TABLES = {
    "carry/trials.csv": [{**CARRY, "aborted": ""}, {**CARRY, "aborted": STOPPED}],
    "teleop-record/quality.csv": [
        {"trial": 0, "reason": ""},
        {"trial": 1, "reason": "reflex torque.rate at 2.000 s: a controller"},
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
        {"task": "handover", **CARRY, "aborted": "slip at 2.00 s: 3 mm"},
        {"task": "handover", **CARRY, "condition": "heavy", "aborted": "slip at 2.00 s: 3 mm"},
    ],
}


def test_stops_of_clean_trials_are_counted_and_named(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for table, rows in TABLES.items():
        path = tmp_path / table
        path.parent.mkdir(parents=True)
        write_csv(path, rows)
    assert stops(tmp_path) == {
        "carry/trials.csv impedance clean": (1, 2),
        "teleop-record/quality.csv": (1, 3),
        "deploy/trials.csv act held_out": (1, 1),
        "deploy/trials.csv act training": (0, 1),
        "benchmark/benchmark.csv handover impedance clean": (1, 1),
    }
    printed = capsys.readouterr().out
    for name in ("reflex contact.joint", "reflex torque.rate", "oscillation", "slip"):
        assert f"'{name}': 1" in printed


def test_a_run_without_tables_has_no_trials(tmp_path: Path) -> None:
    assert stops(tmp_path) == {}
