"""Which policy a tool drives: the one that was named, the run's own, or one of the package."""

from pathlib import Path

import yaml

from minidual.durable import expanded
from minidual.errors import UsageError
from minidual.gate.stage import ToolContext
from minidual.gate.verdict import CONFIG_FILE
from minidual.policies.shipped import shipped_policy

_CONFIG = "config.json"


def chosen_checkpoint(context: ToolContext, task: str) -> Path | None:
    """Return the folder of `--checkpoint`, of the run, or of the package; None if there is none.

    Raises:
        UsageError: The named folder has no policy.
    """
    named = context.options.get("checkpoint")
    if named is not None:
        folder = expanded(named)
        if (folder / _CONFIG).is_file():
            return folder
        raise UsageError(f"--checkpoint {named}: there is no policy ({_CONFIG}) in that folder")
    own = context.run_folder / "train-act" / "checkpoint"
    recorded = context.run_folder / "teleop-record"
    has_own = (own / _CONFIG).is_file() and (recorded / CONFIG_FILE).is_file()
    if has_own and recorded_task(recorded) == task:
        return own
    return shipped_policy(task)


def recorded_task(recorded: Path) -> str:
    """Return the task of a recording: what policies are trained on."""
    return yaml.safe_load((recorded / CONFIG_FILE).read_text("utf-8"))["task"]
