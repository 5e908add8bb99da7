"""Commands as they are typed."""

from __future__ import annotations

import typer

from minidual.cli.app import build_app
from minidual.stages.registry import STAGES, TOOLS


def parse(words: list[str]) -> None:
    """Raise what the command line raises for wrong words, without running the command."""
    group = typer.main.get_command(build_app(STAGES, TOOLS))
    context = group.make_context("minidual", list(words), resilient_parsing=True)
    command = group
    while words and hasattr(command, "resolve_command"):
        name, command, words = command.resolve_command(context, words)
        if words == ["--help"]:
            return
        context = command.make_context(name, list(words), parent=context)
