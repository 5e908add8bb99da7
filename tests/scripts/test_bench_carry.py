"""The bench of a trial's steps."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.config.root import Config
from scripts.bench import carry
from scripts.bench.tables import BenchInputs


@pytest.mark.slow
def test_a_trial_of_each_task_is_timed_beside_physics(monkeypatch: pytest.MonkeyPatch) -> None:
    messages: list[str] = []
    monkeypatch.setattr(carry, "TASKS", ("rod_carry", "insertion"))
    table = carry.measure(BenchInputs(Config(), 20261, 2 * carry.BLOCK, messages.append))
    rows = {row.name: row for row in table.rows}
    trials = [f"{task}, {method}" for task in carry.TASKS for method in ("impedance", "moveit")]
    assert messages[-len(trials) :] == [f"{name}: success" for name in trials]
    assert [name for name in rows if "held" not in name][2:] == trials
    numbers = [value for row in table.rows for value in row.numbers.values()]
    assert all(np.isfinite(value) and value > 0.0 for value in numbers)
    for name in trials:
        assert rows[name].limits == {"ratio": carry.STEP_RATIO_MAX}
        assert rows[name].numbers["median_us"] > rows[name].numbers["bare_us"]
