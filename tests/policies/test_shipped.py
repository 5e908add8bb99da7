"""Policies that come with the package load, are small, and say what they reached."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from minidual.config.root import Config
from minidual.policies.shipped import BYTES_MAX, FOLDER, record_of, shipped_policy
from minidual.tasks.catalogue import TASKS, make_task
from minidual.trials.methods import METHODS, MethodInputs
from minidual.trials.runner import Bench

SHIPPED = sorted((path.parent.name, path.name) for path in FOLDER.glob("*/*") if path.is_dir())


def test_a_task_without_one_has_none(tmp_path: Path) -> None:
    place = tmp_path / "act" / "rod_carry"
    assert shipped_policy("rod_carry", folder=tmp_path) is None
    place.mkdir(parents=True)
    assert shipped_policy("rod_carry", folder=tmp_path) is None
    (place / "policy.json").write_text(json.dumps({"task": "rod_carry"}))
    folder = shipped_policy("rod_carry", folder=tmp_path)
    assert folder == place
    assert shipped_policy("rod_carry", "rl", tmp_path) is None
    assert record_of(folder) == {"task": "rod_carry"}


def test_each_names_its_task_its_making_and_its_success() -> None:
    for method, name in SHIPPED:
        folder = shipped_policy(name, method)
        assert folder is not None
        assert METHODS[method].learned
        assert name in TASKS
        record = record_of(folder)
        assert record["task"] == name
        assert {"made_by", "measured_at", "training", "network", "parameters", "success"} <= set(
            record
        )
        clean = record["success"]["clean"]
        assert 0 < clean["successes"] <= clean["trials"]
        assert sum(path.stat().st_size for path in folder.iterdir()) <= BYTES_MAX


@pytest.mark.torch
@pytest.mark.parametrize(("method", "name"), SHIPPED)
def test_each_carries_its_object_from_a_fresh_start(method: str, name: str) -> None:
    """One of two starts at least: its measured success is far higher."""
    task = make_task(Config(task=name))
    inputs = MethodInputs(task.config, task.config.seed, shipped_policy(name, method), name)
    bench = Bench(method, inputs)
    results = [bench.run(task.trial(task.config.seed, "shipped", index))[0] for index in range(2)]
    assert any(result.success for result in results), [result.text for result in results]
