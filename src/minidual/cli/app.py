"""The command line: parse, call one command, print. Heavy imports wait until a command runs."""

from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Annotated

import typer

import minidual
from minidual.cli.commands.table import (
    CONFIG_COMMANDS,
    READING,
    RUN_COMMANDS,
    STAGE_COMMANDS,
    TOOL_COMMANDS,
    TOOL_GROUPS,
)
from minidual.cli.ending import end
from minidual.cli.options import CommonOptions
from minidual.cli.rows import stage_command, tool_command
from minidual.cli.session import Session
from minidual.cli.signature import Command, help_and_examples, typer_function
from minidual.errors import UsageError, check_name
from minidual.gate.table import StageTable, ToolEntry

_STAGES_PANEL = "Stages, in order"
_RUN_PANEL = "The run"
_TOOLS_PANEL = "Tools, without gate and verdict"


def _show_version(value: bool) -> None:
    if value:
        print(f"minidual {minidual.__version__}")
        raise typer.Exit


def _root(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True),
    ] = False,
) -> None:
    del version


def build_app(table: StageTable, tools: Sequence[ToolEntry] = ()) -> typer.Typer:
    """Return the command line of stages and tools."""
    app = typer.Typer(
        name="minidual",
        help="From an empty folder to a measured dual-arm robot system. "
        "Each stage waits behind a gate.",
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["--help", "-h"]},
        rich_markup_mode="rich",
    )
    app.callback()(_root)
    config = typer.Typer(help="The resolved configuration.")

    def add(owner: typer.Typer, name: str, command: Command, panel: str) -> None:
        def run(common: CommonOptions, body: Callable[[Session], int]) -> None:
            def checked(session: Session) -> int:
                session.require_folder()
                if name in READING:
                    session.require_run()
                return body(session)

            raise typer.Exit(end(Session(common, table, tools), checked))

        text, examples = help_and_examples(command)
        epilog = "\n\n".join(["Examples:", *examples]) if examples else None
        register = owner.command(name, help=text, epilog=epilog, rich_help_panel=panel)
        register(typer_function(command, run))

    for entry in table.values():
        command = STAGE_COMMANDS.get(entry.name) or stage_command(entry)
        add(app, entry.name, command, _STAGES_PANEL)
    for name, command in RUN_COMMANDS.items():
        add(app, name, command, _RUN_PANEL)
    for name, command in CONFIG_COMMANDS.items():
        add(config, name, command, _RUN_PANEL)
    app.add_typer(config, name="config", rich_help_panel=_RUN_PANEL)
    for word, (text, commands) in TOOL_GROUPS.items():
        group = typer.Typer(help=text)
        for name, command in commands.items():
            add(group, name, command, _TOOLS_PANEL)
        app.add_typer(group, name=word, rich_help_panel=_TOOLS_PANEL)
    for tool in tools:
        command = TOOL_COMMANDS.get(tool.name) or tool_command(tool)
        add(app, tool.name, command, _TOOLS_PANEL)
    return app


def run_command_line(
    arguments: Sequence[str],
    table: StageTable,
    tools: Sequence[ToolEntry] = (),
) -> int:
    """Run one command and return its exit code."""

    def parse(_: Session) -> int:
        return _parse(arguments, table, tools)

    # Errors of parsing are a document, too, if --json was typed.
    return end(Session(CommonOptions(json="--json" in arguments), table), parse)


def _parse(arguments: Sequence[str], table: StageTable, tools: Sequence[ToolEntry]) -> int:
    for word in arguments:
        if not _is_utf8(word):
            raise UsageError(f"{word} is not UTF-8")
    table.plug_in("minidual.stages")
    app = build_app(table, tools)
    groups = {group.name or "" for group in app.registered_groups}
    commands = {command.name or "" for command in app.registered_commands} | groups
    first = arguments[0].split("=")[0] if arguments else "--help"
    if first in _common_flags():
        raise UsageError(f"{first} stands after the command: minidual COMMAND {first} ...")
    if not first.startswith("-"):
        check_name("command", first, commands)
    try:
        return app([*arguments] or ["--help"], prog_name="minidual", standalone_mode=False)
    except typer.TyperException as error:
        remedy = f"minidual {first} --help" if first in commands else "minidual --help"
        raise UsageError(error.format_message(), remedy=remedy) from error


def _is_utf8(word: str) -> bool:
    return word.encode(errors="ignore").decode() == word


def _common_flags() -> set[str]:
    names = {f"--{field.name.replace('_', '-')}" for field in fields(CommonOptions)}
    return names | {"--set"}
