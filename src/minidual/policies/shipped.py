"""Policies that come with the package, one for each method and task that has one.

Weights are float16, at most 2 MB a policy. `policy.json` beside them says by which command they
were made and what they reached. `scripts/ship_policy.py` writes both.
"""

from pathlib import Path
from typing import Any

from minidual.durable import read_json

FOLDER = Path(__file__).with_name("shipped")
RECORD = "policy.json"
BYTES_MAX = 2_000_000
"""Of all files of one policy."""


def shipped_policy(task: str, method: str = "act", folder: Path = FOLDER) -> Path | None:
    """Return the checkpoint folder of a method's policy for a task, or None."""
    checkpoint = folder / method / task
    return checkpoint if (checkpoint / RECORD).is_file() else None


def record_of(checkpoint: Path) -> dict[str, Any]:
    """Return how a shipped policy was made and what it reached."""
    return dict(read_json(checkpoint / RECORD))
