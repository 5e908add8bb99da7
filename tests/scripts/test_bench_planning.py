"""The bench of planning: every planner on the same queries, minidual's time over theirs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from minidual.config.root import Config
from scripts.bench import planning
from scripts.bench.peers import Run
from scripts.bench.tables import BenchInputs
from tests.support.bench_samples import blocked_query, planner, straight

OMPL = "OMPL, MuJoCo, toppra"


def test_the_first_plan_of_a_process_can_be_timed(capsys: pytest.CaptureFixture[str]) -> None:
    exec(planning._FIRST_PLAN, {})
    assert 0.0 < float(capsys.readouterr().out) < 1e3


def test_every_planner_plans_the_queries_and_ratios_are_of_one_run(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.setattr(planning, "_process_s", lambda program, folder: 1.0)
    monkeypatch.setattr(planning, "_warm_up", lambda config, queries: None)
    table = planning.measure(BenchInputs(Config(), 20261, 1, roboplan=tmp_path / "python"))
    rows = {row.name: row for row in table.rows}
    assert len(rows) == 3 * 4 + 2
    for row in table.rows:
        for column, number in row.numbers.items():
            assert np.isfinite(number)
            assert number > 0.0 or column == "free_pct"
    for group in ("left_arm", "right_arm", "both_arms"):
        own = rows[f"{group}: minidual, proven"]
        assert own.numbers["solved_pct"] == own.numbers["free_pct"] == 100.0
        by_toppra = rows[f"{group}: minidual, timed by toppra"]
        assert by_toppra.numbers["solved_pct"] == by_toppra.numbers["free_pct"] == 100.0
        peer = rows[f"{group}: {OMPL}"]
        ratio = own.numbers["median_ms"] / peer.numbers["median_ms"]
        assert peer.numbers["median_ratio"] == pytest.approx(ratio)
        assert peer.limits["median_ratio"] == pytest.approx(1.0 / 3.0)
    assert rows["new scene"].limits == {"median_ratio": 1.0}
    assert rows["cold start"].limits == {"median_ratio": 1.2}
    assert rows["cold start"].numbers["median_ratio"] == 1.0
    assert any("pip install roboplan" in note for note in table.notes)


def test_unsolved_queries_count_with_their_time_and_contacts_are_counted() -> None:
    query = blocked_query()
    engines = planner().engines(query.drawn.scene)
    through_the_post = straight(query.motion.q_start, query.motion.q_goal)
    tally = planning._Tally()
    tally.add(Run(None, 5.0, "no path"), engines)
    tally.add(Run(through_the_post, 1.0), engines)
    numbers = tally.numbers()
    assert numbers["median_ms"] == 3000.0
    assert numbers["worst_ms"] == 5000.0
    assert numbers["solved_pct"] == 50.0
    assert numbers["free_pct"] == 0.0
