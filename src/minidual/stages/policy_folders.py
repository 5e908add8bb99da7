"""Where the benchmark finds the policies of learned methods that no stage of the run trains."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from minidual.config.root import Config, changed
from minidual.durable import expanded, read_json
from minidual.errors import ConfigError
from minidual.gate.canonical import digest, file_sha256
from minidual.policies.server_address import folder_of, is_address
from minidual.policies.shipped import shipped_policy
from minidual.stages.checkpoint_choice import policy_place
from minidual.tasks import catalogue
from minidual.trials.compared import benchmark_methods
from minidual.trials.methods import METHODS, TrainedPolicy

_CONFIG = "config.json"


def benchmark_config(config: Config) -> Config:
    """Return the resolved configuration, with a digest of each policy from outside the run.

    So a verdict depends on what a policy is, not on the name of its folder.
    """
    resolved = catalogue.benchmark_config(config)
    digests: dict[str, str] = {}
    for task in catalogue.tasks_of(resolved):
        for method, policy in outside_policies(resolved, task).items():
            digests[f"{method}/{task}"] = _digest(policy.checkpoint)
    return changed(resolved, {"benchmark.policy_digests": digests})


def deploy_config(config: Config) -> Config:
    """Return the configuration with the task's values, and a digest of `deploy.policy`."""
    resolved = catalogue.task_config(config)
    digest_now = ""
    if resolved.deploy.policy:
        digest_now = _digest(policy_place(resolved.deploy.policy, "deploy.policy"))
    if digest_now == resolved.deploy.policy_digest:
        return resolved
    return changed(resolved, {"deploy.policy_digest": digest_now})


def deploy_needs(config: Config) -> tuple[str, ...]:
    """Return the stages that `deploy` needs: a policy that is named needs no training."""
    return ("carry",) if config.deploy.policy else ("train-act",)


def outside_policies(config: Config, task: str) -> dict[str, TrainedPolicy]:
    """Return the policies for a task that were named, or that come with the package.

    The stage `train-act` trains that of methods without a trainer: it is named only to replace it.

    Raises:
        ConfigError: A folder that was named holds no policy, or its method drives none.
    """
    methods = benchmark_methods(config)
    named = _named(config.benchmark.policies)
    policies: dict[str, TrainedPolicy] = {}
    for method in methods:
        spec = METHODS[method]
        if not spec.learned:
            continue
        if method in named:
            checkpoint = _policy_in(named[method], task)
        elif spec.trainer is not None:
            checkpoint = shipped_policy(task, method)
        else:
            continue
        if checkpoint is not None:
            policies[method] = TrainedPolicy(checkpoint, task)
    return policies


def _named(policies: Mapping[str, str]) -> dict[str, Path]:
    named: dict[str, Path] = {}
    for method, path in policies.items():
        if not METHODS[method].learned:
            learned = [name for name, spec in METHODS.items() if spec.learned]
            raise ConfigError(
                f"benchmark.policies: '{method}' drives no policy; {', '.join(learned)} do",
            )
        if is_address(path):
            named[method] = folder_of(path)
            continue
        folder = expanded(path)
        if not (folder / _CONFIG).is_file() and not any(folder.glob(f"**/{_CONFIG}")):
            raise ConfigError(
                f"benchmark.policies.{method}: there is no policy ({_CONFIG}) in {folder}",
                remedy="name the folder of a checkpoint, such as pretrained_model of lerobot-train,"
                " or the address of a policy server: ws://127.0.0.1:8000",
            )
        named[method] = folder
    return named


def _policy_in(folder: Path, task: str) -> Path | None:
    """Return the policy for a task: the folder itself, or one that bears the task's name."""
    for place in (folder / task / "checkpoint", folder / task):
        if (place / _CONFIG).is_file():
            return place
    if not (folder / _CONFIG).is_file():
        return None
    trained = read_json(folder / _CONFIG).get("task", task)
    return folder if trained == task else None


def _digest(checkpoint: Path) -> str:
    files = sorted(path for path in checkpoint.iterdir() if path.is_file())
    return digest({path.name: file_sha256(path) for path in files})[:16]
