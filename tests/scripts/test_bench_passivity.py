"""The bench of passivity: its judge can say no, and its rows are those of the experiment."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from minidual.config.root import Config
from minidual.robot.pair import Array
from scripts.bench import passivity, wall_experiment
from scripts.bench.joint_wall import WALL_M, Course
from scripts.bench.tables import BenchInputs

PERIOD_S = 0.005


def course(leader: Array, contact: Array | None = None) -> Course:
    """Return a course of leaders (K, B), of which the arms port corrects half of the steps."""
    still = np.zeros_like(leader)
    observed = np.zeros((2, leader.shape[1]))
    active = np.full((2, leader.shape[1]), 0.5)
    touch = still if contact is None else contact
    return Course(leader, still, still, touch, observed, active, PERIOD_S)


def test_an_oscillation_and_a_throw_are_unstable_and_a_creep_is_not() -> None:
    time_s = PERIOD_S * np.arange(2600)
    shaking = 0.003 * np.sin(2.0 * np.pi * time_s)
    creeping = 0.05 * np.exp(-time_s / 5.0)
    thrown = np.where(time_s < 1.0, 0.0, 0.05) * (time_s < 9.0) + 0.05 * (time_s >= 9.0)
    leader = np.column_stack([shaking, creeping, thrown])
    assert wall_experiment.unstable(course(leader)).tolist() == [True, False, True]


def test_bounces_and_presses_that_leave_the_wall_are_counted() -> None:
    per_contact = round(wall_experiment.PERIOD_S / PERIOD_S)
    settled = np.zeros((2 * per_contact, 1))
    for start in (0, per_contact):
        settled[start + 150 : start + 1100] = 20.0
    bounced = settled.copy()
    bounced[160:170] = 0.0
    bounced[190:195] = 0.0
    leaving = settled.copy()
    leaving[1000:1010] = 0.0
    contact = np.column_stack([settled, bounced, leaving])
    speeds = np.full(3, 0.3)
    judged = wall_experiment.judge_contacts(course(0.001 * contact, contact), speeds)
    assert judged.bounces.tolist() == [0, 2, 1]
    assert judged.settled.tolist() == [True, True, False]
    assert judged.press_n[0] == pytest.approx(20.0)


def test_the_table_has_each_way_at_each_delay(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.setattr(wall_experiment, "MOVE_S", 0.1)
    monkeypatch.setattr(wall_experiment, "REST_S", 0.1)
    monkeypatch.setattr(wall_experiment, "JUDGED_S", 0.05)
    monkeypatch.setattr(wall_experiment, "PERIOD_S", 0.2)
    monkeypatch.setattr(wall_experiment, "PRESS_S", 0.05)
    monkeypatch.setattr(wall_experiment, "CONTACTS_N", 1)
    monkeypatch.setattr(passivity, "FIGURE", tmp_path / "passivity.svg")
    table = passivity.measure(BenchInputs(Config(), seed=1, repeats_n=1))
    assert len(table.rows) == 4 * 7
    assert (tmp_path / "passivity.svg").exists()
    judged = [row for row in table.rows if row.limits]
    assert len(judged) == 2 * len(passivity.LATE)
    assert all("TDPA" in row.name for row in judged)


def test_a_wall_stands_where_the_contacts_need_it() -> None:
    """The hand means to go beyond it."""
    networks, speeds = wall_experiment.contact_cases(["100 ms"])
    assert len(networks) == len(speeds) == 18
    assert 0.0 < WALL_M < 0.1
