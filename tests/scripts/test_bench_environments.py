"""The bench of environments times batches and a single world beside bare physics."""

from __future__ import annotations

import pytest

from minidual.config.root import Config
from scripts.bench import environments
from scripts.bench.tables import BenchInputs


def test_batches_and_the_single_world_are_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environments, "_WORLDS", (1, 2))
    names: list[str] = []
    inputs = BenchInputs(Config(), seed=1, repeats_n=1, advance=names.append)
    table = environments.measure(inputs)
    rows = {row.name: row for row in table.rows}
    assert list(rows) == [
        "1 worlds",
        "2 worlds",
        "1 worlds, fast",
        "2 worlds, fast",
        "single, at rest",
    ]
    assert names == [*list(rows)[:-1], "single"]
    for row in table.rows:
        assert row.numbers["steps_per_s"] > 0.0
        assert row.numbers["ratio"] == pytest.approx(
            row.numbers["bare_per_s"] / row.numbers["steps_per_s"]
        )
    assert [name for name, row in rows.items() if row.limits] == ["2 worlds", "2 worlds, fast"]
