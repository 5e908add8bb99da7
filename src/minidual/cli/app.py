"""The command line: parse, call one stage, print. Heavy imports wait until a command runs."""

import inspect
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

import minidual
from minidual.cli.commands import (
    Body,
    config_body,
    explain_body,
    run_body,
    run_tool,
    stage_body,
    status_body,
    stop_body,
)
from minidual.cli.session import Running, Session, Typed
from minidual.cli.viewing import Watching
from minidual.errors import ExitCode, printable, unknown_name
from minidual.gate.table import Option, StageTable, ToolEntry


@dataclass(frozen=True)
class _Until:
    until: Annotated[str | None, typer.Option(metavar="STAGE", help="Last stage to run.")] = None
    sign: Annotated[Path | None, typer.Option(metavar="KEY", help="Sign the verdicts with this OpenSSH key.")] = None


@dataclass(frozen=True)
class _Verified:
    verify: Annotated[Path | None, typer.Option(metavar="KEY", help="Verify the signature with this .pub file.")] = None


@dataclass(frozen=True)
class _Stopped:
    name: Annotated[str | None, typer.Argument(metavar="RUN", help="Name of a run; none stops all.")] = None


@dataclass(frozen=True)
class _Explained:
    stage: Annotated[str | None, typer.Argument(help="Name of a stage; none shows what to look at first.")] = None


def _parameters(*groups: type[Any]) -> list[inspect.Parameter]:
    return [
        inspect.Parameter(f.name, inspect.Parameter.KEYWORD_ONLY, default=f.default, annotation=hints[f.name])
        for group in groups
        for hints in [get_type_hints(group, include_extras=True)]
        for f in fields(group)
    ]


def _option_parameters(options: Iterable[Option]) -> list[inspect.Parameter]:
    """Return options as parameters; the last of a name counts."""
    found: dict[str, inspect.Parameter] = {}
    for option in options:
        kind: Any = str if option.kind is tuple else option.kind
        default: Any = inspect.Parameter.empty if option.argument else False if option.kind is bool else None
        if option.argument:
            declared: Any = typer.Argument(metavar=option.name.upper(), help=option.help)
        else:
            declared = typer.Option(f"--{option.name}", help=option.help)
        annotation = Annotated[kind if default is not None else kind | None, declared]
        found[option.key] = inspect.Parameter(
            option.key, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
        )
    return list(found.values())


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"minidual {minidual.__version__}")
        raise typer.Exit


def build_app(table: StageTable, tools: Sequence[ToolEntry] = ()) -> typer.Typer:
    """Return the command line of stages and tools."""
    app = typer.Typer(
        name="minidual",
        help="From an empty folder to a measured dual-arm robot system. Each stage waits behind a gate.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode="rich",
    )
    config = typer.Typer(help="The resolved configuration.", no_args_is_help=True)

    def add(
        name: str, summary: str, examples: Sequence[str], body: Body, own: list[inspect.Parameter], panel: str
    ) -> None:
        parameters = [*own, *_parameters(Typed)]

        def command(**values: Any) -> None:
            session = Session(Typed(**{f.name: values.pop(f.name) for f in fields(Typed)}), table)
            raise typer.Exit(session.end(lambda s: body(s, values)))

        command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        epilog = "\n\n".join(["Examples:", *(f"minidual {example}" for example in examples)])
        owner = config if name == "show" else app
        owner.command(name, help=f"{summary}.", epilog=epilog if examples else None, rich_help_panel=panel)(command)

    @app.callback()
    def root(  # pyright: ignore[reportUnusedFunction] - registered by the decorator
        version: Annotated[bool, typer.Option("--version", callback=_show_version, is_eager=True)] = False,
    ) -> None:
        del version

    for entry in table:
        own = _option_parameters(option for command in (*entry.asides, entry) for option in command.options)
        if any(command.watchable for command in (entry, *entry.asides)):
            own += _parameters(Watching)
        own += _parameters(Running)
        add(entry.name, entry.summary, entry.examples, stage_body(entry), own, "Stages, in order")
    for name, body, groups in (
        ("run", run_body, (_Until, Watching, Running)),
        ("status", status_body, (_Verified,)),
        ("explain", explain_body, (_Explained,)),
        ("stop", stop_body, (_Stopped,)),
        ("show", config_body, ()),
    ):
        summary, _, *examples = inspect.cleandoc(body.__doc__ or "").splitlines()
        add(name, summary.rstrip("."), examples, body, _parameters(*groups), "The run")
    app.add_typer(config, name="config", rich_help_panel="The run")
    for tool in tools:
        own = _option_parameters(tool.options) + (_parameters(Watching) if tool.watchable else [])
        add(tool.name, tool.summary, tool.examples, partial(run_tool, tool), own, "Tools, without gate and verdict")
    return app


def run_command_line(arguments: Sequence[str], table: StageTable, tools: Sequence[ToolEntry] = ()) -> int:
    """Run one command and return its exit code."""
    if strange := [word for word in arguments if word.encode(errors="ignore").decode() != word]:
        print(printable(f"minidual: {strange[0]} is not UTF-8"), file=sys.stderr)
        return int(ExitCode.USAGE)
    app = build_app(table, tools)
    commands = {command.name or "" for command in app.registered_commands} | {"config"}
    first = arguments[0].split("=")[0] if arguments else "--help"
    if first in {"--set", *(f"--{f.name.replace('_', '-')}" for f in fields(Typed))}:
        print(f"minidual: {first} stands after the command: minidual COMMAND {first} ...", file=sys.stderr)
        return int(ExitCode.USAGE)
    if not first.startswith("-") and first not in commands:
        print(f"minidual: {unknown_name('command', first, commands)}", file=sys.stderr)
        return int(ExitCode.USAGE)
    try:
        app(list(arguments), prog_name="minidual")
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else int(ExitCode.PASS)
    return int(ExitCode.PASS)
