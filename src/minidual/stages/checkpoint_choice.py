"""Which policies a tool drives: those that were named, the run's own, or those of the package."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import yaml

from minidual.durable import expanded
from minidual.errors import UsageError
from minidual.gate.stage import ToolContext
from minidual.gate.verdict import CONFIG_FILE
from minidual.policies.server_address import folder_of, is_address
from minidual.policies.shipped import shipped_policy
from minidual.trials.methods import METHODS, TrainedPolicy

DEMONSTRATED = "act"
"""The method whose policy the stage `train-act` trains."""
_CONFIG = "config.json"


def chosen_policies(
    context: ToolContext,
    methods: Iterable[str],
    task: str,
) -> dict[str, TrainedPolicy]:
    """Return the policy of each learned method that has one for a task.

    Raises:
        UsageError: What was named is no policy, or belongs to no method.
    """
    learned = [name for name in methods if METHODS[name].learned]
    named = named_policies(context.options.get("checkpoint"), learned)
    policies: dict[str, TrainedPolicy] = {}
    for method in learned:
        checkpoint = named.get(method) or _own_or_shipped(context, method, task)
        if checkpoint is not None:
            policies[method] = TrainedPolicy(checkpoint)
    return policies


def named_policies(
    typed: str | Path | Sequence[str | Path] | None,
    learned: Sequence[str],
) -> dict[str, Path]:
    """Return {method: folder} of `--checkpoint PATH` or `--checkpoint METHOD=PATH`.

    Args:
        typed: One or more of them, or None.
        learned: Methods that drive a policy.

    Raises:
        UsageError: A folder has no policy, or it is not clear whose it is.
    """
    if typed is None:
        return {}
    words = [typed] if isinstance(typed, str | Path) else list(typed)
    named: dict[str, Path] = {}
    for word in map(str, words):
        method, equals, path = word.partition("=")
        if not equals:
            method = _only(word, learned)
            path = word
        if method not in learned:
            raise UsageError(
                f"--checkpoint {word}: the methods that drive a policy here are "
                f"{', '.join(learned) or 'none'}",
            )
        named[method] = policy_place(path, f"--checkpoint {word}")
    return named


def policy_folder(path: str | Path, typed: str) -> Path:
    """Return a folder that holds a policy; UsageError if it holds none."""
    folder = expanded(str(path))
    if (folder / _CONFIG).is_file():
        return folder
    raise UsageError(f"{typed}: there is no policy ({_CONFIG}) in that folder")


def policy_place(text: str, typed: str) -> Path:
    """Return the folder of a policy, or one that stands for the address of a policy server.

    Raises:
        UsageError: There is no policy in that folder.
    """
    return folder_of(text) if is_address(text) else policy_folder(text, typed)


def _only(word: str, learned: Sequence[str]) -> str:
    if len(learned) == 1:
        return learned[0]
    raise UsageError(
        f"--checkpoint {word}: say whose policy it is",
        remedy=f"--checkpoint METHOD={word}, with METHOD one of {', '.join(learned) or 'none'}",
    )


def trained_folder(run_folder: Path, method: str, task: str) -> Path:
    """Return where `minidual train METHOD --task TASK` puts its policy and records."""
    return run_folder / "train" / method / task


def _own_or_shipped(context: ToolContext, method: str, task: str) -> Path | None:
    own = _own(context.run_folder, method, task)
    return own if own is not None else shipped_policy(task, method)


def _own(run_folder: Path, method: str, task: str) -> Path | None:
    """Return the policy that a run has trained for a task, or None."""
    if method != DEMONSTRATED:
        checkpoint = trained_folder(run_folder, method, task) / "checkpoint"
        return checkpoint if (checkpoint / _CONFIG).is_file() else None
    checkpoint = run_folder / "train-act" / "checkpoint"
    recorded = run_folder / "teleop-record"
    exists = (checkpoint / _CONFIG).is_file() and (recorded / CONFIG_FILE).is_file()
    return checkpoint if exists and recorded_task(recorded) == task else None


def missing_policy(method: str, task: str) -> UsageError:
    """Return the error of a learned method that has no policy for a task."""
    command = "run --until train-act" if method == DEMONSTRATED else f"train {method} --task {task}"
    return UsageError(
        f"{method} needs a policy that is trained on '{task}', and there is none",
        remedy=f"name its folder with --checkpoint {method}=PATH, or train one: minidual {command}",
    )


def require_policies(
    policies: Mapping[str, TrainedPolicy],
    methods: Iterable[str],
    task: str,
) -> None:
    """Raise UsageError if a learned method has no policy."""
    for method in methods:
        if METHODS[method].learned and method not in policies:
            raise missing_policy(method, task)


def recorded_task(recorded: Path) -> str:
    """Return the task of a recording: what policies are trained on."""
    return yaml.safe_load((recorded / CONFIG_FILE).read_text("utf-8"))["task"]
