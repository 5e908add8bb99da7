"""Contexts of tools that tests call."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from minidual.config.root import Config, changed
from minidual.gate.stage import ToolContext


def tool_context(tmp_path: Path, name: str, task: str, **options: Any) -> ToolContext:
    """Return the context of a tool in an empty run."""
    config = changed(Config(), {"task": task})
    return ToolContext(
        config=config,
        seed=config.seed,
        profile="standard",
        options=options,
        run_folder=tmp_path / "run",
        name=name,
    )
