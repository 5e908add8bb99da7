"""Policies from outside the run: which the benchmark takes, and that a changed one is seen."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from minidual.config.root import Config, changed
from minidual.errors import UsageError
from minidual.policies.server_address import folder_of
from minidual.stages import policy_folders
from minidual.stages.policy_folders import benchmark_config, deploy_config, outside_policies
from minidual.trials.compared import benchmark_needs, name_policies
from minidual.trials.methods import METHODS


def policy(folder: Path, **values: Any) -> Path:
    folder.mkdir(parents=True)
    (folder / "config.json").write_text(json.dumps({"type": "rl", **values}))
    return folder


def config(**values: Any) -> Config:
    settings = {f"benchmark.{name}": value for name, value in values.items()}
    return changed(Config(task="pot_lift"), settings)


@pytest.fixture(autouse=True)
def nothing_shipped(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("MINIDUAL_CACHE", str(tmp_path / "cache"))
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
        (
            {"theirs": "nowhere"},
            r"'theirs', and that is none of the methods to compare: moveit, rl",
        ),
        ({"Their policy": "nowhere"}, "a policy cannot be named 'Their policy'"),
        ({"rl": "nowhere"}, r"benchmark.policies.rl: there is no policy \(config.json\) in"),
        ({"moveit": "nowhere"}, "benchmark.policies: 'moveit' drives no policy; act, rl do"),
    ],
)
def test_a_name_without_a_policy_is_refused(policies: dict[str, str], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        benchmark_config(config(methods=("moveit", "rl"), policies=policies))


@pytest.fixture
def own_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """Names that a test adds are gone after it."""
    monkeypatch.setattr(METHODS, "_rows", dict(METHODS._all()))


def test_a_policy_by_a_new_name_is_a_method_of_its_own(tmp_path: Path, own_table: None) -> None:
    own = policy(tmp_path / "pretrained_model", type="diffusion")
    settings = config(
        methods=("moveit", "theirs", "served"),
        policies={"theirs": str(own), "served": "ws://127.0.0.1:8000"},
    )
    resolved = benchmark_config(settings)
    assert benchmark_needs(settings) == ("carry",)
    assert METHODS["theirs"].learned
    policies = outside_policies(resolved, "pot_lift")
    assert policies["theirs"] == (own, "pot_lift")
    assert policies["served"].checkpoint == folder_of("ws://127.0.0.1:8000")
    assert set(resolved.benchmark.policy_digests) == {"theirs/pot_lift", "served/pot_lift"}


def test_a_worker_knows_the_name_from_its_inputs(own_table: None) -> None:
    name_policies(("theirs",), {"theirs": None})
    assert METHODS["theirs"].needs_images


def test_the_policy_of_deploy_has_a_digest(tmp_path: Path) -> None:
    own = policy(tmp_path / "pretrained_model")
    settings = changed(Config(task="pot_lift"), {"deploy.policy": str(own)})
    before = deploy_config(settings).deploy.policy_digest
    assert len(before) == 16
    (own / "weights").write_bytes(b"other")
    assert deploy_config(settings).deploy.policy_digest not in ("", before)
    claimed = changed(Config(task="pot_lift"), {"deploy.policy_digest": before})
    assert deploy_config(claimed).deploy.policy_digest == ""
    nowhere = changed(settings, {"deploy.policy": "nowhere"})
    with pytest.raises(UsageError, match=r"deploy\.policy: there is no policy \(config\.json\)"):
        deploy_config(nowhere)
