"""Policies from outside the run: which the benchmark takes, and that a changed one is seen."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from minidual.config.root import Config, changed
from minidual.errors import ConfigError
from minidual.stages import policy_folders
from minidual.stages.policy_folders import benchmark_config, outside_policies


def policy(folder: Path, **values: Any) -> Path:
    folder.mkdir(parents=True)
    (folder / "config.json").write_text(json.dumps({"type": "rl", **values}))
    return folder


def config(**values: Any) -> Config:
    settings = {f"benchmark.{name}": value for name, value in values.items()}
    return changed(Config(task="pot_lift"), settings)


@pytest.fixture(autouse=True)
def nothing_shipped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(policy_folders, "shipped_policy", lambda task, method: None)


def test_a_folder_of_policies_by_task_gives_each_task_its_own(tmp_path: Path) -> None:
    own = policy(tmp_path / "pot_lift" / "checkpoint", task="pot_lift")
    policy(tmp_path / "rod_carry" / "checkpoint", task="rod_carry")
    settings = config(methods=("moveit", "rl"), policies={"rl": str(tmp_path)})
    assert outside_policies(settings, "pot_lift")["rl"] == (own, "pot_lift")
    assert outside_policies(settings, "sort") == {}


def test_one_policy_serves_the_task_that_it_names(tmp_path: Path) -> None:
    own = policy(tmp_path / "mine", task="pot_lift")
    settings = config(methods=("rl",), policies={"rl": str(own)})
    assert outside_policies(settings, "pot_lift")["rl"].checkpoint == own
    assert outside_policies(settings, "rod_carry") == {}


def test_without_a_name_the_package_s_is_taken_and_act_keeps_that_of_the_run(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(policy_folders, "shipped_policy", lambda task, method: tmp_path)
    settings = config(methods=("moveit", "act", "rl"))
    assert outside_policies(settings, "pot_lift") == {"rl": (tmp_path, "pot_lift")}


def test_a_changed_policy_changes_the_parameters(tmp_path: Path) -> None:
    own = policy(tmp_path / "mine", task="pot_lift")
    settings = config(methods=("rl",), policies={"rl": str(own)})
    before = benchmark_config(settings).benchmark.policy_digests
    assert list(before) == ["rl/pot_lift"]
    assert benchmark_config(benchmark_config(settings)).benchmark.policy_digests == before
    (own / "weights").write_bytes(b"other")
    assert benchmark_config(settings).benchmark.policy_digests != before


def test_a_digest_cannot_be_claimed() -> None:
    settings = config(methods=("moveit",), policy_digests={"rl/pot_lift": "claimed"})
    assert benchmark_config(settings).benchmark.policy_digests == {}


@pytest.mark.parametrize(
    ("policies", "message"),
    [
        ({"rl": "nowhere"}, r"benchmark.policies.rl: there is no policy \(config.json\) in"),
        ({"moveit": "nowhere"}, "benchmark.policies: 'moveit' drives no policy; act, rl do"),
    ],
)
def test_a_name_without_a_policy_is_refused(policies: dict[str, str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        benchmark_config(config(methods=("moveit", "rl"), policies=policies))
